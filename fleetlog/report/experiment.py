"""The page of an experiment: variants with intervals and changes, plots, and what limits each variant."""

import json
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import pandas as pd

from fleetlog.core.result import Result, Spread
from fleetlog.core.site import Site
from fleetlog.core.words import count, listed
from fleetlog.errors import InputError
from fleetlog.report.content import Part, Picture, Table, render
from fleetlog.report.report import Report
from fleetlog.simulate.scenario import EXPERIMENT, MEASURES, Factor, compared, told, told_rows
from fleetlog.store.dataset import undamaged
from fleetlog.version import __version__
from fleetlog.view.picture import svg


def experiment_report(value: Any) -> Report | None:
    """The page of an experiment: of what ``simulate`` answered, or its folder; None of anything else."""
    if isinstance(value, Result) and value.name == "experiment":
        return _report(value.name, value.summary, value.tables["runs"])
    file = Path(value if isinstance(value, str | PathLike) else "") / "experiment.json"
    if not file.is_file():
        return None
    with undamaged(file):
        summary = json.loads(file.read_text(encoding="utf-8"))
        if (version := summary["format_version"]) != EXPERIMENT:
            what = f"format version {version}, this fleetlog reads {EXPERIMENT}"
            raise InputError(what, where=file, do="simulate again")
        return _report(file.parent.resolve().name, summary, pd.read_parquet(file.with_name("runs.parquet")))


def _report(name: str, summary: Mapping[str, Any], runs: pd.DataFrame) -> Report:
    site, made, seeds = summary["site"], summary["provenance"], summary["seeds"]
    factors = [Factor(n, tuple(values)) for n, values in summary["factors"].items()]
    result, varied = compared(runs, factors), len(factors)
    table = result.tables["variants"]
    size = f"{count(len(table), 'variant')} with {count(len(seeds), 'seed')} each, from {seeds[0]} on"
    version = f"fleetlog {__version__}, from an experiment of fleetlog {made['version']}"
    about = {"Experiment": name, "Site": site, "Runs": size, "Command": made["command"], "Made by": version}
    head, *rows = told_rows(table, factors)
    right = [varied <= k < len(head) - 1 for k in range(len(head))]
    blocks = [Table(head, rows, right, "Means over the seeds, ± half of the 95 % interval")]
    changes = [
        [*row[:varied], *(told(values, f"{m}_change", sign="+") for m in MEASURES)]
        for row, values in zip(rows[1:], table.to_dict("records")[1:], strict=True)
    ]
    if changes:
        heads, right = [*head[:varied], *MEASURES.values()], [False] * varied + [True] * len(MEASURES)
        blocks.append(Table(heads, changes, right, "Change from the first variant, seed by seed"))
    spreads = [s for s in result.shapes if isinstance(s, Spread)]
    plots = [Picture(svg(result, Site(), s, salt=s.name), s.y_label) for s in spreads]
    lead = _lead(table, head, rows)
    page = render(
        "fleet.html", title=f"Experiment: {site}", about=[list(about.items())], lead=lead, tiles=[], key=None,
        sections=[("Variants", [Part([], [*blocks, *plots])])], method="experiment.html", version=__version__,
    )  # fmt: skip
    return Report(page, {**summary, "answer": lead}, result.tables, lead, "UTC")


def _lead(table: pd.DataFrame, head: list[str], rows: list[list[str]]) -> list[str]:
    """The best variant, and what limits how many of them."""
    best = dict(zip(head, rows[int(table.tasks_per_h.argmax())], strict=True))
    which = listed([f"{name} {best[name]}" for name in head[: head.index("tasks/h")]])
    change = f", {best['change']} from the first variant" if best["change"] else ""
    limits = table[table.possible > 0].bottleneck.value_counts()
    told_limits = listed([f"{what} in {count(n, 'variant')}" for what, n in limits.items()])
    out = [f"Most tasks are done with {which}: {best['tasks/h']} per hour{change}."]
    out.append(f"Bottleneck: {told_limits}.")
    if failed := int((table.possible == 0).sum()):
        out.append(f"{count(failed, 'variant')} cannot be run: the table says why.")
    return out
