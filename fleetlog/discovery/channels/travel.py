"""The speed channel: the time that stretches of a path took, against the quickest drive allowed."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.discovery.channels.base import Channel, Unit
from fleetlog.discovery.channels.lost import Lost, lost_time
from fleetlog.discovery.channels.paths import Day, Path, days, lay_out
from fleetlog.discovery.channels.travel_columns import TravelAbout
from fleetlog.discovery.hypotheses.cells import Stretches, make_stretches
from fleetlog.discovery.hypotheses.sources import ErrorSource, FreeCurve, time_curves
from fleetlog.discovery.model import Model
from fleetlog.discovery.recording.splits import HELD_OUT, Split
from fleetlog.discovery.settings import Settings
from fleetlog.physics.power import all_terms
from fleetlog.physics.term import Term

FEW = 3  # Stops from which on trucks wait at a place
SCATTER = 0.5  # Of waits, as a share of their mean, by what counts as one passage; the others tell the rest

GATHERS = 2.5  # The profile's error makes up so much more at some places: 6 % at most on clean recordings

ERRORS = (
    ErrorSource("setting off", 0.25), ErrorSource("stopping", 0.25), ErrorSource("slowing down", 0.25),
    ErrorSource("kinks", 0.5),
)  # fmt: skip
"""Nobody sets off, stops or takes a slow corner as sharply as constant accelerations would [s each]; and how
far trucks follow the kinks of the map's line no positions show (0: they drive curves, 1: every kink)."""


@dataclass
class TravelChannel(Channel):
    """Travel times of a fleet on its map; see :class:`fleetlog.discovery.channels.base.Channel`."""

    split: Split
    settings: Settings

    def __post_init__(self) -> None:
        network = self.fleet.network
        assert network is not None
        self.fleet = replace(self.fleet, interval={})
        self.roads, self.lanes = make_stretches(network), make_stretches(network, apart=True)
        self.metric = f"rms error of the time for {self.settings.stretch:.0f} m of path, over rms time"
        self.errors = list(ERRORS)
        # Half way between two rows a truck that gathers speed is a dt^2 / 8 off an even course, half of that
        # on the mean.
        unseen = self.fleet.truck.drive.max_acceleration * self.fleet.step**2 / 16.0
        self.model_error = max(self.settings.profile_error, unseen / self.settings.stretch)
        self.place_error = GATHERS * self.model_error

    def units(self) -> Iterator[Unit]:
        """Yield vehicle-days; their paths are small and stay in memory."""
        if not self._kept:
            made = (self._unit(day) for day in days(self.fleet, self.split))
            self._kept = self._with_stands([u for u in made if u is not None])
        yield from self._kept

    def _with_stands(self, made: list[Unit]) -> list[Unit]:
        """The units, told where trucks stood for no purpose: only there they waited, and times scatter so.

        A truck with another in its way waits there as well: of such passages only the standing counts.
        """
        n = len(self.lanes)
        passed, stops, seconds, squares = np.zeros((4, n))
        cells = [self.lanes.at(u.own.motion)[0].astype(np.int64) for u in made]
        for u, cell in zip(made, cells, strict=True):
            seen = ((u.whole | u.own.apart) & (self.split.fold(u.windows) != HELD_OUT))[u.own.of]
            begin = np.append(True, np.diff(cell) != 0)
            passed += np.bincount(cell[seen & begin], minlength=n)
            wait = np.where(seen, u.own.standing, 0.0)
            stops += np.bincount(cell[wait > 0.0], minlength=n)
            seconds += np.bincount(cell, wait, n)
            squares += np.bincount(cell, wait**2, n)
        stood = np.maximum(stops, 1.0)
        passed, usual = np.maximum(passed, stood), seconds / stood
        off = squares - seconds**2 / passed + (SCATTER * usual) ** 2
        scatter = np.where(stops >= FEW, off / passed, 0.0)
        out = []
        for u, cell in zip(made, cells, strict=True):
            noise = np.zeros(len(u.recorded))
            np.maximum.at(noise, u.own.of, scatter[cell])
            waits = stops[cell] >= FEW
            path = replace(u.own, share=np.where(waits, u.own.share, 0.0))
            apart = path.apart & (path.summed(waits.astype(float)) > 0.0)
            recorded = np.where(apart, u.level + path.summed(path.standing), u.recorded)
            out.append(replace(u, own=path, noise=noise, recorded=recorded, whole=u.whole | apart))
        return out

    def _unit(self, day: Day) -> Unit | None:
        found = lay_out(day, self.fleet, self.lanes, self.settings.stretch)
        if found is None:
            return None
        path, windows, recorded, whole = found
        unit = Unit(windows, recorded, whole, np.zeros(len(recorded)), recorded, np.ones(len(recorded)), path)
        return replace(unit, level=self.predict(unit, self.base))

    def about(self, own: Path, model: Model) -> TravelAbout:
        """Return what a model says of a path, (W,) [s], and columns about it."""
        physics = model.physics(int(own.motion.vehicle[0]), own.motion, self.cells)
        return TravelAbout(self, own, model, physics, self._waits(own, model))

    def _waits(self, path: Path, model: Model) -> Floats:
        total = np.zeros(len(path.s))
        for name, deviation in model.fields.items():
            term = all_terms()[name]
            if term.acts == "wait":
                m = path.motion
                there = model.share(name, int(m.vehicle[0]), m.time)
                total += np.maximum(deviation, 0.0)[self.lanes.at(m)[0]] * path.share * there
        return total

    def cells(self, term: Term | None) -> Stretches:
        """Return the cells of a field: of roads, or of each direction of them."""
        found = self.lanes if term is not None and term.one_way else self.roads
        return replace(found, odd=term is not None and term.odd)

    def terms(self) -> list[Term]:
        """Return the terms that change travel times."""
        return [t for t in all_terms().values() if t.acts in ("speed", "wait") and t.parameters]

    def curves(self) -> list[FreeCurve]:
        """Return the free curves that the recording can carry."""
        return time_curves(self.knots, len(self.fleet.vehicles))

    def state(self, own: Path) -> dict[str, Floats]:
        """Return the recorded variables that a mismatch may follow, by node."""
        m = own.motion
        return {
            "payload": m.payload, "time": (m.time / 3600.0) % 24.0, "soc": m.soc,
            "ambient_temperature": m.ambient_temperature, "speed": np.minimum(m.speed,
            self.fleet.truck.drive.max_speed),
            "curvature": np.abs(m.curvature), "heading": m.heading, "vehicle_id": m.vehicle.astype(float),
        }  # fmt: skip

    def lost(self, model: Model) -> Lost | None:
        """Return what other vehicles cost beyond a model."""
        term = next((t for t in all_terms().values() if t.acts == "traffic"), None)
        known = None if term is None else self.base.fields.get(term.name)
        passed = (
            (u.own, u.whole & ~u.own.behind, u.windows.trip,
             np.maximum(self._waits(u.own, model) - u.own.standing, 0.0)) for u in self.units()
        )  # fmt: skip
        return lost_time(passed, self.lanes, lambda path: self.about(path, model).seconds, known)

    def features(self, unit: Unit, model: Model) -> Floats:
        """Return place, direction, load and modelled time of every window: what makes two passes alike."""
        path, w = unit.own, unit.windows
        middle = np.searchsorted(path.of, np.arange(len(w))) + np.bincount(path.of) // 2
        m = path.motion
        time = self.predict(unit, model)
        return np.column_stack([
            w.x / 2.0, w.y / 2.0, 2.0 * np.cos(m.heading[middle]), 2.0 * np.sin(m.heading[middle]),
            m.payload[middle] / 500.0,
            time / max(float(np.sqrt(np.mean(time**2))), 1e-9) * 4.0, w.vehicle * 3.0,
        ])  # fmt: skip
