"""What `simulate` writes, read by `diagnose`: an effect that it was given, and nothing that trucks do in bays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import fleetlog

SAMPLE = Path(__file__).parents[2] / "sample_data"


def told(
    folder: Path, physics: str, channels: tuple[str, ...], vehicles: int = 5, **truck: Any
) -> dict[str, dict[str, Any]]:
    """The findings by term of an hour of the sample plant with ``physics``, congestion left out."""
    text = (SAMPLE / "truck.toml").read_text()
    for key, value in truck.items():
        text = "\n".join(
            f"{key} = {value}" if line.startswith(f"{key} =") else line for line in text.split("\n")
        )
    (folder / "truck.toml").write_text(text)
    (folder / "model.toml").write_text(physics)
    fleetlog.simulate(
        site=SAMPLE / "site.toml", truck=folder / "truck.toml", physics=folder / "model.toml", vehicles=vehicles,
        duration="1h", shadow=False, recording=False, output=folder / "day",
    )  # fmt: skip
    found = fleetlog.diagnose(folder / "day", truck=folder / "truck.toml", channels=channels).summary[
        "findings"
    ]
    return {f["term"]: f for f in found if f["term"] != "congestion"}


def within(finding: dict[str, Any], name: str, value: float) -> bool:
    (p,) = [p for p in finding["parameters"] if p["name"] == name]
    return bool(p["low"] <= value <= p["high"])


def test_how_trucks_drive_in_bays_is_no_finding(tmp_path: Path) -> None:
    """They turn into them at a walking pace and back out: 6 s a trip beyond what roads and truck allow."""
    assert told(tmp_path, "", ("speed",)) == {}


@pytest.mark.slow
def test_a_lower_acceleration_is_told_from_bays(tmp_path: Path) -> None:
    found = told(tmp_path, "[term.acceleration_limit]\nacceleration = 0.35\n", ("speed",))
    assert list(found) == ["acceleration_limit"]
    assert within(found["acceleration_limit"], "acceleration", 0.35)


@pytest.mark.slow
def test_trucks_slower_with_a_load_are_told_from_bays(tmp_path: Path) -> None:
    found = told(tmp_path, "[term.laden_speed]\nfactor = 0.7\n", ("speed",))
    assert list(found) == ["laden_speed"]
    assert within(found["laden_speed"], "factor", 0.7)


@pytest.mark.slow
@pytest.mark.parametrize("term", ["rolling_resistance", "brake_drag"])
def test_without_loads_a_drag_is_that_of_the_truck_file_and_the_other_is_not_excluded(
    term: str, tmp_path: Path
) -> None:
    """Of a truck that always weighs the same, both are one force."""
    name, value = {"rolling_resistance": ("coefficient", 0.019), "brake_drag": ("brake_force", 350.0)}[term]
    found = told(tmp_path, f"[term.{term}]\n{name} = {value}\n", ("battery_power",), rated_load=0)
    assert list(found) == ["rolling_resistance"]
    assert "unknown(driving)" in found["rolling_resistance"]["not_excluded"]


@pytest.mark.slow
def test_two_numbers_that_hide_one_another_are_both_told(tmp_path: Path) -> None:
    """Lifts take as much as ever where loads weigh less and the mast is less efficient: neither is told alone."""
    physics = "[term.payload]\nfactor = 0.7\n[term.lift_efficiency]\nefficiency = 0.45\n"
    found = told(tmp_path, physics, ("battery_power",))
    assert found.keys() == {"payload", "lift_efficiency"}
    assert within(found["payload"], "factor", 0.7) and within(found["lift_efficiency"], "efficiency", 0.45)
