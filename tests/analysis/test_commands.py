"""The commands over the analyses: what is written, what is refused."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from fleetlog.cli.main import cli
from fleetlog.core.result import Marks, Result
from fleetlog.core.site import Site


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


def test_a_picture_of_the_busiest_flows_says_of_how_many():
    from matplotlib.figure import Figure

    from fleetlog.core.result import Flows
    from fleetlog.view.floorplan import draw_overlay

    at = np.array([[0.0, 0.0], [9.0, 9.0]])
    for pairs, told in (
        (87, "widest arrow: 7 trips; the 2 busiest of 87 pairs"),
        (2, "widest arrow: 7 trips"),
    ):
        axes = Figure().add_subplot()
        draw_overlay(
            axes,
            Result("r", {}, shapes=[Flows("f", at, at[::-1], np.array([7.0, 2.0]), "trips", pairs)]),
            Site("s"),
        )
        assert axes.get_legend_handles_labels()[1] == [told]


def test_marks_are_drawn_on_every_map(fleet):
    from matplotlib.figure import Figure

    from fleetlog.view.floorplan import draw_overlay

    marks = [
        Marks(n, np.array([[1.0, 1.0]]), (label,), np.ones(1)) for n, label in (("m", "here"), ("n", "all"))
    ]
    axes = Figure().add_subplot()
    draw_overlay(axes, Result("r", {}, shapes=marks), Site("s"))
    assert {t.get_text() for t in axes.texts} == {"here", "all"}
