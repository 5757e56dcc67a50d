"""The commands over the analyses: what is written, what is refused."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from fleetlog.cli.main import cli
from fleetlog.core.result import Grid, Marks, Result


def run(*arguments):
    return CliRunner().invoke(cli, [str(a) for a in arguments])


@pytest.mark.parametrize(
    "options", [("--check",), ("--metric", "energy"), ("--capacity", "0"), ("--soc", "2")]
)
def test_chargers_refuses_what_cannot_be(fleet, tmp_path, options):
    got = run("analyze", "chargers", fleet.path, *options, "-o", tmp_path / "o")
    assert got.exit_code == 2 and not (tmp_path / "o").exists()


def test_heatmap_by_vehicle_writes_a_raster_each(fleet, tmp_path):
    got = run(
        "analyze", "heatmap", fleet.path, "--cell", 4, "--by", "vehicle", "--json", "-o", tmp_path / "o"
    )
    assert got.exit_code == 0, got.output
    by = json.loads(got.stdout)["by"]
    assert sorted(p.stem for p in (tmp_path / "o").glob("*.tif")) == sorted(by) == fleet.vehicles
    assert (
        run(
            "analyze", "heatmap", fleet.path, "--by", "hour", "--compare", fleet.path, "-o", tmp_path / "p"
        ).exit_code
        == 2
    )


def test_marks_of_one_map_are_not_drawn_on_another(fleet):
    from matplotlib.figure import Figure

    from fleetlog.view.floorplan import draw_overlay

    xy = np.array([[1.0, 1.0]])
    grids = [Grid(n, np.ones((2, 2)), 0, 0, 1.0, "s") for n in ("a", "b")]
    result = Result(
        "r",
        {},
        shapes=[*grids, Marks("m", xy, ("here",), np.ones(1), on="a"), Marks("n", xy, ("all",), np.ones(1))],
    )
    drawn = {}
    for name in ("a", "b"):
        axes = Figure().add_subplot()
        draw_overlay(axes, result, name)
        drawn[name] = {t.get_text() for t in axes.texts}
    assert drawn == {"a": {"here", "all"}, "b": {"all"}}
