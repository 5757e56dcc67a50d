"""The speed channel: the time that stretches of a path took, against the quickest drive allowed."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.core.motion import Motion
from fleetlog.discovery.channels.base import Channel, Columns, Unit
from fleetlog.discovery.channels.lost import Lost, lost_time
from fleetlog.discovery.channels.paths import Day, Path, days, joined, lay_out
from fleetlog.discovery.channels.travel_columns import About, drive_times, summed
from fleetlog.discovery.hypotheses.cells import Stretches, make_stretches
from fleetlog.discovery.hypotheses.sources import ErrorSource, FreeCurve, Source, time_curves
from fleetlog.discovery.model import Model
from fleetlog.discovery.recording.fleet import Fleet
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
    length: float
    roads: Stretches
    lanes: Stretches

    @property
    def metric(self) -> str:
        """What the error is."""
        return f"rms error of the time for {self.length:.0f} m of path, over rms time"

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
            apart = path.apart & (summed(path, waits.astype(float)) > 0.0)
            recorded = np.where(apart, u.level + summed(path, path.standing), u.recorded)
            out.append(replace(u, own=path, noise=noise, recorded=recorded, whole=u.whole | apart))
        return out

    def _unit(self, day: Day) -> Unit | None:
        found = lay_out(day, self.fleet, self.lanes, self.length)
        if found is None:
            return None
        path, windows, recorded, whole = found
        unit = Unit(windows, recorded, whole, np.zeros(len(recorded)), recorded, np.ones(len(recorded)), path)
        return replace(unit, level=self.predict(unit, self.base))

    def predict(self, unit: Unit, model: Model) -> Floats:
        """Return the modelled time, (W,) [s]."""
        path = unit.own
        seconds, _ = drive_times(path, model.physics(int(path.motion.vehicle[0]), path.motion, self.cells))
        return summed(path, seconds + self._waits(path, model))

    def _waits(self, path: Path, model: Model) -> Floats:
        total = np.zeros(len(path.s))
        for name, deviation in model.fields.items():
            term = all_terms()[name]
            if term.acts == "wait":
                m = path.motion
                there = model.share(name, int(m.vehicle[0]), m.time)
                total += np.maximum(deviation, 0.0)[self.lanes.at(m)[0]] * path.share * there
        return total

    def columns(self, unit: Unit, model: Model, sources: Sequence[Source]) -> tuple[Floats, Columns]:
        """Return the modelled time, (W,), and seconds per unit of every source's coefficients, (W, P)."""
        path = unit.own
        vehicle = int(path.motion.vehicle[0])
        physics = model.physics(vehicle, path.motion, self.cells)
        about = About(self, path, model, physics, vehicle, *drive_times(path, physics))
        modelled = summed(path, about.seconds + self._waits(path, model))
        return modelled, about.columns(sources)

    def cells(self, term: Term | None) -> Stretches:
        """Return the cells of a field: of roads, or of each direction of them."""
        found = self.lanes if term is not None and term.one_way else self.roads
        return replace(found, odd=term is not None and term.odd)

    def terms(self) -> list[Term]:
        """Return the terms that change travel times."""
        return [t for t in all_terms().values() if t.acts in ("speed", "wait") and t.parameters]

    def errors(self) -> list[ErrorSource]:
        """Return what a profile of constant accelerations misses."""
        return list(ERRORS)

    def curves(self) -> list[FreeCurve]:
        """Return the free curves that the recording can carry."""
        return time_curves(self.knots, len(self.vehicles))

    def samples(self, unit: Unit) -> tuple[Motion, Ints]:
        """Return the motion of a unit, and the window of each of its samples."""
        return unit.own.motion, unit.own.of

    def state(self, own: Path) -> dict[str, Floats]:
        """Return the recorded variables that a mismatch may follow, by node."""
        m = own.motion
        return {
            "payload": m.payload, "time": (m.time / 3600.0) % 24.0, "soc": m.soc,
            "ambient_temperature": m.ambient_temperature, "speed": np.minimum(m.speed,
            self.truck.drive.max_speed),
            "curvature": np.abs(m.curvature), "heading": m.heading, "vehicle_id": m.vehicle.astype(float),
        }  # fmt: skip

    def part(self, unit: Unit, keep: Mask) -> Unit:
        """Return the legs of a unit that begin in some of its windows."""
        path = unit.own
        nodes = keep[path.of[~path.inside]][np.cumsum(~path.inside) - 1]
        mine = np.bincount(path.of[nodes], minlength=len(keep)) > 0
        return unit.part(mine, path.part(nodes, mine))

    def joined(self, own: list[Path]) -> Path:
        """Return paths one after the other."""
        return joined(own)

    def lost(self, model: Model) -> Lost | None:
        """Return what other vehicles cost beyond a model."""
        term = next((t for t in all_terms().values() if t.acts == "traffic"), None)
        known = None if term is None else self.base.fields.get(term.name)

        def free(path: Path) -> Floats:
            physics = model.physics(int(path.motion.vehicle[0]), path.motion, self.cells)
            return drive_times(path, physics)[0]

        passed = (
            (u.own, u.whole & ~u.own.behind, u.windows.trip,
             np.maximum(self._waits(u.own, model) - u.own.standing, 0.0)) for u in self.units()
        )  # fmt: skip
        return lost_time(passed, self.lanes, free, known)

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


def travel_channel(fleet: Fleet, base: Model, settings: Settings, split: Split) -> TravelChannel:
    """Return the travel times of a fleet with a map."""
    assert fleet.network is not None
    # Half way between two rows a truck that gathers speed is a dt^2 / 8 off an even course, half of that on
    # the mean.
    unseen = fleet.truck.drive.max_acceleration * fleet.step**2 / 16.0
    roads, lanes = make_stretches(fleet.network), make_stretches(fleet.network, apart=True)
    made = TravelChannel("speed", replace(fleet, interval={}), base, split, settings.stretch, roads, lanes)
    made.model_error = max(settings.profile_error, unseen / settings.stretch)
    made.place_error = GATHERS * made.model_error
    return made
