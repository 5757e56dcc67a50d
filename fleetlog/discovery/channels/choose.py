"""Which channels a recording has, and how each is looked at."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fleetlog.discovery.channels.base import Channel
from fleetlog.discovery.channels.between import DILUTED
from fleetlog.discovery.channels.energy import EnergyChannel
from fleetlog.discovery.channels.travel import TravelChannel
from fleetlog.discovery.hypotheses.cells import Cells, make_squares, make_stretches
from fleetlog.discovery.model import Model
from fleetlog.discovery.recording.fleet import Fleet
from fleetlog.discovery.recording.splits import Split
from fleetlog.discovery.settings import Settings

CHANNELS = ("battery_power", "soc", "speed")
QUANTA = 8.0
"""Steps in a window of a stepped state of charge on average: its error is then a twentieth of its energy."""
WIDEST = 600.0  # Of a window [s]: a stretch of road is no longer seen in a wider one
ROWS = 3.0  # Rows in a window at least
SHARED = 0.05  # Levels of a power in steps, by row: twenty rows have a value in common on average
ENOUGH = 4.0  # Times the fewest windows that a channel is judged by


def present(fleet: Fleet, wanted: Sequence[str]) -> list[str]:
    """Return the channels that the recording has; speed needs a map to say how fast one might have driven."""
    have = [c for c in ("battery_power", "soc") if fleet.has(c)]
    if fleet.network is not None and fleet.has("edge_id"):
        have.append("speed")
    return [c for c in have if not wanted or c in wanted]


def channel_of(name: str, fleet: Fleet, base: Model, settings: Settings, split: Split) -> Channel:
    """Return one channel."""
    if name == "speed":
        return TravelChannel(name, fleet, base, split, settings)
    measured = name == "soc" and fleet.has("battery_power")
    step = _charge_step(fleet) if name == "soc" else 0.0
    window = _window(fleet, name, settings, step)
    coarse = _power_step(fleet) if name == "battery_power" else 0.0
    channel = EnergyChannel(name, fleet, base, window, _cells(fleet), measured, step, power_step=coarse)
    hidden = channel.settle(settings, split, final=False)
    if measured and hidden**2 > DILUTED:
        # As wide as leaves enough of them to see what the battery does as it empties.
        most = min(WIDEST, fleet.seconds / (ENOUGH * settings.fewest))
        wider = float(np.clip(window * hidden**2 / DILUTED, window, max(most, window)))
        channel = replace(channel, seconds=wider)
        channel.settle(settings, split, final=True)
    return channel


def _cells(fleet: Fleet) -> Cells | None:
    """Stretches of the map, or squares of the floor without one; None where neither helps."""
    if fleet.network is not None and fleet.has("edge_id"):
        return make_stretches(fleet.network)
    x, y = (np.concatenate([t.floats(c) for _, t in fleet.days]) for c in ("x", "y"))
    return make_squares(x, y)


def _window(fleet: Fleet, channel: str, settings: Settings, step: float) -> float:
    """Length of a window [s]: longer where rows are far apart, and for a coarse state of charge."""
    wide = max(settings.window, ROWS * fleet.step)
    if channel == "soc":
        drops = [np.diff(t.floats("soc")) for _, t in fleet.days]
        used = sum(float(-d[d < 0].sum()) for d in drops)
        wide = max(wide, QUANTA * step * fleet.seconds / max(used, 1e-9))
    return float(min(wide, WIDEST))


def _charge_step(fleet: Fleet) -> float:
    """The step in which the state of charge is logged; 0 where nothing changes."""
    change = np.concatenate([np.abs(np.diff(t.floats("soc"))) for _, t in fleet.days])
    steps = change[np.isfinite(change) & (change > 0.0)]
    return float(np.quantile(steps, 0.05)) if len(steps) else 0.0


def _power_step(fleet: Fleet) -> float:
    """The step in which power is logged [W]; 0 where hardly any two rows have a value in common."""
    watts = np.concatenate([np.round(t.floats("battery_power"), 1) for _, t in fleet.days])
    levels = np.unique(watts[np.isfinite(watts)])
    return float(np.diff(levels).min()) if 1 < len(levels) < SHARED * len(watts) else 0.0
