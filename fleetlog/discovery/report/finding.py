"""The verdict of a diagnosis, as the contract writes it."""

from dataclasses import asdict, dataclass, field
from math import isfinite
from typing import Any

import numpy as np
from scipy.special import ndtr

from fleetlog.physics import term

NORMAL = 1.959964  # Standard errors on either side of which 95 % of a normal variable lies


@dataclass
class Parameter:
    """A number with its 95 % confidence interval, and the nominal one."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    nominal: float = 0.0


def interval(p: term.Parameter, at: float, error: float, nominal: float) -> Parameter:
    """Return a number that stands at a coordinate, of this standard error; of one that may end at its lower
    bound the mean of what is above it."""
    low, high = sorted(p.value_of(at + s * NORMAL * error) for s in (-1.0, 1.0))
    value = p.value_of(at)
    if p.low <= value <= p.high:
        low, high = max(low, p.low), min(high, p.high)
    if p.ends and low == p.low and error:
        z = (value - low) / error
        value += error * float(np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi) / ndtr(z))
    return Parameter(p.name, value, low, high, p.unit, nominal)


@dataclass(frozen=True)
class Errors:
    """Of a finding: the error on unseen trips without and with it, and how likely that is chance."""

    metric: str
    before: float | None
    after: float | None
    p_value: float | None

    @property
    def gain(self) -> float | None:
        """How much smaller the error is with it."""
        return None if self.before is None or self.after is None else self.before - self.after

    @property
    def fit(self) -> dict[str, Any]:
        """As the contract writes the errors."""
        return {"metric": self.metric, "before": self.before, "after": self.after}

    def evidence(self, alternatives: list[dict[str, Any]]) -> dict[str, Any]:
        """Return the evidence as the contract writes it."""
        return {"p_value": self.p_value, "held_out_gain": self.gain, "alternatives": alternatives}


@dataclass(frozen=True)
class Lasting:
    """What trips in a row have in common beyond a model: a ``share`` (root mean square) of their energy or
    time, and how likely that is chance; or of a ``vehicle`` while it is at rest. Noise of a trip, or of ten
    seconds, ends with it; what is missing may last."""

    share: float = 0.0
    p_value: float = 1.0
    vehicle: int | None = None


@dataclass
class Finding:
    """One thing that was left out."""

    term: str
    channel: str
    statement: str
    not_excluded: list[str]
    needs: str | None
    depends_on: list[str]
    where: dict[str, Any] | None
    when: dict[str, Any] | None
    scope: dict[str, Any]
    parameters: list[Parameter]
    evidence: dict[str, Any]
    fit: dict[str, Any]
    strength: float = 0.0  # Share of the energy (or time) that it makes up, for the order; not written
    physics: str | None = None  # The term, also of an ``unknown`` that is fitted as one; not written


@dataclass
class ChannelFit:
    """How well a channel is reproduced on held-out trips; None where that is unknown. ``reason`` says why
    the channel was not judged."""

    name: str
    metric: str
    before: float | None
    after: float | None
    floor: float | None
    reason: str | None = None
    p_value: float | None = None
    """How likely the strongest hypothesis, told or not, speaks so much on held-out trips by chance."""

    @property
    def judged(self) -> bool:
        """Whether all figures are known, and are no mere noise; without a floor, no error is known to be."""
        figures = (self.before, self.after, self.floor)
        return self.reason is None and all(x is not None and isfinite(x) for x in figures)


@dataclass
class Verdict:
    """All findings, strongest first, and what the recording could not say."""

    channels: list[ChannelFit]
    findings: list[Finding]
    adjustments: list[dict[str, Any]]
    """Small corrections within the tolerance of truck file or logger, of one vehicle or all."""
    unexplained: list[str] = field(default_factory=list)  # Channels whose error stays above the noise floor
    notes: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)  # Trucks that a channel says nothing of

    @property
    def word(self) -> str:
        """``found``, ``none`` or ``unknown``."""
        if self.unexplained or any(f.term == "unknown" for f in self.findings):
            return "unknown"
        if self.findings:
            return "found"
        return "none" if any(c.judged for c in self.channels) else "unknown"

    @property
    def passes(self) -> bool:
        """Whether nothing is missing in any channel, and every channel was judged, of every truck."""
        return self.word == "none" and all(c.judged for c in self.channels) and not self.left_out

    def document(self) -> dict[str, Any]:
        """The contract's diagnosis.json."""

        def named(values: list[tuple[str, Any]]) -> dict[str, Any]:
            return {k: v for k, v in values if k not in ("nominal", "strength", "physics")}

        return {
            "format_version": 2, "verdict": self.word, "channels": [asdict(c) for c in self.channels],
            "findings": [asdict(f, dict_factory=named) for f in self.findings],
            "adjustments": self.adjustments, "notes": self.notes,
        }  # fmt: skip
