"""Two fleets side by side on one timeline, with differences by truck where one drives the other's mission."""

from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from fleetlog.core.arrays import Floats, Ints
from fleetlog.core.trajectory import Trajectory, concatenate
from fleetlog.store import Dataset
from fleetlog.store.trips import STANDING_SPEED
from fleetlog.view import blueprint, clock, palette
from fleetlog.view.clock import dataset_outline, opened
from fleetlog.view.fleet import Fleet, curve_style, log_curve
from fleetlog.view.recording import DIFFERENCES, MANY, RATE, TOTALS, drawn, log_fleet, summary_markdown
from fleetlog.view.scene import log_site
from fleetlog.view.stream import Stream, entity, open_stream

BIN = 10_000_000  # Step of the totals [us]
SLOW = frozenset({"energy", "soc", "distance", "used"})  # Shown as a whole, also in a long recording


def write_comparison(
    recorded_path: str | Path, simulated_path: str | Path, out_rrd: str | Path, *, rate_hz: float = RATE,
    day: str | None = None,
) -> Path:  # fmt: skip
    """Write a recording in which both fleets drive on one timeline, in orange and blue, with differences.

    Where the two share no time, the simulated one is moved to begin with the recorded one, and the summary
    says so; ``out_rrd`` appears whole or not at all, and replaces an older one. A ``day`` (UTC, YYYY-MM-DD)
    is that of the recording; the simulation is cut to it where it has the same one."""
    recorded, simulated = opened(recorded_path, day), Dataset(simulated_path)
    if day in simulated.dates:
        simulated = opened(simulated_path, day)
    spans = recorded.span, simulated.span
    (begin, end), (first, last) = (span or (0, 0) for span in spans)
    shift = 0 if None in spans or (begin <= last and first <= end) else begin - first
    a = Fleet(recorded, rate_hz, "recorded", palette.RECORDED)
    b = Fleet(simulated, rate_hz, "simulated", palette.SIMULATED, shift)
    screen = blueprint.Screen(dataset_outline(recorded), ("/recorded", "/simulated"))
    if times := [*(spans[0] or ()), *(t + shift for t in spans[1] or ())]:
        screen.start, screen.duration = min(times), (max(times) - min(times)) * 1e-6
    text = "Recorded in orange, simulated in blue.\n"
    text += f"\nThe simulated clock is moved by {shift * 1e-6:,.0f} s.\n" if shift else ""
    text = "\n".join([text, *(summary_markdown(d, figures=False) for d in (recorded, simulated))])
    fleets = [(fleet, drawn(fleet, screen)) for fleet in (a, b)]
    with open_stream(Path(out_rrd), f"{recorded.site.name} (recorded and simulated)", screen.start) as stream:
        log_site(stream, recorded.site)
        for fleet, days in fleets:
            log_fleet(stream, screen, fleet, days)
        # A simulation with this figure drove the trips of a recording again.
        again = "distance_ratio" in (simulated.meta.get("summary") or {})
        found = _log_differences(stream, a, b) if again else _log_totals(stream, a, b)
        stream.static("/summary", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))
        _send_screen(stream, screen, found)
    return Path(out_rrd)


def _log_differences(stream: Stream, a: Fleet, b: Fleet) -> set[str]:
    """Curves for the vehicles that both have; which kinds there are."""
    found: set[str] = set()
    for number, vehicle in enumerate(sorted(set(a.dataset.vehicles) & set(b.dataset.vehicles))[:MANY]):
        spent, style = 0.0, curve_style(vehicle, palette.vehicle_colour(number))
        theirs = list(b.days(vehicle))
        other = concatenate(theirs) if theirs else Trajectory(vehicle, np.zeros(0, np.int64))
        for day in a.days(vehicle):
            for kind, values in differences(day, other).items():
                if kind == "energy":
                    values, spent = values + spent, spent + values[-1]
                log_curve(stream, entity("difference", kind, vehicle), day.time, values, style)
                found.add(kind)
    return found


def _log_totals(stream: Stream, *fleets: Fleet) -> set[str]:
    """Curves of what each fleet does and has done as a whole; which kinds there are."""
    found: set[str] = set()
    for fleet in fleets:
        time, curves = totals([day for v in fleet.dataset.vehicles for day in fleet.days(v)])
        for kind, values in curves.items():
            style = curve_style(fleet.name, fleet.colour or palette.RECORDED)
            log_curve(stream, entity("difference", kind, fleet.name), time, values, style)
        found |= set(curves)
    return found


def totals(days: list[Trajectory]) -> tuple[Ints, dict[str, Floats]]:
    """Times [us]; trucks driving, distance so far [km] and, where power is known, energy so far [kWh]."""
    rows = [np.zeros((0, 4))]
    for t in days:
        dt = np.diff(t.time, append=t.time[-1:])
        dt = np.where(dt > clock.gap_limit(t.time), 0, dt) * 1e-6
        speed, power = np.nan_to_num(t.floats("speed")), np.nan_to_num(t.floats("battery_power"))
        rows.append(np.column_stack([t.time // BIN, (speed > STANDING_SPEED) * dt, speed * dt, power * dt]))
    table = np.concatenate(rows)
    bins, of = np.unique(table[:, 0], return_inverse=True)
    moving, metres, joules = (np.bincount(of, table[:, k], len(bins)) for k in (1, 2, 3))
    out = {"driving": moving / (BIN * 1e-6), "distance": np.cumsum(metres) / 1000.0}
    if joules.any():
        out["used"] = np.cumsum(joules) / 3.6e6
    return bins.astype(np.int64) * BIN, out


def at_times(other: Trajectory, name: str, time: Any) -> Floats:
    """A column of ``other`` interpolated at ``time``; NaN outside it and in its gaps."""
    values = other.floats(name)
    if (known := np.isfinite(values)).sum() < 2:
        return np.full(len(time), np.nan)
    t, v = other.time[known], values[known]
    after = np.clip(np.searchsorted(t, time), 1, len(t) - 1)
    out = np.interp(time, t, v, left=np.nan, right=np.nan)
    out[(t[after] - t[after - 1]) > clock.gap_limit(t)] = np.nan
    return np.asarray(out, dtype=np.float64)


def differences(recorded: Trajectory, simulated: Trajectory) -> dict[str, Floats]:
    """By kind with data (N,), simulated minus recorded, in the units of ``DIFFERENCES``."""
    time, columns = recorded.time, ("x", "y", "battery_power", "soc")
    dx, dy, power, soc = (at_times(simulated, c, time) - recorded.floats(c) for c in columns)
    # Nothing is spent while the power is unknown, and over a gap.
    step = np.where(np.diff(time) > clock.gap_limit(time), 0.0, np.diff(time) * 1e-6)
    spent = np.append(0.0, np.cumsum(0.5 * np.nan_to_num(power[1:] + power[:-1]) * step)) / 3.6e6
    energy = np.where(np.isfinite(power).any(), spent, np.nan)
    every = {"apart": np.hypot(dx, dy), "power": power * 1e-3, "energy": energy, "soc": soc * 100.0}
    return {kind: values for kind, values in every.items() if np.isfinite(values).any()}


def _send_screen(stream: Stream, screen: blueprint.Screen, found: set[str]) -> None:
    # From above, arcs would hide where the two fleets part.
    flat = [*blueprint.FLAT, *(f"- {p}/tasks/**" for p in screen.prefixes)]
    whole = blueprint.floor_view(screen, "Site", aspect=1.5)
    plan = blueprint.floor_view(screen, "Plan", flat, plan=True, aspect=1.5)
    summary = rrb.TextDocumentView(origin="/summary", name="Summary")
    doing = blueprint.activity_views(screen, roomy=True)
    both = [*blueprint.curve_views(screen), rrb.Tabs(summary, *doing) if doing else summary]
    apart, plot, time_of = list[Any](), blueprint.plot, blueprint.time_of
    for k, name in ((k, n) for k, n in {**DIFFERENCES, **TOTALS}.items() if k in found):
        apart.append(plot(name, [f"/difference/{k}/**"], k in TOTALS, **time_of(screen, k in SLOW)))
    columns = [rrb.Vertical(whole, plan), rrb.Vertical(*both), *([rrb.Vertical(*apart)] if apart else [])]
    blueprint.send(stream, screen, columns, [5, 3, 3][: len(columns)])
