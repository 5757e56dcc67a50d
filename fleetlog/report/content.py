"""What stands on a page, and the house of all pages: one set of templates and one style sheet."""

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd
from markupsafe import Markup

from fleetlog.core.result import Result, Spread
from fleetlog.core.site import Site
from fleetlog.report.facts import Facts
from fleetlog.simulate.scenario import told_rows
from fleetlog.view.picture import Layer, Panel, svg

TABLES = tomllib.loads(Path(__file__).with_name("templates").joinpath("tables.toml").read_text("utf-8"))


@dataclass(frozen=True)
class Table:
    """Texts, row by row; ``right`` says which columns are numbers."""

    head: list[str]
    rows: list[list[str]]
    right: list[bool]
    caption: str = ""
    more: int = 0  # Rows that are left out here, and are in the tables

    @property
    def wide(self) -> bool:
        """Whether it takes more than half a page: its longest texts, headings by words, in letters."""
        heads = [max(map(len, head.split() or [""])) for head in self.head]
        return sum(2 + max(h, *(len(r[k]) for r in self.rows), 0) for k, h in enumerate(heads)) > 57


@dataclass(frozen=True)
class Picture:
    """An SVG element and what it shows."""

    svg: str
    caption: str = ""


@dataclass
class Part:
    """What a section says of one dataset."""

    lines: list[str] = field(default_factory=list)
    blocks: list[Table | Picture] = field(default_factory=list)
    name: str = ""


def table(frame: pd.DataFrame, columns: str, caption: str = "", most: int = 60) -> Table:
    """The first rows of a frame; ``columns``, or those of this name in ``tables.toml``, are lines of
    ``heading=column`` or ``heading=column format``: Python's, ``%`` a share, ``t`` a local time. Unknown
    columns are left out."""
    lines = TABLES.get(columns, columns).strip().splitlines()
    specs = [(head, *f"{spec} ".split(" ")[:2]) for head, spec in (line.split("=") for line in lines)]
    shown = [spec for spec in specs if spec[1] in frame]
    rows = [[_cell(row[name], how) for _, name, how in shown] for row in frame.head(most).to_dict("records")]
    right = [how not in ("", "t") for _, _, how in shown]
    return Table([head for head, _, _ in shown], rows, right, caption, max(len(frame) - most, 0))


def _cell(value: Any, how: str) -> str:
    if how == "":
        return str(value)
    if pd.isna(value):
        return "–"
    if how == "%":
        return f"{100.0 * value:.0f} %"
    return f"{value:%d %b %H:%M:%S}" if how == "t" else format(float(value), f",{how}")


def number(value: float) -> str:
    """Three significant digits, all before the point; a dash where it is unknown."""
    if not np.isfinite(value):
        return "–"
    if value == 0.0 or abs(value) >= 100.0 or value == round(value):
        return f"{value:,.0f}"
    return f"{value:#.3g}" if abs(value) >= 0.1 else f"{value:.2g}"


def picture(facts: Facts, shape: Layer | Panel | None, caption: str, result: Result | None = None) -> Picture:
    """One shape of a result as it stands on the page."""
    whole = result or Result("picture", {}, shapes=[] if shape is None else [shape])
    name = getattr(shape, "name", "map")
    salt, scale = f"{facts.name}/{whole.name}/{name}", facts.scales.get(name)
    return Picture(svg(whole, facts.dataset.site, shape, salt=salt, scale=scale, zone=facts.zone), caption)


def render(template: str, **values: Any) -> str:
    """One self-contained HTML page; all but pictures of our own (filter ``drawn``) is escaped."""
    house = jinja2.Environment(
        loader=jinja2.PackageLoader("fleetlog.report", "templates"), autoescape=True, trim_blocks=True,
        lstrip_blocks=True, undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    house.filters["drawn"] = Markup
    return house.get_template(template).render(**values)


def experiment_page(result: Result, site: Site) -> str:
    """The page of an experiment: variants with intervals and changes, plots, and what limits each variant;
    the summary of the result tells its ``provenance``."""
    table, names = result.tables["variants"], [*result.summary["factors"]]
    head, *rows = told_rows(table, names)
    shown = Table(head, rows, [len(names) <= k < len(head) - 1 for k in range(len(head))])
    plots = [s for s in result.shapes if isinstance(s, Spread)]
    part = Part(result.lines[-1:], [shown])
    part.blocks += [Picture(svg(result, site, s, salt=s.name), s.y_label) for s in plots]
    return render("experiment.html", site=site.name, told=result.summary, part=part)
