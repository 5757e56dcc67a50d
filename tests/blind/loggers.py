"""Loggers: what becomes of the truth on its way into a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from effects import Effect
from power import HZ, Motion
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter


@dataclass(frozen=True)
class Logger:
    """Properties of a logger; the default is a clean one at 1 Hz."""

    steps: tuple[float, ...] = (1.0,)
    """Seconds between rows, taken at random."""
    jitter: float = 0.0
    """Standard deviation of the stamps [s]."""
    speed_noise: float = 0.03
    refresh: float = 0.0
    """Positions are new only this often [s] and repeated in between."""
    gaps: float = 0.0
    """Outages an hour, of half a minute to five."""
    power_step: float = 0.0
    soc_step: float = 1e-5
    mean: bool = False
    """Power is the mean of the last interval."""
    offset: float = 0.0
    """Of the power channel's clock [s]; > 0: late."""
    charging: str = ""
    """``inside`` or ``outside`` of battery_power, or ``swap``."""
    without: tuple[str, ...] = ()
    """Columns that the log lacks."""

    @property
    def interval(self) -> float:
        """Mean seconds between rows."""
        return float(np.mean(self.steps))


LOGGERS: dict[str, Logger] = {
    "clean": Logger(),
    "0.2hz": Logger(steps=(5.0,)),
    "0.5hz": Logger(steps=(2.0,)),
    "2hz": Logger(steps=(0.5,)),
    "5hz": Logger(steps=(0.2,)),
    "10hz": Logger(steps=(0.1,)),
    "20hz": Logger(steps=(0.05,)),
    "uneven": Logger(steps=(3.0, 5.0, 7.0)),
    "jitter": Logger(jitter=0.3),
    "no_speed": Logger(without=("speed",)),
    "noisy_speed": Logger(speed_noise=0.1),
    "quiet_speed": Logger(speed_noise=0.02),
    "repeated": Logger(refresh=4.0),
    "gaps": Logger(gaps=3.0),
    "power_500w": Logger(power_step=500.0),
    "soc_1pc": Logger(soc_step=0.01),
    "soc_only": Logger(soc_step=0.001, without=("battery_power",)),
    "mean": Logger(steps=(2.0,), mean=True),
    "mean_5s": Logger(steps=(5.0,), mean=True),
    "late": Logger(offset=1.5),
    "charge_in": Logger(charging="inside"),
    "charge_out": Logger(charging="outside"),
    "swap": Logger(charging="swap"),
    "no_load": Logger(without=("payload", "fork_height")),
    "no_position": Logger(without=("latitude", "longitude")),
}
ALLOWED = {"late": ("clock_offset",), "mean": ("averaging",), "mean_5s": ("averaging",)}
"""Findings that say what the logger does: neither asked for nor wrong."""
DECIMALS = {
    "latitude": 8, "longitude": 8, "speed": 3, "payload": 0, "fork_height": 2, "battery_power": 1, "soc": 6,
    "ambient_temperature": 1,
}  # fmt: skip


def for_sensor_effects(logger: Logger, effects: Sequence[Effect]) -> Logger:
    """The logger with what effects of the vocabulary make of its clock."""
    late = sum(e.parameters["offset"] for e in effects if e.term == "clock_offset")
    return replace(logger, offset=logger.offset + late)


def moments(count: int, logger: Logger, rng: np.random.Generator) -> np.ndarray:
    """Ticks at which rows are taken."""
    n = int(count / HZ / logger.interval)
    steps = rng.choice(logger.steps, n) * HZ if len(logger.steps) > 1 else np.full(n, logger.steps[0] * HZ)
    ticks = (np.cumsum(steps) - steps[0] + HZ // 2).round().astype(int)
    keep = (ticks < count) & (rng.random(n) > 0.004)
    for _ in range(rng.poisson(logger.gaps * count / HZ / 3600.0)):
        begin = rng.uniform(0.0, count)
        keep &= (ticks < begin) | (ticks > begin + rng.uniform(30.0, 300.0) * HZ)
    return np.asarray(ticks[keep])


def reported_power(power: np.ndarray, ticks: np.ndarray, logger: Logger, average: float = 0.0) -> np.ndarray:
    """Power as the logger puts it beside its rows, before noise; ``average``: mean of so many seconds."""
    width = max(int(min(1.0, logger.interval) * HZ), 1)
    at = ticks - logger.offset * HZ
    if average:
        back = int(average * HZ)
    elif logger.mean:
        back = int(logger.interval * HZ)
    else:
        # The filter of an ordinary logger: a moving mean of at most one second, and no delay.
        return np.interp(at, np.arange(len(power)), uniform_filter1d(power, width, mode="nearest"))
    total = np.concatenate([[0.0], np.cumsum(power)])
    whole = np.arange(len(total))
    return (np.interp(at + 1, whole, total) - np.interp(at + 1 - back, whole, total)) / back


def noisy_power(power: np.ndarray, logger: Logger, rng: np.random.Generator) -> np.ndarray:
    """Noise in proportion, white noise, then steps."""
    out = power * (1.0 + 0.01 * rng.normal(size=len(power))) + 30.0 * rng.normal(size=len(power))
    return stepped(out, logger.power_step)


def stepped(values: np.ndarray, step: float) -> np.ndarray:
    """Values as whole steps."""
    return np.round(values / step) * step if step else values


def seen_speed(
    m: Motion, ticks: np.ndarray, logger: Logger, scale: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """The speed channel, exactly zero where the truck stands."""
    width = max(int(min(1.0, logger.interval) * HZ), 1)
    mean = uniform_filter1d(m.v, width, mode="nearest")[ticks] * scale[ticks]
    noise = logger.speed_noise * rng.normal(size=len(ticks))
    return np.where(m.v[ticks] <= 0.0, 0.0, np.maximum(mean + noise, 0.0))


def seen_position(
    m: Motion, ticks: np.ndarray, logger: Logger, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Positions whose noise wanders over half a minute, repeated where the logger refreshes them rarely."""
    x, y = m.x[ticks] + _wander(ticks, 0.25, rng), m.y[ticks] + _wander(ticks, 0.25, rng)
    if logger.refresh:
        fresh = np.diff(ticks // int(logger.refresh * HZ), prepend=-1) > 0
        held = np.maximum.accumulate(np.where(fresh, np.arange(len(ticks)), 0))
        x, y = x[held], y[held]
    return x, y


def stamps(t: np.ndarray, logger: Logger, rng: np.random.Generator) -> np.ndarray:
    """Times of rows in whole milliseconds, increasing."""
    if not logger.jitter:
        return np.round(t * 1000.0).astype(np.int64)
    wrong = np.round((t + logger.jitter * rng.normal(size=len(t))) * 1000.0).astype(np.int64)
    rank = np.arange(len(t))
    return np.asarray(np.maximum.accumulate(wrong - rank) + rank)


def _wander(ticks: np.ndarray, size: float, rng: np.random.Generator) -> np.ndarray:
    """Noise with a memory of some 25 s at any rate, drawn on a grid of one second."""
    seconds = ticks / HZ
    n = int(seconds[-1]) + 3
    slow = lfilter([np.sqrt(1 - 0.96**2)], [1.0, -0.96], size * rng.normal(size=n))
    return np.interp(seconds, np.arange(n), slow)
