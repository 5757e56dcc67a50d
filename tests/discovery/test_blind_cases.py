"""The six shared recordings with keys, from the raw log to the verdict."""

from __future__ import annotations

import json
import re
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

from fleetlog.cli.main import cli as fleetlog

CASES = {
    "none": None, "aux": "auxiliary_load", "clock": "clock_offset", "cornering": "cornering_speed", "grade": "grade",
    "surface": "surface_resistance",
}  # fmt: skip
NUMBER = {
    "aux": ("added_power", "aux"),
    "clock": ("offset", "clock_offset"),
    "cornering": ("lateral_acceleration", "alat"),
    "surface": ("factor", "surface_factor"),
}


@pytest.fixture(scope="module")
def diagnosed(shared_data: Path, tmp_path_factory: pytest.TempPathFactory):
    """``fleetlog import`` and ``fleetlog diagnose --json`` of a case."""

    def run(case: str) -> dict:
        folder, out = shared_data / "blind" / case, tmp_path_factory.mktemp(case)
        log, site, truck = (str(folder / f) for f in ("recorded.csv.gz", "site.toml", "truck.toml"))
        data = str(out / "data")
        fleetlog(["import", log, "--site", site, "-o", data, "-q", "--no-recording"], standalone_mode=False)
        call = ["diagnose", data, "--truck", truck, "-o", str(out / "d"), "--json", "-q"]
        with redirect_stdout(StringIO()) as text:
            fleetlog(call, standalone_mode=False)
        for name in ("diagnosis.json", "model.toml", "report.html", "recording.rrd", "fields"):
            assert (out / "d" / name).exists()
        page = (out / "d" / "report.html").read_text(encoding="utf-8")
        return json.loads(text.getvalue()) | {"page": page}

    return run


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_the_key_is_found(case: str, diagnosed, shared_data: Path) -> None:
    found = diagnosed(case)
    key = json.loads((shared_data / "blind" / case / "key.json").read_text())
    terms = [f["term"] for f in found["findings"]]
    assert terms == ([] if CASES[case] is None else [CASES[case]])
    assert found["verdict"] == ("none" if CASES[case] is None else "found")
    better = [c["after"] < 0.8 * c["before"] for c in found["channels"]]
    assert any(better) == (CASES[case] is not None)
    bounds = [
        1.0 for a in found["adjustments"] if a["name"] == "rotational_inertia.factor" and a["value"] == 1.0
    ]
    assert not bounds
    if case == "aux":  # 262 W in twelve hours; what tolerances would say instead is no saving
        told = float(re.search(r"Together they add ([0-9.]+) kWh", found["page"])[1])
        assert told == pytest.approx(3.15, rel=0.1)
    if case in NUMBER:
        name, true = NUMBER[case]
        parameter = next(p for p in found["findings"][0]["parameters"] if p["name"] == name)
        assert parameter["low"] <= key["effect"][true] <= parameter["high"]
    if key["where"]:
        named = {e["edge_id"].removeprefix("-") for e in found["findings"][0]["where"]["edges"]}
        assert named == set(key["where"])
