"""Commands and functions are one thing: every option is an argument with the same default, and the other way round."""

from __future__ import annotations

import inspect
import json
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

import fleetlog
import fleetlog.analysis
from fleetlog.api.verb import Verb
from fleetlog.cli.main import OPTIONAL_OUTPUT, TELLING, cli, verb_lines
from fleetlog.core.arguments import Between, count_or_range, hour_range, moment, seconds, shift_hours
from fleetlog.registry import part_lines
from fleetlog.verbs.analyze import analyze

HEAVY = {"numpy", "pandas", "pyarrow", "scipy", "numba", "rerun", "matplotlib", "pyproj", "networkx", "click"}
TOLD = {p.name for p in TELLING} | {"help"}


def commands(
    command: click.Command = cli, path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """Every command that does something, with its words."""
    if not isinstance(command, click.Group):
        yield path, command
        return
    context = click.Context(command)
    for name in command.list_commands(context):
        found = command.get_command(context, name)
        assert found is not None
        yield from commands(found, (*path, name))


def function_of(path: tuple[str, ...]) -> Verb:
    """The function that a notebook calls for a command."""
    found = getattr(fleetlog, "import_" if path[0] == "import" else path[0])
    return getattr(found, path[1]) if len(path) > 1 else found


COMMANDS = list(commands())


@pytest.mark.parametrize(("path", "command"), COMMANDS, ids=[" ".join(p) for p, _ in COMMANDS])
def test_options_and_arguments_are_the_same(path: tuple[str, ...], command: click.Command) -> None:
    function = function_of(path)
    options = {p.name: p for p in command.params if p.name not in TOLD}
    arguments = inspect.signature(function).parameters
    assert options.keys() == arguments.keys()
    for name, parameter in arguments.items():
        option = options[name]
        if option.required:
            # A command must say where; a notebook may keep the answer in memory.
            assert parameter.default is parameter.empty or (
                name == "output" and path[0] not in OPTIONAL_OUTPUT
            )
        elif parameter.default is parameter.empty:
            # A file of settings may give it: it is asked for once that is read.
            assert "experiment" in options and option.default is None
        elif isinstance(parameter.default, tuple):
            assert option.default in (None, ",".join(map(str, parameter.default)))
        elif not getattr(option, "is_flag", False):
            assert option.default == parameter.default, name
        assert isinstance(option, click.Argument) or option.help, (path, name)


def test_every_verb_of_the_command_line_is_a_function() -> None:
    for name in verb_lines():
        assert callable(getattr(fleetlog, "import_" if name == "import" else name))
    assert set(dir(analyze)) == set(analyze.lines())
    for name in fleetlog.__all__:
        assert getattr(fleetlog, name) is not None


def test_import_loads_nothing_heavy_and_is_quick() -> None:
    code = "import sys, time; t = time.perf_counter(); import fleetlog; t = time.perf_counter() - t; print(t, *sys.modules)"
    seconds, *loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert not set(loaded) & HEAVY
    assert float(seconds) < 0.3


def test_a_function_stays_a_function_when_its_package_is_imported() -> None:
    import fleetlog.simulate.engine
    import fleetlog.view.palette as palette

    assert isinstance(fleetlog.simulate, Verb) and isinstance(fleetlog.view, Verb)
    assert fleetlog.simulate.engine.simulate is not None and palette.ROAD
    with pytest.raises(AttributeError):
        _ = fleetlog.nonsense


def test_the_same_answer_from_command_and_function(recorded: fleetlog.Result, tmp_path: Path) -> None:
    words = [
        "analyze",
        "trips",
        str(recorded.dataset.path),
        "--min-distance",
        "20",
        "--json",
        "-o",
        str(tmp_path / "o"),
    ]
    done = CliRunner().invoke(cli, words, standalone_mode=False)
    assert done.return_value == 0
    said = json.loads(done.stdout)
    answer = fleetlog.analyze.trips(recorded, min_distance=20)
    assert said.pop("output") == str(tmp_path / "o")
    assert said == json.loads(json.dumps(answer.summary))
    assert answer.save(tmp_path / "p").is_dir()
    assert {p.name for p in (tmp_path / "o").iterdir()} == {p.name for p in (tmp_path / "p").iterdir()}
    assert "<details>" in answer._repr_html_() and "image/png" in answer._repr_html_()


def test_frames_in_and_frames_out(recorded: fleetlog.Result) -> None:
    frame = recorded.dataset.read("T1").to_pandas()
    assert frame.timestamp.is_monotonic_increasing and str(frame.timestamp.dt.tz) == "UTC"
    own = fleetlog.analyze.trips(frame)
    of_one = fleetlog.analyze.trips(recorded).tables["trips"].query("vehicle_id == 'T1'")
    assert own.tables["trips"].distance.sum() == pytest.approx(of_one.distance.sum(), rel=1e-6)
    again = fleetlog.read_logs(frame, recording=False)
    assert again.summary["rows"] == len(frame)


def test_points_lie_where_the_site_says(recorded: fleetlog.Result) -> None:
    pytest.importorskip("geopandas")
    rows = recorded.dataset.read("T1")
    frame = recorded.dataset.site.frame
    points = rows.to_geopandas(frame)
    assert points.crs.to_epsg() == 4326 and len(points) == len(rows)
    metres = points.to_crs(points.estimate_utm_crs()).geometry
    step = metres.distance(metres.shift()).to_numpy()[1:]
    local = rows.to_geopandas().geometry
    assert step == pytest.approx(local.distance(local.shift()).to_numpy()[1:], rel=1e-3, abs=1e-4)


def test_wrong_arguments_say_what_is_wrong(recorded: fleetlog.Result) -> None:
    with pytest.raises(TypeError, match="did you mean 'threshold'"):
        fleetlog.analyze.density(recorded, treshold=3)
    with pytest.raises(ValueError, match="at least"):
        fleetlog.analyze.density(recorded, threshold=0)
    with pytest.raises(ValueError, match="laden"):
        fleetlog.analyze.heatmap(recorded, load="lade")
    with pytest.raises(ValueError, match="did you mean 'density'"):
        fleetlog.analyze("densty", recorded)


@pytest.mark.parametrize(
    ("check", "good", "bad"),
    [
        (Between(0, 1, above=True), {"0.5": 0.5, 1: 1.0}, ["0", "nan", "inf", "x", None, 1.1]),
        (Between(0, 9, whole=True), {"3": 3, 9: 9, 2.0: 2}, ["1.5", 2.5, "x", -1]),
        (seconds, {"8h": 28800.0, "90m": 5400.0, 600: 600.0, "1.5h": 5400.0}, ["soon", "-1h", "1000000h"]),
        (
            moment,
            {"1970-01-01T01:00:01+01:00": 1_000_000, "1970-01-01T00:00:01": 1_000_000},
            ["yesterday", "1950-01-01"],
        ),
        (hour_range, {"6-14": (6, 14), (22, 6): (22, 6)}, ["6", "6-25", "a-b"]),
        (shift_hours, {"22,6,14": (6, 14, 22), (6, 14): (6, 14)}, ["", "24", "x"]),
        (count_or_range, {"8": 8, 8: 8, "6..14": "6..14", "6,8": "6,8"}, ["0", "-1", "many"]),
    ],
)
def test_checks_take_texts_and_values(check, good, bad) -> None:
    for given, value in good.items():
        assert check(given) == value
    for given in bad:
        with pytest.raises(ValueError):
            check(given)


def test_temporary_datasets_end_with_python(sample: Path, tmp_path: Path) -> None:
    code = "import fleetlog, sys; r = fleetlog.read_logs(sys.argv[1], recording=False); print(r.dataset.path)"
    begun = time.monotonic()
    out = subprocess.run(
        [sys.executable, "-c", code, str(sample / "logs" / "T8.nmea.gz")],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()
    assert out and not Path(out).exists() and time.monotonic() - begun < 60


def test_every_answer_can_be_saved(recorded: fleetlog.Result, sample: Path, tmp_path: Path) -> None:
    described = fleetlog.info(sample / "site.toml")
    assert json.loads(described.save(tmp_path / "site.json").read_text())["kind"] == "site"
    assert fleetlog.open(recorded.save(tmp_path / "copy")).rows == recorded.dataset.rows
    with pytest.raises(fleetlog.FleetlogError, match="--overwrite"):
        recorded.save(tmp_path / "copy")
    assert recorded.save(tmp_path / "copy", overwrite=True).is_dir()
    with pytest.raises(fleetlog.FleetlogError, match="no dataset"):
        _ = described.dataset


def test_a_file_in_the_folder_of_analyses_is_an_analysis(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As docs/extend.md says, with the file that it prints."""
    page = (Path(__file__).parents[2] / "docs" / "extend.md").read_text(encoding="utf-8")
    (tmp_path / "idle.py").write_text(re.findall(r"```python\n(.*?)```", page, re.DOTALL)[0])
    monkeypatch.setattr(fleetlog.analysis, "__path__", [*fleetlog.analysis.__path__, str(tmp_path)])
    part_lines.cache_clear()
    assert analyze.lines()["idle"].startswith("Idle time")
    assert {o.name for o in analyze.idle.options} >= {"dataset", "below"}
    part_lines.cache_clear()
