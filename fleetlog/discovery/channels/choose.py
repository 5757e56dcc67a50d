"""Which channels a recording has, and how each is looked at."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.discovery.channels.base import Channel
from fleetlog.discovery.channels.between import DILUTED
from fleetlog.discovery.channels.energy import EnergyChannel
from fleetlog.discovery.channels.travel import TravelChannel
from fleetlog.discovery.hypotheses.cells import Cells, make_squares, make_stretches
from fleetlog.discovery.model import Model
from fleetlog.discovery.recording.day import pooled, step_of
from fleetlog.discovery.recording.fleet import Fleet
from fleetlog.discovery.recording.splits import Split
from fleetlog.discovery.settings import Settings

CHANNELS = ("battery_power", "soc", "speed")
QUANTA = 8.0  # Steps of the state of charge in a window on average: its error is a twentieth of its energy
WIDEST = 600.0  # Of a window [s]: a stretch of road is no longer seen in a wider one
ROWS = 3.0  # Rows in a window at least
ENOUGH = 4.0  # Times the fewest windows that a channel is judged by


def present(fleet: Fleet, wanted: Sequence[str]) -> list[str]:
    """Return the channels that the recording has; speed needs a map to say how fast one might have driven."""
    mapped = fleet.network is not None and fleet.has("edge_id")
    have = {"battery_power": fleet.has("battery_power"), "soc": fleet.has("soc"), "speed": mapped}
    return [c for c, known in have.items() if known and (not wanted or c in wanted)]


def channel_of(name: str, fleet: Fleet, base: Model, settings: Settings, split: Split) -> Channel:
    """Return one channel."""
    if name == "speed":
        return TravelChannel(name, fleet, base, split, settings)
    measured = name == "soc" and fleet.has("battery_power")
    every = range(len(fleet.vehicles))
    steps = [[d.charge_step for d in fleet.of(v) if d.charge_step > 0.0 and name == "soc"] for v in every]
    step = np.array([np.median(s) if s else 0.0 for s in steps])
    window = _window(fleet, name, settings, step)
    coarse = {v: step_of(fleet.of(v), name) if name == "battery_power" else 0.0 for v in (None, *every)}
    coarse = {v: max(own, coarse[None]) for v, own in coarse.items()}
    # Stretches of the map, or squares of the floor without one; None where neither helps
    network = fleet.network if fleet.has("edge_id") else None
    track = (pooled(fleet.days, axis) for axis in ("x", "y"))
    places: Cells | None = make_squares(*track) if network is None else make_stretches(network)
    channel = EnergyChannel(name, fleet, base, split, window, places, measured, step, coarse)
    channel.sparse = frozenset() if measured else fleet.sparse(settings.window)
    hidden = channel.settle(settings, final=False)
    if measured and (hidden**2 > DILUTED).any():
        # As wide as leaves enough of them to see what the battery does as it empties.
        most = min(WIDEST, fleet.seconds / (ENOUGH * settings.fewest))
        wider = np.clip(window * hidden**2 / DILUTED, window, np.maximum(most, window))
        channel = replace(channel, seconds=wider)
        channel.settle(settings, final=True)
    return channel


def _window(fleet: Fleet, channel: str, settings: Settings, step: Floats) -> Floats:
    """Length of a window of each vehicle [s]: longer where rows are far apart, and for a coarse charge."""
    wide = np.maximum(settings.window, ROWS * fleet.updates)
    if channel == "soc":
        used = sum(d.charge_used for d in fleet.days)
        wide = np.maximum(wide, QUANTA * step * fleet.seconds / max(used, 1e-9))
    return np.minimum(wide, WIDEST)
