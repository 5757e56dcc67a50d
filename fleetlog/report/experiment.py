"""The page of an experiment: variants with intervals and changes, plots, and what limits each variant."""

from fleetlog.core.result import Result, Spread
from fleetlog.core.site import Site
from fleetlog.core.words import listed
from fleetlog.report.content import Part, Picture, Table, render
from fleetlog.simulate.scenario import told_rows
from fleetlog.view.picture import svg


def experiment_page(result: Result, site: Site) -> str:
    """One file; the summary of the result tells its ``provenance``."""
    table, names = result.tables["variants"], [*result.summary["factors"]]
    head, *rows = told_rows(table, names)
    best = dict(zip(head, rows[int(table.tasks_per_h.argmax())], strict=True))
    which = listed([f"{name} {best[name]}" for name in names])
    shown = Table(head, rows, [len(names) <= k < len(head) - 1 for k in range(len(head))])
    plots = [s for s in result.shapes if isinstance(s, Spread)]
    part = Part([f"Most tasks are done with {which}: {best['tasks/h']} per hour."], [shown])
    part.blocks += [Picture(svg(result, site, s, salt=s.name), s.y_label) for s in plots]
    return render("experiment.html", site=site.name, told=result.summary, part=part)
