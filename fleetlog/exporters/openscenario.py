"""ASAM OpenSCENARIO XML 1.2: every vehicle follows its trajectory, for esmini and the tools that read it.

Positions are world positions in the metres of the site, times seconds after the first row of all.  The road
network is that of a site whose map is OpenDRIVE.  Lost are loads, energy and labels.
"""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.trajectory import Trajectory
from fleetlog.errors import DataError, InputError
from fleetlog.exporters.base import Exporter, Selection

LENGTH, WIDTH, HEIGHT = 3.0, 1.2, 2.2
"""Of the box that stands for a truck, whose size a dataset does not tell [m]."""
MOST = 1_000_000
"""Rows that one scenario holds; it is built in memory."""
COLUMNS = ("x", "y", "z", "heading")


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """The scenario of the chosen vehicles."""
    try:
        from scenariogeneration import xosc
    except ImportError:
        what = "OpenSCENARIO needs the package scenariogeneration"
        raise InputError(what, do="install it with: pip install 'fleetlog[scenario]'") from None
    motions = _motions(selection)
    begin = min(int(t.time[0]) for days in motions.values() for t in days)
    end = max(int(t.time[-1]) for days in motions.values() for t in days)
    road_file = str(selection.dataset.site.source.get("network", {}).get("file", ""))
    roads = xosc.RoadNetwork(road_file if road_file.endswith(".xodr") else None)
    entities, init = xosc.Entities(), xosc.Init()
    box = xosc.BoundingBox(WIDTH, LENGTH, HEIGHT, 0.0, 0.0, 0.5 * HEIGHT)
    axles = (xosc.Axle(1.5, 0.5, 1.0, along, 0.25) for along in (0.9, -0.9))
    truck = xosc.Vehicle("truck", xosc.VehicleCategory.truck, box, *axles, 10.0, 5.0, 10.0)
    story = xosc.StoryBoard(init, _when(xosc, "stop", 1e-6 * (end - begin) + 1.0))
    for vehicle, days in motions.items():
        entities.add_scenario_object(vehicle, truck)
        init.add_init_action(vehicle, xosc.TeleportAction(_positions(xosc, days[0][:1])[0]))
        story.add_maneuver_group(_drive(xosc, vehicle, days, begin), _when(xosc, "start", 0.0, "start"))
    scenario = xosc.Scenario(
        selection.dataset.site.name, "fleetlog", xosc.ParameterDeclarations(), entities, story,
        roads, xosc.Catalog(), osc_minor_version=2,
        creation_date=datetime.fromtimestamp(1e-6 * begin, UTC).replace(tzinfo=None),
    )  # fmt: skip
    scenario.write_xml(str(path))
    return selection.counts


def _motions(selection: Selection) -> dict[str, list[Trajectory]]:
    """The placed rows of every vehicle that has any, day by day."""
    out: dict[str, list[Trajectory]] = {}
    for day in map(selection.placed, selection.days(COLUMNS)):
        if len(day):
            out.setdefault(day.vehicle_id, []).append(day)
        if selection.counts["rows"] > MOST:
            what = f"more than {MOST:,} rows are too many for one scenario"
            raise DataError(what, where=selection.dataset.path, do="choose vehicles with --vehicle")
    if not any(len(day) > 1 for days in out.values() for day in days):
        raise DataError("no vehicle moves", where=selection.dataset.path, do="export rows with positions")
    return out


def _when(xosc: Any, name: str, seconds: float, point: str = "stop") -> Any:
    condition = xosc.SimulationTimeCondition(seconds, xosc.Rule.greaterOrEqual)
    return xosc.ValueTrigger(name, 0.0, xosc.ConditionEdge.none, condition, point)


def _positions(xosc: Any, t: Trajectory) -> list[Any]:
    columns = (np.nan_to_num(t.floats(n)) if t.has(n) else np.zeros(len(t)) for n in COLUMNS)
    return [xosc.WorldPosition(*place) for place in zip(*(c.tolist() for c in columns), strict=True)]


def _drive(xosc: Any, vehicle: str, days: list[Trajectory], begin: int) -> Any:
    """The manoeuvre group of a vehicle that follows its trajectory by the clock of the scenario."""
    time = np.concatenate([t.time for t in days])
    positions = [p for t in days for p in _positions(xosc, t)]
    trajectory = xosc.Trajectory(f"{vehicle} motion", False)
    trajectory.add_shape(xosc.Polyline((1e-6 * (time - begin)).tolist(), positions))
    follow = xosc.FollowTrajectoryAction(
        trajectory, xosc.FollowingMode.position, xosc.ReferenceContext.absolute, 1.0, 0.0
    )
    event = xosc.Event(f"{vehicle} event", xosc.Priority.override)
    event.add_action(f"{vehicle} follows", follow)
    event.add_trigger(_when(xosc, f"{vehicle} sets off", 0.0, "start"))
    manoeuvre = xosc.Maneuver(f"{vehicle} manoeuvre")
    manoeuvre.add_event(event)
    group = xosc.ManeuverGroup(f"{vehicle} group")
    group.add_actor(vehicle)
    group.add_maneuver(manoeuvre)
    return group


EXPORTER = Exporter("openscenario", ".xosc", "OpenSCENARIO XML: every vehicle follows its trajectory", write)
