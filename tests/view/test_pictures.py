"""Pictures and recordings of results, and the folder of an analysis."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rrd
from fixtures_view import plant
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image
from shapes import every_shape

from fleetlog.api.answer import Answer
from fleetlog.core.result import (
    Bars,
    EdgeValues,
    Flows,
    Grid,
    Marks,
    MovingLines,
    Result,
    Series,
    Shape,
    Spread,
    half_width,
)
from fleetlog.core.site import Site
from fleetlog.errors import OutputError
from fleetlog.view.floorplan import PLACES
from fleetlog.view.palette import scale_of, scales_of, screen_colours
from fleetlog.view.picture import draw_bars, draw_series, draw_spread, panel_height, svg, write_picture
from fleetlog.view.results import write_result_recording

EMPTY: list[Shape] = [
    Grid("g", np.full((3, 4), np.nan), 0, 0, 1, "s"),
    EdgeValues("e", np.zeros(0, np.int32), np.zeros(0), np.zeros(0), np.zeros(0), "J"),
    Marks("m", np.zeros((0, 2)), (), np.zeros(0)),
    Marks("n", np.full((2, 2), np.nan), ("A", "B"), np.ones(2)),
    MovingLines("l", np.zeros(0, np.int64), (), ()),
    Series("s", np.zeros(0), {}, "x", "y"),
    Series("t", np.zeros(0, np.int64), {"a": np.zeros(0)}, "x", "y", over_time=True),
    Bars("b", (), np.zeros(0), "s"),
]


def pixels(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def test_what_has_no_place_is_no_mark() -> None:
    xy = np.array([[1.0, 2.0], [np.nan, 3.0], [4.0, 5.0]])
    marks = Marks("m", xy, ("A", "B", "C"), np.array([1.0, 2.0, 3.0]))
    assert marks.labels == ("A", "C") and marks.xy.tolist() == [[1.0, 2.0], [4.0, 5.0]]
    assert marks.size.tolist() == [1.0, 3.0]


@pytest.mark.parametrize("site", [plant(), Site("bare")])
@pytest.mark.parametrize("shape", [*EMPTY, None])
def test_nothing_to_draw_is_no_error(tmp_path: Path, shape: Shape | None, site: Site) -> None:
    result = Result("empty", {}, shapes=[] if shape is None else [shape], lines=["nothing found"])
    assert pixels(write_picture(result, site, tmp_path / "p.png")).std() > 0
    assert write_result_recording(result, site, tmp_path / "r.rrd").stat().st_size > 0


@pytest.mark.parametrize("shape", every_shape().shapes, ids=lambda s: s.name)
def test_every_shape_alone_changes_the_picture(tmp_path: Path, shape: Shape) -> None:
    site = plant()
    alone = pixels(write_picture(Result("r", {}, shapes=[shape]), site, tmp_path / "a.png"))
    bare = pixels(
        write_picture(
            Result("r", {}, shapes=[Marks("m", np.zeros((0, 2)), (), np.zeros(0))]), site, tmp_path / "b.png"
        )
    )
    assert alone.shape[1] >= 600
    assert alone.shape != bare.shape or (np.abs(alone - bare).sum(axis=2) > 60).sum() > 500


def test_heat_lies_where_its_cells_are(tmp_path: Path) -> None:
    """A heat cell moved to the north-east moves its ink right and up in the picture."""
    site = plant()

    def centre(row: int, column: int) -> np.ndarray:
        values = np.full((40, 60), np.nan)
        values[row : row + 6, column : column + 6] = np.linspace(90, 100, 36).reshape(6, 6)
        image = pixels(
            write_picture(
                Result("r", {}, shapes=[Grid("g", values, 0, 0, 1.0, "s")]), site, tmp_path / "p.png"
            )
        )
        map_only = image[: int(0.8 * len(image))]
        dark = (map_only.max(axis=2) < 90) & (map_only[..., 2] > map_only[..., 1] + 10)
        return np.argwhere(dark).mean(axis=0)

    south_west, north_east = centre(2, 2), centre(30, 50)
    assert north_east[0] < south_west[0] - 100 and north_east[1] > south_west[1] + 100


def test_grid_in_the_recording(tmp_path: Path) -> None:
    """The viewer's first row is the northern one; empty cells are transparent and insignificant ones pale."""
    values = np.array([[1.0, np.nan, 3.0], [4.0, 5.0, 0.0]])
    mask = np.array([[True, True, False], [True, True, True]])
    grid = Grid("heat", values, 10.0, 20.0, 2.0, "s", mask=mask)
    out = write_result_recording(Result("r", {}, shapes=[grid]), plant(), tmp_path / "r.rrd")
    _, data = rrd.column(out, "/result/heat", "GridMap:data", None)
    image = np.array(data.flatten().to_pylist()[0], np.uint8).reshape(2, 3, 4)
    assert (image[..., 3] > 0).tolist() == [[True, True, False], [True, False, True]]
    assert image[1, 2, 3] < 80 and image[1, 0, 3] == 255
    brightness = image[..., :3].sum(axis=2)
    assert brightness[0, 1] > brightness[0, 0] > brightness[1, 0]
    _, where = rrd.column(out, "/result/heat", "GridMap:translation", None)
    assert where.flatten().to_pylist()[0][:2] == [10.0, 20.0]


@given(
    hnp.arrays(float, st.integers(1, 40), elements=st.floats(-1e6, 1e6) | st.just(float("nan"))),
    st.booleans(),
)
def test_scale_holds_the_values(values: np.ndarray, diverging: bool) -> None:
    scale = scale_of(values, diverging)
    assert scale.high > scale.low
    known = values[np.isfinite(values)]
    if diverging:
        assert scale.low == -scale.high
    elif len(known) and not scale.clipped:
        assert scale.low <= known.min() and known.max() <= scale.high
    assert ((screen_colours(values, scale)[..., 3] == 0) == np.isnan(values)).all()


def test_zero_of_a_diverging_scale_is_neutral() -> None:
    grey = screen_colours(np.array([0.0]), scale_of(np.array([-1.0, 7.0]), True))[0, :3].astype(int)
    assert np.ptp(grey) < 12


def test_maps_of_one_label_share_their_scale() -> None:
    """Before and after are told apart by their colours, not by their legends."""

    def grid(name: str, top: float, label: str = "W") -> Grid:
        return Grid(name, np.array([[0.0, top]]), 0, 0, 1, label, diverging=True)

    scales = scales_of([grid("before", 8.0), grid("after", 1.0), grid("other", 3.0, "J")])
    assert scales["before"] == scales["after"] and scales["after"].high == 8.0 and scales["other"].high == 3.0


def test_folder_of_an_analysis(tmp_path: Path) -> None:
    folder = Answer.of(every_shape(), plant()).save(tmp_path / "out")
    assert {p.name for p in folder.iterdir()} >= {
        "everything.json", "everything.png", "recording.rrd", "numbers.parquet", "sites.parquet", "sites.geojson",
    }  # fmt: skip
    assert json.loads((folder / "everything.json").read_text())["share"] is None
    with pytest.raises(OutputError, match="--overwrite"):
        Answer.of(every_shape(), plant()).save(folder)


def test_folder_is_whole_or_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = Answer.of(every_shape(), plant()).save(tmp_path / "out")
    before = (folder / "everything.json").read_bytes()
    monkeypatch.setattr("fleetlog.view.results.write_result_recording", lambda *a: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        Answer.of(replace(every_shape(), summary={"rows": 1}), plant()).save(folder, overwrite=True)
    assert (folder / "everything.json").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("values", [("2", "4", "6"), ("none", "a-road", "another-road")])
def test_an_experiment_draws_every_run_and_the_interval_of_their_mean(values):
    from matplotlib.figure import Figure

    runs = [np.array([1.0, 2.0, 3.0]), np.array([4.0]), np.array([])]
    axes = Figure().subplots()
    draw_spread(axes, Spread("rate", values, {"": runs}, "x", "y"))
    number = values[0].isdigit()
    dots = [line for line in axes.lines if line.get_marker() == "."]
    drawn = np.concatenate([line.get_ydata() if number else line.get_xdata() for line in dots])
    np.testing.assert_array_equal(drawn, np.concatenate(runs))
    (bars,) = axes.containers
    ends = np.array(bars.lines[2][0].get_segments()[0])[:, 1 if number else 0]
    np.testing.assert_allclose(ends, 2.0 + np.array([-1, 1]) * half_width(runs[0]))
    labels = axes.get_xticklabels() if number else axes.get_yticklabels()
    assert [text.get_text() for text in labels] == list(values)


def drawn(site: Site, *shapes: Shape) -> str:
    """The texts of a picture."""
    result = Result("r", {}, shapes=[*shapes], lines=["Three trucks waited.", "  T1: 4 s"])
    layer = next((s for s in shapes if isinstance(s, Grid | EdgeValues)), None)
    return svg(result, site, layer)


def test_the_legend_names_all_marks_lines_arrows_and_places() -> None:
    at = np.array([[1.0, 2.0], [30.0, 9.0]])
    lines = MovingLines("l", np.array([0]), (np.array([at]),), (np.array([True]),), "trucks close by")
    flows = Flows("f", at, at[::-1], np.array([7.0, 2.0]), "trips", 9)
    text = drawn(plant(), Marks("end of a trip", at, ("A", ""), np.ones(2)), lines, flows)
    for name in (
        "end of a trip",
        "trucks close by, slow: critical",
        "widest arrow: 7 trips; the 2 busiest of 9 pairs",
    ):
        assert text.count(f">{name}<") == 1, name
    for kind in {p.kind for p in plant().places}:
        assert f">{PLACES[kind]}<" in text


def test_a_difference_that_is_chance_alone_says_so_and_is_not_blank() -> None:
    values, name = np.array([[1.0, -2.0], [0.5, 3.0]]), "No cell differs by more than chance"

    def grid(mask: np.ndarray) -> Grid:
        return Grid("difference", values, 0.0, 0.0, 10.0, "s", True, mask)

    chance, some = (drawn(plant(), grid(values > bar)) for bar in (9.0, 0.0))
    assert name in chance and "pale" not in chance
    assert name not in some and "pale: no more than chance" in some


def test_bars_show_their_numbers_and_have_the_colours_of_their_curves() -> None:
    from matplotlib.figure import Figure

    bars = Bars("b", ("lifting", "rolling"), np.array([12.34, 5.0]), "kWh")
    curves = Series("s", np.arange(3.0), {"rolling": np.ones(3), "lifting": np.ones(3)}, "t", "kW")
    axes, other = Figure().subplots(2)
    draw_bars(axes, bars, [curves])
    draw_series(other, curves)
    assert [t.get_text() for t in axes.texts] == ["12.3", "5.0"]
    colours = dict(zip(curves.y, [line.get_color() for line in other.lines], strict=True))
    assert [p.get_facecolor()[:3] for p in axes.patches] == [colours[name] for name in bars.labels]


def test_a_legend_of_many_curves_lies_on_no_data() -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    runs = [np.array([1.0, 2.0]), np.array([3.0, 4.0])]
    curves = {f"policy opportunity, close gate-{k}+gate-{k + 1}": runs for k in range(6)}
    shape = Spread("rate", ("1", "2"), curves, "x", "y")
    figure = Figure(figsize=(4.0, panel_height(shape)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    draw_spread(axes, shape)
    figure.draw_without_rendering()
    legend, data = axes.get_legend().get_window_extent(), axes.get_window_extent()
    assert len(axes.get_legend().get_texts()) == 6 and legend.y0 >= data.y1 - 1.0
    assert data.height > 1.2 * figure.dpi  # there is room left for the curves
