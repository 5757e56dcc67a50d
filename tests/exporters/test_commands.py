"""``fleetlog export`` and ``fleetlog info`` as a user calls them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from fleetlog.cli.main import load_verb
from fleetlog.errors import FleetlogError
from fleetlog.exporters import base
from fleetlog.importers.base import importers
from fleetlog.verbs.info import describe, told

FORMATS = base.FORMATS.names()
NETWORKS = {"sumo-net", "opentcs", "open-rmf"}


def test_help_lists_every_format() -> None:
    text = next(p.help for p in load_verb("export").params if p.name == "to")
    assert text.endswith(f": {', '.join(FORMATS)}.")
    logs = next(p.help for p in load_verb("import").params if p.name == "format")
    assert logs.endswith(f": {', '.join(sorted(importers()))}.")


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_from_the_command(name: str, make_dataset, tmp_path: Path) -> None:
    dataset = make_dataset(vehicles=1, tasks=4)
    out = tmp_path / "out"
    done = CliRunner().invoke(
        load_verb("export"),
        [str(dataset.path), "--to", name, "-o", str(out), "--json"],
        catch_exceptions=False,
    )
    summary = json.loads(done.stdout)
    assert done.exit_code == 0
    assert summary["rows"] == (9 if name in NETWORKS else 4 if name == "tasks" else dataset.rows)
    assert summary["bytes"] == out.stat().st_size


def test_info_of_a_dataset_and_of_its_exports(make_dataset, tmp_path: Path) -> None:
    dataset = make_dataset(vehicles=2)
    summary = describe(dataset.path)
    assert (summary["kind"], summary["rows"], len(summary["vehicles"])) == ("dataset", dataset.rows, 2)
    assert f"  rows             {dataset.rows}" in told(summary)
    for name in ("csv", "gpx", "geojson", "mcap", "parquet", "sumo-fcd"):
        out = tmp_path / ("x.fcd.xml" if name == "sumo-fcd" else f"x.{name}")
        CliRunner().invoke(
            load_verb("export"), [str(dataset.path), "--to", name, "-o", str(out)], catch_exceptions=False
        )
        done = CliRunner().invoke(
            load_verb("info"), [str(out), "--json"], catch_exceptions=False, standalone_mode=False
        )
        said = json.loads(done.stdout)
        assert (said["kind"], said["format"], said["rows"]) == ("log", name, dataset.rows)
        assert done.return_value == 0


def test_info_shows_lists_as_tables_and_breaks_long_lines() -> None:
    rows = [{"name": f"n{k}", "speed_m_s": 0.123456, "none": None} for k in range(20)]
    figures = {"kind": "analysis", "path": "p", "driven_wh_per_km": 547.4, "kwh_per_km": 0.5474, "rows": rows}
    found = [{"term": "grade", "channel": "soc", "statement": "The road climbs by up to 8 %"}] * 2
    shown = told(figures | {"findings": found, "columns": [f"column_{k}" for k in range(30)]})
    assert "  driven [kWh/km]  0.5474" in shown and "  energy [kWh/km]  0.5474" in shown
    start = shown.index("  rows")
    assert shown[start + 1 : start + 3] == ["    name  speed [m/s]", "    n0    0.1235"]
    assert shown[start + 14] == "    and 8 more: --json has them all"
    assert "  findings         grade (soc): The road climbs by up to 8 %." in shown
    assert max(map(len, shown)) <= 100 and shown[-1].startswith(" " * 19)


def test_info_of_roads_site_and_truck(project_root: Path) -> None:
    sample = project_root / "sample_data"
    roads = describe(sample / "roads.geojson")
    site = describe(sample / "site.toml")
    truck = describe(sample / "truck.toml")
    assert (roads["kind"], site["kind"], truck["kind"]) == ("map", "site", "truck")
    assert roads["reports"][0]["kept"] == roads["reports"][0]["read"] == 40
    assert roads["length_m"] == pytest.approx(site["length_m"], rel=1e-3)
    assert truck["chassis"]["mass"] > 0
    assert any("GeoJSON, read 40, kept 40" in line for line in told(site))


def test_info_of_a_recording(tmp_path: Path) -> None:
    rr = pytest.importorskip("rerun")
    import numpy as np

    path = tmp_path / "x.rrd"
    with rr.RecordingStream("fleetlog", recording_id="shift") as rec:
        rec.save(str(path))
        times = np.arange(5).astype("datetime64[s]").astype("datetime64[ns]")
        rec.send_columns(
            "soc/T1", [rr.TimeColumn("utc", timestamp=times)], rr.Scalars.columns(scalars=np.arange(5.0))
        )
    summary = describe(path)
    assert summary["recordings"][0]["entities"] == {"/soc/T1": 5}
    assert summary["recordings"][0]["timelines"] == ["utc"]
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(FleetlogError) as caught:
        describe(path)
    assert "\n" not in caught.value.line()


def test_info_of_nothing_known(tmp_path: Path) -> None:
    for name, data in (
        ("a.bin", bytes(range(256))),
        ("a.toml", b"x = 1"),
        ("b.toml", b"x ="),
        ("a.txt", b""),
        ("a.xml", b"<a/>"),
    ):
        path = tmp_path / name
        path.write_bytes(data)
        with pytest.raises(FleetlogError) as caught:
            describe(path)
        assert str(path) in caught.value.line()


def test_info_says_3_for_a_damaged_log(tmp_path: Path) -> None:
    path = tmp_path / "a.tum"
    path.write_text("1772431200.5 1 2 3 0 0 0 1\n1772431201.5 1 2 3 0 0 0 1\nbroken\n")
    done = CliRunner().invoke(load_verb("info"), [str(path)], standalone_mode=False)
    assert done.return_value == 3
    assert re.search(r"rejected .* 1$", done.stdout, re.MULTILINE)


def test_info_of_a_folder_of_results(make_dataset, tmp_path: Path) -> None:
    import fleetlog

    out = tmp_path / "trips"
    answer = fleetlog.analyze.trips(make_dataset(vehicles=2).path, output=out)
    found = describe(out)
    assert found["kind"] == "analysis" and found["summary"]["trips"] == answer.summary["trips"]
    assert "trips.json" in found["files"] and f"  trips            {found['summary']['trips']}" in told(found)
