"""One page about a fleet, or about two datasets side by side; the tables behind it."""

import inspect
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import asdict, dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pandas as pd
from pandas.api.types import is_float_dtype

from fleetlog.analysis.tariff import load_tariff
from fleetlog.core.result import Result
from fleetlog.core.schema import Wrong, time_zone
from fleetlog.core.truck import Truck
from fleetlog.core.words import count, listed
from fleetlog.errors import ArgumentError, DataError, InputError
from fleetlog.registry import entries, part
from fleetlog.report.content import Part, picture, render
from fleetlog.report.diagnosis import in_short
from fleetlog.report.facts import Facts, gather
from fleetlog.report.figures import Row, changes, frame, page_table, rows_of
from fleetlog.report.sections import SECTIONS, answers, local_span
from fleetlog.simulate.places import REACH, mined_site
from fleetlog.store import Dataset
from fleetlog.store.output import atomic_output
from fleetlog.version import __version__
from fleetlog.view.palette import scales_of
from fleetlog.view.picture import Layer, Panel

PLACES = {"speeding": "speeding", "near_misses": "near_misses", "places": "stops", "areas": "density"}
"""Tables of the report, and the result that each is of."""
TEXT_ONLY = {"strings_to_formulas": False, "strings_to_urls": False, "strings_to_numbers": False}
"""A text that begins with = is a text."""
UNITS = "m, s, m/s and J, where the name of a column does not end with another unit"
MOST_ROWS = 1_000_000  # A sheet holds no more


@dataclass
class Report:
    """What a report says: ``html`` (one page), ``summary`` (JSON-ready), ``tables`` and ``lines``."""

    html: str
    summary: dict[str, Any] = field(default_factory=dict)
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)
    zone: str = "UTC"


def report(
    datasets: Sequence[Dataset], *, truck: Truck | None = None, tariff: Path | None = None,
    timezone: str | None = None, diagnosis: bool = True,
) -> Report:  # fmt: skip
    """Report on one dataset, or on how a second one differs from it; arguments as of :func:`fleetlog.report`.
    Raises :class:`ArgumentError` for none or more than two, or what is no time zone, :class:`InputError` for
    a file at fault (a ``tariff``: see :mod:`fleetlog.analysis.tariff`)."""
    if not 1 <= len(datasets) <= 2:
        raise ArgumentError(f"a report takes one or two datasets, not {len(datasets)}")
    try:
        zone = time_zone(timezone or datasets[0].site.timezone)
    except Wrong as wrong:
        raise ArgumentError(f"{timezone!r} {wrong}", where="--timezone") from None
    prices = None if tariff is None else load_tariff(tariff)
    names = [d.path.resolve().name for d in datasets]
    if len(set(names)) < len(names):
        names = [f"{n} ({i})" for i, n in enumerate(names, start=1)]
    facts = [gather(Facts(n, d, zone, truck, prices)) for n, d in zip(names, datasets, strict=True)]
    if len(facts) == 2 and all("stops" in f.results for f in facts):
        a, b = (f.results["stops"].places["places"] for f in facts)  # a mined place bears one name in both
        mined = ~b["place"].isin([p.id for p in facts[1].dataset.site.places])
        b.loc[mined, "place"] = mined_site(mined_site(facts[0].dataset.site, a)[0], b[mined], REACH)[1]
    if diagnosis and truck is not None:
        for f in facts:
            # A simulation leaves out nothing that its model has.
            f.left_out = in_short(f) if f.dataset.kind == "recorded" else []
    maps = [f.results[name] for name in ("heatmap", "density") for f in facts if name in f.results]
    scales = scales_of([shape for result in maps for shape in result.shapes])
    facts = [replace(f, scales=scales) for f in facts]
    rows = rows_of(facts)
    lead = changes(rows, names) if len(facts) == 2 else answers(facts[0])
    known = [(len(f.energy_from), len(f.dataset.vehicles), f.name) for f in facts]
    # Where the energy of some trucks is unknown, totals are not those of the fleets.
    if len(facts) == 2 and any(0 < k < n for k, n, _ in known):
        said = listed([f"{k} of {n} in {name}" for k, n, name in known])
        lead.append(f"Energy, cost and CO2 are those of the trucks whose energy is known: {said}.")
    sites = dict.fromkeys(f.dataset.site.name if f.dataset.site.source else f.name for f in facts)
    page = render(
        "fleet.html", title=f"Fleet report: {' and '.join(sites)}", lead=lead, version=__version__, rows=rows,
        about=[_about(f) for f in facts], sections=[*_sections(facts)], key=page_table(rows, names),
    )  # fmt: skip
    return Report(page, _summary(facts, rows, lead), _tables(facts, rows), lead, zone)


def _about(f: Facts) -> list[tuple[str, str]]:
    """Dataset, site, period, trucks, truck file, tariff and version."""
    made = f.dataset.meta["provenance"].get("version", "an unknown version")
    return [
        ("Dataset", f"{f.name} ({f.dataset.kind})"), ("Site", f.dataset.site.name), ("Period", local_span(f)),
        ("Trucks", f"{count(len(f.dataset.vehicles), 'truck')}, {count(f.dataset.rows, 'row')}"),
        ("Truck file", f.truck.name if f.truck else "none given"),
        ("Tariff", f.tariff.name if f.tariff else "none given"),
        ("Made by", f"fleetlog {__version__}, from a dataset of fleetlog {made}"),
    ]  # fmt: skip


def _sections(facts: list[Facts]) -> Iterator[tuple[str, list[Part]]]:
    """Title and a part for each dataset; at last what analyses of other packages say and draw."""
    for title, make in SECTIONS.items():
        parts = [replace(make(f), name=f.name) for f in facts]
        yield title, [p for p in parts if p.lines or p.blocks]
        if title == "Energy" and (parts := [Part(f.left_out, name=f.name) for f in facts if f.left_out]):
            yield "What the truck model leaves out", parts
    more: dict[str, list[Part]] = {}
    for f in facts:
        for result in added_results(f.dataset, f.truck):
            title = result.name.replace("_", " ").capitalize()
            drawn: list[Any] = [s for s in result.shapes if isinstance(s, Layer | Panel)]
            drawn = [picture(f, s, s.name.replace("_", " ").capitalize(), result) for s in drawn]
            more.setdefault(title, []).append(Part(result.lines, drawn, f.name))
    yield from more.items()


def added_results(dataset: Dataset, truck: Truck | None = None) -> Iterator[Result]:
    """Give the result of every added analysis that these data can answer."""
    for entry in entries("fleetlog.analysis"):
        function = part("fleetlog.analysis", "", entry.name)
        needed = [p.name for p in inspect.signature(function).parameters.values() if p.default is p.empty][1:]
        options: dict[str, Any] = {} if truck is None or "truck" not in needed else {"truck": truck}
        if set(needed) <= options.keys():
            with suppress(DataError):  # these data cannot answer it
                yield function(dataset, **options)


def _summary(facts: list[Facts], rows: list[Row], lead: list[str]) -> dict[str, Any]:
    datasets = [
        {
            "name": f.name, "path": str(f.dataset.path), "kind": f.dataset.kind, "site": f.dataset.site.name,
            **{k: f.dataset.meta[k] for k in ("start", "end")}, "vehicles": len(f.dataset.vehicles),
            "figures": {r.figure.name: r.values[k] for r in rows},
            "left_out": f.left_out, "not_judged": f.missing,
        }
        for k, f in enumerate(facts)
    ]  # fmt: skip
    differences = {r.figure.name: asdict(r.difference) for r in rows if r.difference is not None}
    return {
        "format_version": 1, "timezone": facts[0].zone, "datasets": datasets,
        "units": {r.figure.name: r.unit for r in rows}, "differences": differences or None, "answer": lead,
    }  # fmt: skip


def _tables(facts: list[Facts], rows: list[Row]) -> dict[str, pd.DataFrame]:
    """All tables; those of two datasets are one below the other, told apart by the column ``dataset``."""
    out: dict[str, list[pd.DataFrame]] = {}
    for f in facts:
        own = {"ledger": f.ledger.reset_index(), "states": f.results["utilisation"].tables["states"]}
        results = {name: f.results[of].places for name, of in PLACES.items() if of in f.results}
        own |= {name: tables[name] for name, tables in results.items() if name in tables}
        if "trips" in f.results:
            own["trips_between_places"] = f.results["trips"].tables["pairs"]
        for name, table in own.items():
            out.setdefault(name, []).append(table.assign(dataset=f.name) if len(facts) > 1 else table)
    about = pd.DataFrame({f.name: dict(_about(f)) for f in facts}).rename_axis("about").reset_index()
    about.loc[len(about)] = ["Units", *[UNITS] * len(facts)]
    first = {"figures": frame(rows, [f.name for f in facts]), "about": about}
    return {**first, **{n: pd.concat(t, ignore_index=True) for n, t in out.items()}}


def held(target: Path | None, overwrite: bool, inputs: Iterable[Path]) -> AbstractContextManager[Path | None]:
    """The place of the tables, if any, for :func:`write_tables`."""
    if target is None:
        return nullcontext()
    book = target.suffix.lower() == ".xlsx"
    if book and find_spec("xlsxwriter") is None:
        do = "install fleetlog[excel], or name a folder for Parquet files"
        raise InputError("writing .xlsx needs another package", do=do)
    return atomic_output(target, "report tables", overwrite=overwrite, folder=not book, inputs=inputs)


def write_tables(path: Path, tables: dict[str, pd.DataFrame], zone: str) -> None:
    """A file a table in a folder, else a sheet a table; there times are those of the zone: it knows none."""
    if path.is_dir():
        for name, table in tables.items():
            table.to_parquet(path / f"{name}.parquet", index=False)
        return
    with pd.ExcelWriter(path, engine="xlsxwriter", engine_kwargs={"options": TEXT_ONLY}) as book:
        for name, table in tables.items():
            sheet, rows = re.sub(r"[\[\]:*?/\\]", "_", name)[:31], table.head(MOST_ROWS)
            times = rows.select_dtypes("datetimetz").columns
            local = rows.assign(**{c: rows[c].dt.tz_convert(zone).dt.tz_localize(None) for c in times})
            local.to_excel(book, sheet_name=sheet, index=False, freeze_panes=(1, 0))
            page, shown = book.sheets[sheet], book.book.add_format({"num_format": "#,##0.000"})
            page.autofilter(0, 0, len(rows), len(rows.columns) - 1)
            page.autofit()
            for k, column in enumerate(map(str, rows)):
                if column in times or is_float_dtype(rows[column]):
                    page.set_column(k, k, 20 if column in times else max(len(column) + 3, 11), shown)
