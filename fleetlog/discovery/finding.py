"""The verdict of a diagnosis, as the contract writes it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass
class Parameter:
    """A number with its 95 per cent interval."""

    name: str
    value: float
    low: float
    high: float
    unit: str


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
    parameters: list[Parameter]
    evidence: dict[str, Any]
    fit: dict[str, Any]
    strength: float = 0.0
    """Held-out gain, for the order; not written."""

    def document(self) -> dict[str, Any]:
        """JSON-ready."""
        out = asdict(self)
        del out["strength"]
        return out


@dataclass
class ChannelFit:
    """How well a channel is replayed: the error on trips that were kept back."""

    name: str
    metric: str
    before: float
    after: float
    floor: float


@dataclass
class Verdict:
    """All findings, strongest first, and what the recording could not say."""

    channels: list[ChannelFit]
    findings: list[Finding]
    notes: list[str] = field(default_factory=list)

    @property
    def word(self) -> str:
        """``found``, ``none`` or ``unknown``."""
        if not self.findings:
            return "none"
        return "found" if any(f.term != "unknown" for f in self.findings) else "unknown"

    def document(self) -> dict[str, Any]:
        """The contract's diagnosis.json."""
        return {
            "format_version": 1,
            "verdict": self.word,
            "channels": [asdict(c) for c in self.channels],
            "findings": [f.document() for f in self.findings],
            "notes": self.notes,
        }
