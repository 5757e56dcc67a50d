"""The energy channels: what battery power or the state of charge adds up to over some ten seconds."""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.ndimage import percentile_filter

from fleetlog.core.arrays import Floats, Mask
from fleetlog.core.trajectory import Trajectory
from fleetlog.discovery.channels.base import Channel, Unit
from fleetlog.discovery.channels.between import DILUTED, Between, learn
from fleetlog.discovery.channels.energy_columns import EnergyAbout, Evaluation, jumps
from fleetlog.discovery.hypotheses.cells import Cells, Stretches
from fleetlog.discovery.hypotheses.sources import ErrorSource, FreeCurve, charge_curves, energy_curves
from fleetlog.discovery.model import Model
from fleetlog.discovery.recording.blocks import Block, Cut, cut
from fleetlog.discovery.recording.fleet import far_apart
from fleetlog.discovery.recording.splits import HELD_OUT
from fleetlog.discovery.settings import Settings
from fleetlog.physics.battery import CHARGING
from fleetlog.physics.power import all_terms, battery_power
from fleetlog.physics.term import GRAVITY, Term

STANDS, PASSING, LIFTS, LOADED = 0.9, 0.15, 250.0, 0.3
"""Share of a window from which on it is a standstill, and up to which it is none; power above the usual that
shows hydraulics [W]; a usual load that nobody weighed, as a share of the truck at most."""
AROUND, SELDOM = 41, 0.02
"""Standstills in a row that tell the usual power; of a truck that lifts more than this share show it."""
LEAST_SWING = 1.0  # Rows that scatter by less than this [W] are as good as a logger writes them
MOST_HUNTED = 6  # Roads on which trucks may hunt for their speed in a way of their own
SILENCE = 0.05  # Of a window, that the log may be silent beside it: half of that is its error
OFF = 0.1  # Share of the power that is due at rest, below which a truck is switched off
LEAP = 0.005  # A rise of the charge from row to row that no braking gives
PLUGGED = 60.0  # Nobody charges for less [s], and noise of the charge is little over so long a standstill
RIPPLE = ErrorSource("ripple", 2.0)
ERRORS = (ErrorSource("sampling", 0.5), RIPPLE, ErrorSource("lag", 0.15), ErrorSource("doubt", 0.5))
"""What sampling hides: accelerations between rows (0: what is expected, 1: what is likeliest), power that
swings within them (1: as far as from row to row), a clock a little late [s], and slight accelerations that
are none (1: not one is real), as a truck in cruise does not gather speed."""


@dataclass
class EnergyChannel(Channel):
    """One energy channel of a fleet; see :class:`fleetlog.discovery.channels.base.Channel`. ``measured``: the
    state of charge is judged against the recorded power; ``seconds`` of a window, (V,), by vehicle."""

    seconds: Floats
    places: Cells | None
    measured: bool
    charge_step: Floats  # Step in which the state of charge is logged, (V,)
    power_step: dict[int | None, float]  # Step of the power, by vehicle and by the finest logger [W]
    between: dict[int, Between] = field(default_factory=dict)  # What power lacks between rows, by vehicle
    climbs: bool = False  # Slopes of most vehicles are those of heights that the log shows itself
    loads: list[ErrorSource] = field(default_factory=list, init=False)  # Nobody recorded: they act like mass

    def __post_init__(self) -> None:
        self.metric = f"rms error of energy per {np.median(self.seconds):.0f} s window, over rms energy"
        # Where power is measured, sampling hides nothing and free power by place says nothing.
        self.errors = [] if self.measured else list(ERRORS)
        # Rounding is off by any part of a step alike, and of like trucks by the same.
        coarse = [(v, step / np.sqrt(12.0)) for v, step in self.power_step.items() if step > LEAST_SWING]
        self.errors += [ErrorSource("rounding", spread, vehicle=v) for v, spread in coarse]
        chassis, known = self.fleet.truck.chassis, self.measured or self.fleet.has("payload")
        usual = 0.0 if known else min(0.5 * chassis.rated_load, LOADED * chassis.mass)
        self.loads = [ErrorSource("load", 0.5 * usual, unit="kg")] if usual else []
        self.errors += self.loads
        self.by_place = self.places is not None and not self.measured

    def look(self, number: int, block: Block) -> None:
        """Keep the windows of a vehicle-day."""
        self.shelf.put(str(block.day), number, self._unit(block))

    def _unit(self, block: Block) -> Unit:
        known = block.known
        block = replace(self.fleet.merged(block), known=None)
        if self.measured:
            block = self._on_the_clock_of_charge(block)
        c, vehicle = cut(block, float(self.seconds[block.vehicle])), block.vehicle
        if vehicle in self.between:
            likely = self._likely_power(c, self.between[vehicle])
            block = replace(block, motion=block.motion.replaced(power=likely[block.row]))
            c = replace(c, block=block)
        capacity = 3600.0 * self.fleet.truck.battery.capacity_wh
        energy = _recorded(c, self.name, capacity, SILENCE * self.seconds[vehicle])
        frame = c.windows()
        told = np.isfinite(energy) & (vehicle not in self.sparse)
        whole = told & self._seen_lifts(c, frame.duration, energy)
        if self.measured:  # Without its power nothing says what a truck drew.
            whole &= np.isfinite(c.energy(block.motion.power))
        # Both ends of a window are rounded to a step: its drop scatters by a sixth of the step's square.
        coarse = (self.charge_step[vehicle] * 3.6 * self.fleet.truck.battery.capacity_wh) ** 2 / 6.0
        e = self.evaluation(block, self.base)
        noise = np.full(c.count, coarse)
        if not self.measured:
            assert known is not None
            noise += known.window_variance(lambda m: battery_power(m, e.physics), c.of) * 1e-6
            for load in self.loads:
                noise += (load.most * self.about(c, self.base).columns([load])[:, 0]) ** 2
        swing = np.ones(c.count) if self.name == "soc" else np.maximum(jumps(c, e), LEAST_SWING)
        # Measured power errs where it is large by chance: how noisy a window is must not hang on that.
        level = c.energy((replace(e, measured=None) if self.measured else e).power)
        if self.name == "battery_power":  # Who stands, and draws next to nothing of what is due, is off
            rounded_up = level > 0.75e-3 * self.power_step[vehicle] * frame.duration
            whole &= ~(_at_rest(c) & rounded_up & (np.abs(energy) < OFF * level))
        fold = self.split.fold(frame)
        return Unit(frame, np.where(whole, energy, 0.0), whole, noise, level, swing, fold, c)

    def settle(self, settings: Settings, *, final: bool) -> Floats:
        """Measure the model's own error on some vehicle-days, and return the error of sampling, (V,), of each
        kind of logger: by how much of its energy a window's residual changes with every second row left out.

        The mean of half the rows scatters about that of all by as much as that does about the truth.
        ``final``: where rows miss much, learn to tell recorded power from the motion, too."""
        seen: list[tuple[Unit, Mask, Trajectory]] = []
        kind = {v: k for k, kind in enumerate(self.fleet.loggers) for v in kind}
        beside, enough = 0.0, settings.sample // 4
        looked, changed, sizes = np.zeros((3, max(kind.values()) + 1))
        for day in (self.fleet.days[k] for k in far_apart(len(self.fleet.days))):
            if looked.sum() >= enough and looked[kind[day.vehicle]]:
                continue  # The mean square is known to 2 %
            unit = self._unit(self.fleet.block(day.vehicle, rows := day.load()))
            seen.append((unit, use := unit.whole & (unit.fold != HELD_OUT), rows))
            looked[kind[day.vehicle]] += max(int(use.sum()), 1)
        flat = self.fleet.network is None or not self.fleet.network.has_elevation
        self.climbs = flat and 2 * sum(u.own.motion.slope.any() for u, _, _ in seen) > len(seen)
        for unit, use, rows in seen:
            change = self._thinned(unit, self.fleet.thinned(vehicle := unit.own.block.vehicle, rows))
            changed[kind[vehicle]] += float((change[use] ** 2).sum())
            sizes[kind[vehicle]] += float((unit.recorded[use] ** 2).sum())
            if not (flat or self.measured):
                beside += float((self._beside_the_line(unit.own, settings.heights)[use] ** 2).sum())
        hidden = np.zeros(len(self.fleet.vehicles))
        for k, vehicles in enumerate(self.fleet.loggers):
            hidden[vehicles] = missed = float(np.sqrt(changed[k] / max(sizes[k], 1e-9)))
            if final and self.measured and missed**2 > DILUTED:
                own = [(unit, use) for unit, use, _ in seen if unit.key[0] in vehicles]
                fit = learn(self, replace(self, measured=False), own, missed, settings.evidence)
                if fit.share > 0.5:
                    self.between = self.between | dict.fromkeys(vehicles, fit)
        self.unsteady = frozenset(self.between)
        # Power that is measured at moments errs more by chance than what is told from the motion.
        alike = [0.5 if self.measured and v not in self.between else 1.0 for v in range(len(hidden))]
        self.own_error = np.maximum(settings.model_error, settings.alike * np.array(alike) * hidden)
        self.gathers, self.off_height = settings.gathers, float(np.sqrt(beside / max(sizes.sum(), 1e-9)))
        hunted = self._hunted(seen)
        self.errors += [replace(RIPPLE, road=r) for r in hunted]
        if hunted and self.fleet.network is not None:
            roads = ", ".join(self.fleet.network.edge_ids[r] for r in hunted)
            swings = "power swings faster than the rows show; a rough floor there would look the same"
            self.notes = [f"on {roads}, {swings}"]
        return hidden

    def _beside_the_line(self, c: Cut, surveyed: float) -> Floats:
        """(W,) kJ that heights of both ends of a window add which the map has not: it is ``surveyed`` so well
        [m], and ground falls across as much as along, so who drives beside its line is as much higher."""
        m, network = c.motion[c.middle], self.fleet.network
        assert network is not None
        line = network.position(np.maximum(m.edge, 0), m.edge_offset)
        apart = np.where(m.edge >= 0, np.hypot(m.x - line[:, 0], m.y - line[:, 1]), 0.0)
        drives = ~_at_rest(c)
        steep = np.sqrt((drives * m.slope**2).sum() / max(drives.sum(), 1))
        height = np.sqrt(2.0) * (surveyed + apart * steep) * drives
        return np.asarray(1e-3 * (self.fleet.truck.chassis.mass + m.payload) * GRAVITY * height)

    def _likely_power(self, c: Cut, between: Between) -> Floats:
        """(rows,) what the power [W] was on average over the time for which each row stands."""
        block = c.block
        e = replace(self.evaluation(block, self.base), charge=False, measured=None)
        drawn = block.rows(np.maximum(e.force * e.gain, 0.0))
        expected = block.rows(e.power) + between.beyond(self.state(c), drawn)
        return block.power + between.share * (expected - block.power)

    def _hunted(self, seen: list[tuple[Unit, Mask, Trajectory]]) -> tuple[int, ...]:
        """The roads whose energy hangs on how far power swings within rows: there trucks hunt for their
        speed, and how much that costs differs from road to road."""
        if self.measured or not isinstance(self.places, Stretches):
            return ()
        swings, energy = np.zeros((2, len(self.places.network)))
        for unit, whole, _ in seen:
            use, sure = whole & (unit.windows.edge >= 0), 1.0 / self.own_error[unit.key[0]]
            road = self.places.road(unit.windows.edge[use])
            ripple = self.columns(unit, self.base, [RIPPLE])[1][use, 0]
            swings += np.bincount(road, (sure * ripple) ** 2, len(swings))
            energy += np.bincount(road, (sure * unit.recorded[use]) ** 2, len(swings))
        worst = np.argsort(-swings)[:MOST_HUNTED]
        return tuple(int(r) for r in worst if RIPPLE.most**2 * swings[r] > self.place_error**2 * energy[r])

    def _thinned(self, unit: Unit, rare: Block) -> Floats:
        """(W,) the residual of the nominal model [kJ] on every second row alone, less that on all rows."""
        c: Cut = unit.own
        block = c.block
        if self.measured:
            rare = self._on_the_clock_of_charge(rare)
        # A row counts where it is stamped, whole: of its neighbours one may be held out.
        window = c.of_row[np.minimum(np.searchsorted(block.time, rare.time), len(block) - 1)][rare.row]
        seconds = np.bincount(window, rare.motion.dt, c.count)
        left = -self.evaluation(rare, self.base).power
        now = -self.predict(unit, self.base)
        if self.name == "battery_power" and rare.vehicle not in self.fleet.interval:  # A mean lacks nothing
            left, now = left + rare.motion.power, now + unit.recorded
        energy = np.bincount(window, left * rare.motion.dt, c.count) * 1e-3
        # At the ends of trips and at gaps the rows left out are lost time.
        known = (seconds > 0.5 * unit.windows.duration) & unit.whole & np.isfinite(energy)
        return np.where(known, energy * unit.windows.duration / np.maximum(seconds, 1e-9) - now, 0.0)

    def _seen_lifts(self, c: Cut, seconds: Floats, energy: Floats) -> Mask:
        """(W,) windows without hydraulics that nothing shows. Without loads those in which forks do not rise.
        A log without fork height may have lifts at standstill all the same. Only windows with hardly any, and
        standstills of the power that is usual around that time, count then; all where none has more."""
        forks, loads = (self.fleet.has(name) for name in ("fork_height", "payload"))
        if self.measured or not self.fleet.truck.chassis.rated_load or (forks and loads):
            return np.ones(c.count, bool)
        if forks:  # How much is lifted nothing says
            return np.asarray(c.energy(np.where(c.motion.lift_speed > 0.0, 1.0, 0.0)) == 0.0)
        share = c.energy(np.where(c.motion.speed <= 0.0, 1e3, 0.0)) / np.maximum(seconds, 1e-6)
        rate = 1e3 * np.nan_to_num(energy) / np.maximum(seconds, 1e-6)
        still = (share > STANDS) & np.isfinite(energy)
        if not still.any():
            return np.asarray(share < PASSING)
        # Lifting only adds to the power of a standstill.
        off = rate[still] - percentile_filter(rate[still], 25, AROUND)
        if np.mean(off > LIFTS) < SELDOM:
            return np.ones(c.count, bool)
        still[still] = np.abs(off) < LIFTS
        return np.asarray((share < PASSING) | still)

    def _on_the_clock_of_charge(self, block: Block) -> Block:
        """The block with its power moved by its lag, where the state of charge then follows it better."""
        lag = self.fleet.lag.get(block.vehicle, 0.0)
        moved = np.interp(block.time + lag, block.time, block.power)
        paid = -np.diff(block.soc) * 3600.0 * self.fleet.truck.battery.capacity_wh
        said = (0.5 * (p[1:] + p[:-1]) * np.diff(block.time) for p in (block.power, moved))
        now, late = (float(np.nansum((paid - energy) ** 2)) for energy in said)
        if lag == 0.0 or now <= late:
            return block
        return replace(block, power=moved, motion=block.motion.replaced(power=moved[block.row]))

    def evaluation(self, block: Block, model: Model) -> Evaluation:
        """Return a block under a model."""
        known = model if self.places is not None else replace(model, fields={})
        physics = known.physics(block.vehicle, block.motion, self.cells)
        measured = np.nan_to_num(block.motion.power) if self.measured else None
        return Evaluation(block.motion, physics, self.name == "soc", measured)

    def about(self, own: Cut, model: Model) -> EnergyAbout:
        """Return what a model says of the windows, (W,) [kJ], and columns about it."""
        return EnergyAbout(self, own, model, self.evaluation(own.block, model))

    def cells(self, term: Term | None) -> Cells:
        """Return the cells of a field: the same for all."""
        assert self.places is not None
        return replace(self.places, odd=term is not None and term.odd)

    def terms(self) -> list[Term]:
        """Return the terms that change the energy of this channel; without places none that follows them."""
        acting = {"loss"} if self.measured else {"force", "power", "drive", "load", "truck"}
        if self.name == "soc":
            acting.add("loss")
        able = [t for t in all_terms().values() if self.places or not (t.field or "heading" in t.depends_on)]
        # Heights that are known leave no slope to be found: what noise they have is none of a place.
        able = [t for t in able if not (t.odd and self.climbs)]
        return [t for t in able if t.acts in acting and t.parameters]

    def curves(self) -> list[FreeCurve]:
        """Return the free curves that the recording can carry."""
        knots, vehicles = self.knots(self.units()), len(self.fleet.vehicles)
        if self.measured:
            return charge_curves(knots, vehicles)
        out = energy_curves(knots, vehicles, len(self.fleet.dates), self.fleet.trip_names)
        return [c for c in out if self.places or "heading" not in c.variables]

    def state(self, own: Cut) -> dict[str, Floats]:
        """Return the recorded variables that a mismatch may follow, by row."""
        block, m, first = own.block, own.motion, own.block.first
        day, of = np.unique((block.time // 86400.0).astype(np.int64), return_inverse=True)
        begins = np.array([self.fleet.begins[block.vehicle, int(d)] for d in day])
        return {
            "speed": block.rows(m.speed), "time since departure": block.since, "payload": m.payload[first],
            "acceleration": block.rows(m.acceleration), "curvature": block.rows(np.abs(m.curvature)),
            "ambient_temperature": m.ambient_temperature[first], "soc": block.soc,
            "time": (block.time / 3600.0) % 24.0, "time since start": (block.time - begins[of]) / 3600.0,
            "lift_speed": block.rows(m.lift_speed), "heading": m.heading[first],
            "vehicle_id": np.full(len(block), float(block.vehicle)),
            "day": np.searchsorted(self.fleet.dates, day)[of].astype(float),
            "trip_id": np.searchsorted(np.array(self.fleet.own_trips, np.int64), block.trip).astype(float),
        }  # fmt: skip

    def rests(self, unit: Unit) -> Mask:
        """Return the windows, (W,), in which nothing moves; none of a charge, which is too coarse."""
        return _at_rest(unit.own) if self.name == "battery_power" else super().rests(unit)

    def features(self, unit: Unit, model: Model) -> Floats:
        """Return place, direction, load, pace, time and nominal energy: what makes two windows alike."""
        c: Cut = unit.own
        m, w, sample = c.motion, unit.windows, c.middle
        moving = (w.distance > 0.2 * w.duration) * 1.0
        wide = np.maximum(w.duration, 1.0)
        lift = c.energy(np.maximum(m.lift_speed, 0.0) * (m.payload + 300.0) * GRAVITY)
        rise = c.energy((self.fleet.truck.chassis.mass + m.payload) * m.acceleration * m.speed)
        tried = c.energy((self.fleet.truck.chassis.mass + m.payload) * np.abs(m.acceleration) * m.speed)
        scale = max(float(np.sqrt(np.mean(unit.recorded**2))), 1e-9)
        return np.column_stack([
            np.nan_to_num(w.x) / 4.0 * moving, np.nan_to_num(w.y) / 4.0 * moving,
            np.cos(m.heading[sample]) * moving, np.sin(m.heading[sample]) * moving, m.payload[sample] / 500.0,
            w.distance / wide / 0.5, wide / self.seconds[c.block.vehicle] * 3.0, rise / scale * 2.0,
            tried / scale * 2.0, lift / scale * 2.0, np.nan_to_num(m.ambient_temperature[sample]) / 4.0,
            w.time / self.fleet.span * 3.0, w.vehicle * 3.0,
        ])  # fmt: skip


def _at_rest(c: Cut) -> Mask:
    """(windows,) in which nothing moves."""
    m = c.motion
    return np.asarray(c.energy(np.where((m.speed > 0.0) | (m.lift_speed != 0.0), 1.0, 0.0)) == 0.0)


def _recorded(c: Cut, channel: str, capacity: float, silence: float) -> Floats:
    """(windows,) kJ that the channel shows; NaN where rows miss, for so many seconds beside a window of the
    charge, or where the battery is charged or swapped."""
    block, charged, first = c.block, _charged(c, capacity), c.first
    if channel == "battery_power":
        energy = np.bincount(c.of_row, block.power * block.seconds, c.count) * 1e-3
        return np.asarray(np.where(charged, np.nan, energy), dtype=np.float64)
    soc = block.soc
    # Of a silence of the log each of the windows beside it would count half the charge that went in it.
    after = np.flatnonzero(block.silence[1:] > silence) + 1
    charged[c.of_row[np.concatenate([after - 1, after])]] = True
    # A row stands for the time around its stamp, so a window begins half way between two stamps.
    border = np.concatenate([soc[:1], 0.5 * (soc[first[1:] - 1] + soc[first[1:]]), soc[-1:]])
    return np.where(charged, np.nan, -np.diff(border) * capacity * 1e-3)


def _charged(c: Cut, capacity: float) -> Mask:
    """(windows,) whether the battery took energy that no wheel gave: standing, with the power recorded or a
    charge that rises without it, or by a leap of its charge."""
    block, m = c.block, c.motion
    still = (block.rows(m.speed) <= 0.0) & (np.abs(block.rows(m.lift_speed)) <= 0.0)
    begin = np.flatnonzero(np.diff(still, prepend=~still[:1]))
    end = np.append(begin[1:], len(block)) - 1
    # A charge that is not known, as above 100 %, is that of the row before.
    known = np.maximum.accumulate(np.where(np.isfinite(block.soc), np.arange(len(block)), 0))
    lasts, rise = (v[end] - v[begin] for v in (block.time, block.soc[known]))
    plugged = (lasts >= PLUGGED) & (rise * capacity > -CHARGING * lasts)
    still_charging = still & np.repeat(plugged, end - begin + 1)
    leap = np.diff(block.soc, prepend=block.soc[:1]) > LEAP
    # The border of two windows lies between the rows of a leap: neither knows its end.
    taken = (still & (block.power < CHARGING)) | still_charging | leap | np.append(leap[1:], False)
    return np.asarray(np.bincount(c.of_row, taken, c.count) > 0)
