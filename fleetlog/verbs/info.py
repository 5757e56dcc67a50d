"""Describe a dataset, log, map, site, truck or recording, or a folder that fleetlog wrote."""

import json
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from itertools import accumulate
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np

from fleetlog.api.answer import Answer
from fleetlog.api.inputs import DatasetLike, existing
from fleetlog.api.verb import verb
from fleetlog.core.files import is_url
from fleetlog.core.schema import load_toml
from fleetlog.core.truck import load_truck, truck_to_dict
from fleetlog.errors import EXIT_DAMAGED, EXIT_DONE, FleetlogError, FormatError, InputError
from fleetlog.roads import load_site
from fleetlog.store import Dataset
from fleetlog.store.events import read_table
from fleetlog.store.output import MARK

Figures = dict[str, Any]
LISTED = 30  # Entries of a list that are shown
WIDTH, ROWS, MOST = 100, 12, 40  # Letters of a line; rows of a table that are shown, letters of a cell
UNITS = {"wh_per_km": "kWh/km", "kwh_per_km": "kWh/km", "kwh_per_tkm": "kWh/t km", "kwh": "kWh"}
UNITS |= dict(m_s="m/s", w="W", kw="kW", wh="Wh", v="V", m="m", s="s", h="h", km="km", kg="kg")


@verb()
def info(path: DatasetLike) -> Answer:
    """Describe PATH: a dataset, log, map, site, truck or recording, or a folder that fleetlog wrote.

    Parameters
    ----------
    path : what is to be described.

    Examples
    --------
    >>> import fleetlog
    >>> print(str(fleetlog.info("sample/roads.geojson")).splitlines()[3])
      reports          format GeoJSON, read 40, kept 40, dropped none, notes none"""
    figures = describe(existing(path))
    status = EXIT_DAMAGED if figures.get("damage") or figures.get("rejected") else EXIT_DONE
    return Answer("info", figures, lines=told(figures), status=status)


def told(figures: Figures) -> list[str]:
    """What :func:`describe` found, for a person."""
    kind = f"{figures.get('recorded', '')} {figures['kind']}".strip()
    head = f"{figures['path']}: {'an' if kind[0] in 'aeiou' else 'a'} {kind}"
    rest = {k: v for k, v in figures.items() if k not in ("kind", "path", "summary", "recorded")}
    return [head, *_lines(rest | figures.get("summary", {}))]


def _lines(figures: Figures, indent: str = "  ") -> Iterator[str]:
    """Each figure behind its name; what holds figures or sentences of its own goes below."""
    for name, value in figures.items():
        label = indent + _label(name)
        parts = list(value.values() if isinstance(value, dict) else value) if _holds(value) else []
        if parts and isinstance(parts[0], dict) and "statement" in parts[0]:
            parts = [f"{f['term']} ({f['channel']}): {f['statement']}." for f in parts]
        if not any(_holds(part) or " " in str(part) for part in parts):
            thousand = value and name.endswith("_wh_per_km")
            yield from _wrapped(label, _inline(value / 1000.0 if thousand else value))
        elif isinstance(value, dict):
            yield from (label, *_lines(value, f"{indent}  "))
        elif isinstance(parts[0], dict):
            several = (label, *(f"{indent}  {line}" for line in _table(parts)))
            yield from several if parts[1:] else _lines({name: parts[0]}, indent)
        else:
            more = [f"and {len(parts) - LISTED} more"] if len(parts) > LISTED else []
            for k, part in enumerate([*parts[:LISTED], *more]):
                yield from _wrapped("" if k else label, _inline(part))


def _label(name: str) -> str:
    """Name of a figure with its unit."""
    found = re.fullmatch(f"(.+?)(?<!_per)_({'|'.join(UNITS)})", re.sub("^kwh_per", "energy_kwh_per", name))
    return (f"{found[1]} [{UNITS[found[2]]}]" if found else name).replace("_", " ")


def _wrapped(label: str, text: str) -> list[str]:
    """A text beside its name, its further lines below one another."""
    text, margin = text.replace(" %", "\xa0%"), 19 * " "  # No line begins with a per cent sign.
    lines = wrap(text, WIDTH, initial_indent=f"{label:<18} ", subsequent_indent=margin)
    return [line.replace("\xa0", " ") for line in lines] or [label]


def _table(rows: list[Figures]) -> Iterator[str]:
    """Rows with names over their columns; what none has is left out, what is long or many is cut short."""
    shown = [name for name in rows[0] if any(row.get(name) not in (None, [], "") for row in rows)]
    cells = [[_label(n) for n in shown], *([_cell(row.get(n)) for n in shown] for row in rows[:ROWS])]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    fit = sum(end <= WIDTH for end in accumulate(width + 2 for width in widths))
    yield from ("  ".join(map(str.ljust, row[:fit], widths)).rstrip() for row in cells)
    if rest := [f"{len(rows) - ROWS} more"] * (len(rows) > ROWS) + cells[0][fit:]:
        yield f"and {', '.join(rest)}: --json has them all"


def _cell(value: Any) -> str:
    text = f"{value:.4g}" if isinstance(value, float) else "-" if value is None else _inline(value)
    return text if len(text) <= MOST else f"{text[: MOST - 1]}…"


def _holds(value: Any) -> bool:
    return isinstance(value, dict | list | tuple) and len(value) > 0


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        return _inline([f"{name} {_inline(part)}".strip() for name, part in value.items()])
    if isinstance(value, list | tuple):
        more = [f"and {len(value) - LISTED} more"] if len(value) > LISTED else []
        return ", ".join([*map(_inline, value[:LISTED]), *more]) or "none"
    if value is None or isinstance(value, bool):
        return {None: "none", True: "yes", False: "no"}[value]
    moment = re.sub(r"^(\d{4}-\d\d-\d\d)T(\d\d:\d\d:\d\d)[.\d]*(Z|\+00:00)$", r"\1 \2 UTC", str(value))
    return f"{value:.6g}" if isinstance(value, float) else moment


def describe(path: Path) -> Figures:
    """What ``path`` holds; :class:`InputError` says what was tried where nothing fits."""
    if is_url(path) or (path / "dataset.json").is_file():
        return _dataset(path)
    if (path / MARK).is_file():
        # A folder of results: what it is, its files, and the figures of its summary.
        mark = json.loads((path / MARK).read_text(encoding="utf-8"))
        names = sorted(p.name for p in path.iterdir() if not p.name.startswith("."))
        document = next((path / n for n in names if n.endswith(".json") and (path / n).is_file()), None)
        figures = {} if document is None else json.loads(document.read_text(encoding="utf-8"))
        made = {"kind": str(mark["kind"]), "path": str(path), "version": str(mark.get("version", "unknown"))}
        return {**made, "files": names, "summary": figures}
    if path.suffix.lower() == ".rrd":
        from fleetlog.view.viewer import describe_recording

        return {"kind": "recording", "path": str(path), **describe_recording(path)}
    return _truck_or_site(path) if path.suffix.lower() == ".toml" else _log_or_map(path)


def _log_or_map(path: Path) -> Figures:
    """A log where a log format fits and gives rows, else a map; the log's error where it is neither."""
    from fleetlog.importers.base import find

    refusal: FleetlogError | None = None
    if find(path) is not None:
        try:
            return _log(path)
        except FormatError as error:
            refusal = error
    try:
        return _map(path)
    except (FleetlogError, UnicodeDecodeError) as error:
        what = "is no dataset, log, map, truck or recording that fleetlog knows"
        do = f"see docs/logs.md and docs/maps.md (taken as a map: {getattr(error, 'what', error)})"
        if path.is_dir():
            do = "name a file in it, or see what an import would read with fleetlog import --dry-run"
        raise refusal or InputError(what, where=path, do=do) from None


def _dataset(path: Path) -> Figures:
    d = Dataset(path)
    told = ("format_version", "site", "vehicles", "start", "end", "rows", "columns", "provenance")
    replay = (path / "recording.rrd").is_file()
    counts = {"recorded": d.kind, "trips": len(d.trips), "days": len(d.dates), "replay": replay}
    figures = {"kind": "dataset", "path": str(path), **{k: d.meta[k] for k in told}, **counts}
    tasks, stretches = read_table(d, "tasks"), read_table(d, "activities")
    if tasks is None or stretches is None:
        return figures
    status = {str(k): int(n) for k, n in tasks["status"].value_counts().items()}
    lasted = (stretches["end"] - stretches["start"]).dt.total_seconds()
    hours = lasted.groupby(stretches["activity"]).sum() / 3600.0
    return figures | {
        "tasks": {"all": len(tasks), **status},
        "charging_visits": int((stretches["activity"] == "charge").sum()),
        "reservations": int(d.meta["tables"]["reservations"]["rows"]),
        "activity_hours": {str(k): round(float(h), 4) for k, h in hours.items()},
    }


def _log(path: Path) -> Figures:
    from fleetlog.importers._open import ReadReport
    from fleetlog.importers.base import GEOGRAPHIC, LOCAL, ReadOptions, detect, read_guarded

    importer = detect(path)
    report = ReadReport(path, importer.name)
    rows, rejects = Counter[str](), Counter[str]()
    columns: dict[str, None] = {}
    extent: dict[str, list[Any]] = {}
    for batch in read_guarded(importer, path, ReadOptions(report)):
        rejects.update(r.reason for r in batch.rejects)
        columns |= dict.fromkeys(batch.columns if len(batch) else ())
        if batch.has_position:
            codes, counts = np.unique(batch.vehicle.codes, return_counts=True)
            rows.update({batch.vehicle.names[c]: int(n) for c, n in zip(codes, counts, strict=True)})
        positions: dict[str, Any] = {name: batch.columns.get(name, ()) for name in (*GEOGRAPHIC, *LOCAL)}
        for name, values in {"time": batch.time, **positions}.items():
            if len(known := np.asarray(values)[np.isfinite(values)]):
                known = np.append(known, extent.get(name, known[:1]))
                extent[name] = [known.min().item(), known.max().item()]
    if not rows:
        raise FormatError("no row with a position in it", where=path, do="see docs/logs.md")
    start, end = (f"{np.datetime64(int(t), 'us')}Z" for t in extent.pop("time"))
    return {
        "kind": "log", "path": str(path), "format": report.format, "rows": sum(rows.values()),
        "vehicles": dict(sorted(rows.items())), "start": start, "end": end, "extent": extent,
        "columns": list(columns), "recognised": report.recognised, "notes": report.notes,
        "damage": report.damage, "rejected": dict(rejects),
    }  # fmt: skip


def _map(path: Path) -> Figures:
    site, reports = load_site(path)
    kind = "site" if path.suffix.lower() == ".toml" or path.is_dir() else "map"
    figures = {
        "kind": kind, "path": str(path), "name": site.name, "traffic": site.traffic,
        "reports": [asdict(r) for r in reports], "frame": None if site.frame is None else asdict(site.frame),
        **{k: len(getattr(site, k)) for k in ("places", "zones", "buildings")},
    }  # fmt: skip
    if (n := site.network) is None:
        return figures
    z = [float(n.points[:, 2].min()), float(n.points[:, 2].max())] if n.has_elevation else None
    return figures | {
        "edges": len(n), "nodes": len(n.node_ids), "length_m": float(n.length.sum()),
        "one_way": int((n.reverse < 0).sum()), "extent_m": [*np.round(n.extent, 2)], "elevation_m": z,
    }  # fmt: skip


def _truck_or_site(path: Path) -> Figures:
    given = load_toml(path).keys()
    if "chassis" in given:
        return {"kind": "truck", "path": str(path), **truck_to_dict(load_truck(path))}
    if given & {"network", "frame", "place", "zone", "building"}:
        return _map(path)
    do = "see docs/reference/truck.md or docs/maps.md"
    raise InputError("is neither a truck ([chassis]) nor a site ([network])", where=path, do=do)
