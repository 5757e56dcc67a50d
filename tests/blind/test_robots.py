"""Robots that turn on the spot: standing in a turn is no traffic, and no place to wait."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import robots
from degrade import diagnosed

pytestmark = pytest.mark.slow


def told(folder: Path, concealed: str) -> dict[str, Any]:
    robots.record(folder, concealed)
    found = diagnosed(folder, "nothing")
    return {f["term"]: f for f in found["findings"]} | {"verdict": found["verdict"]}


def test_nothing_is_missing_where_robots_turn_on_the_spot(tmp_path: Path) -> None:
    """They stand at every corner, half of the time with another near, who is never in their way."""
    assert told(tmp_path, "") == {"verdict": "none"}


def test_a_brake_of_one_robot_is_told(tmp_path: Path) -> None:
    found = told(tmp_path, "drag")
    assert found.keys() == {"verdict", "unknown"}
    (force,) = found["unknown"]["parameters"]
    assert found["unknown"]["scope"]["vehicles"] == ["R2"] and force["low"] <= 40.0 <= force["high"]


def test_a_door_is_a_place_to_wait_and_no_traffic(tmp_path: Path) -> None:
    """All robots wait there, whoever is near."""
    found = told(tmp_path, "door")
    assert found.keys() == {"verdict", "waiting"}
