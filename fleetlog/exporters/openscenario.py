"""ASAM OpenSCENARIO XML 1.2: every vehicle follows its trajectory, for esmini and the tools that read it.

Positions are world positions in the metres of the site, times seconds after the first row of all.  The road
network is the map that was read of a site whose map is OpenDRIVE.  Lost are loads, energy and labels."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.errors import DataError
from fleetlog.exporters.base import Selection
from fleetlog.registry import extra

LENGTH, WIDTH, HEIGHT = 3.0, 1.2, 2.2
"""Of the box that stands for a truck [m]; a simulation tells length and width of its own."""
MOST = 1_000_000  # Rows that one scenario holds; it is built in memory
COLUMNS = ("x", "y", "z", "heading")


def write(selection: Selection, path: Path) -> None:
    """The scenario of the chosen vehicles."""
    xosc = extra("scenariogeneration.xosc", "scenario", "OpenSCENARIO needs the package scenariogeneration")
    motions = _motions(selection)
    begin = min(rows[0, 0] for rows in motions.values())
    end = max(rows[-1, 0] for rows in motions.values())
    about = selection.dataset.site.source.get("network", {})
    road_file = str(about.get("path", about.get("file", "")))
    roads = xosc.RoadNetwork(road_file if road_file.lower().endswith(".xodr") else None)
    size = {"length": LENGTH, "width": WIDTH, **selection.dataset.meta["provenance"].get("truck", {})}
    entities, init = xosc.Entities(), xosc.Init()
    box = xosc.BoundingBox(size["width"], size["length"], HEIGHT, 0.0, 0.0, 0.5 * HEIGHT)
    axles = (xosc.Axle(1.5, 0.5, 1.0, along * size["length"], 0.25) for along in (0.3, -0.3))
    truck = xosc.Vehicle("truck", xosc.VehicleCategory.truck, box, *axles, 10.0, 5.0, 10.0)
    story = xosc.StoryBoard(init, _when(xosc, "stop", 1e-6 * (end - begin) + 1.0))
    for vehicle, rows in motions.items():
        time, positions = 1e-6 * (rows[:, 0] - begin), [xosc.WorldPosition(*p) for p in rows[:, 1:].tolist()]
        entities.add_scenario_object(vehicle, truck)
        init.add_init_action(vehicle, xosc.TeleportAction(positions[0]))
        # It follows its trajectory by the clock of the scenario.
        trajectory = xosc.Trajectory(f"{vehicle} motion", False)
        trajectory.add_shape(xosc.Polyline(time.tolist(), positions))
        how = xosc.FollowingMode.position, xosc.ReferenceContext.absolute, 1.0, 0.0
        event = xosc.Event(f"{vehicle} event", xosc.Priority.override)
        event.add_action(f"{vehicle} follows", xosc.FollowTrajectoryAction(trajectory, *how))
        event.add_trigger(_when(xosc, f"{vehicle} sets off", 0.0, "start"))
        manoeuvre = xosc.Maneuver(f"{vehicle} manoeuvre")
        manoeuvre.add_event(event)
        story.add_maneuver(manoeuvre, vehicle, _when(xosc, "start", 0.0, "start"))
    scenario = xosc.Scenario(
        selection.dataset.site.name, "fleetlog", xosc.ParameterDeclarations(), entities, story,
        roads, xosc.Catalog(), osc_minor_version=2,
        creation_date=datetime.fromtimestamp(1e-6 * begin, UTC).replace(tzinfo=None),
    )  # fmt: skip
    scenario.write_xml(str(path))


def _motions(selection: Selection) -> dict[str, Floats]:
    """Time [us], x, y, z and heading of the placed rows of every vehicle that has any."""
    out: dict[str, Floats] = {}
    for t in map(selection.placed, selection.days(COLUMNS)):
        rows = np.column_stack([t.time, *(np.nan_to_num(t.floats(n)) for n in COLUMNS)])
        if len(t):
            out[t.vehicle_id] = np.concatenate([out.get(t.vehicle_id, rows[:0]), rows])
        if selection.counts["rows"] > MOST:
            what = f"more than {MOST:,} rows are too many for one scenario"
            raise DataError(what, where=selection.dataset.path, do="choose vehicles with --vehicle")
    if not any(len(rows) > 1 for rows in out.values()):
        raise DataError("no vehicle moves", where=selection.dataset.path, do="export rows with positions")
    return out


def _when(xosc: Any, name: str, seconds: float, point: str = "stop") -> Any:
    condition = xosc.SimulationTimeCondition(seconds, xosc.Rule.greaterOrEqual)
    return xosc.ValueTrigger(name, 0.0, xosc.ConditionEdge.none, condition, point)
