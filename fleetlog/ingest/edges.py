"""The edge columns: rows matched to directed roads, with a confidence, and a reason where no road fits."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from fleetlog.core.network import Network
from fleetlog.core.trajectory import Labels, Trajectory

if TYPE_CHECKING:
    from fleetlog.roads.matching import MatchParameters


@dataclass
class Tally:
    """Rows, those on a road, those whose edges the log itself has; and why others have none."""

    rows: int = 0
    matched: int = 0
    kept: int = 0
    reasons: Counter[str] = field(default_factory=Counter)

    def add(self, other: Tally) -> None:
        """Add the rows of another vehicle."""
        self.rows, self.matched = self.rows + other.rows, self.matched + other.matched
        self.kept += other.kept
        self.reasons.update(other.reasons)


@dataclass
class Edges:
    """Matches stretch after stretch with one set of parameters (where None, with those of the stretch)."""

    network: Network
    parameters: MatchParameters | None = None
    tally: Tally = field(default_factory=Tally)

    def match(self, rows: Trajectory) -> Trajectory:
        """The rows with edge_id, edge_offset, lateral_offset, match_confidence and match_reason."""
        if log_has_edges(rows, self.network):
            self.tally.kept += len(rows)
            self._count(rows)
            return rows
        from fleetlog.roads import matching

        found = matching.match(rows, self.network, self.parameters)
        edge = np.asarray(found.edge, dtype=np.int32)
        off = edge < 0
        out = rows.with_columns(
            edge_id=Labels(edge, self.network.edge_ids),
            edge_offset=np.where(off, np.nan, found.offset),
            lateral_offset=np.where(off, np.nan, found.lateral),
            match_confidence=np.asarray(found.confidence, dtype=np.float64),
            match_reason=Labels(np.where(off, found.reason.astype(np.int32), -1), tuple(matching.REASONS)),
        )
        self._count(out)
        return out

    def _count(self, rows: Trajectory) -> None:
        codes = rows.labels("edge_id").codes
        self.tally.rows += len(rows)
        self.tally.matched += int((codes >= 0).sum())
        why = rows.labels("match_reason")
        for code, count in zip(*np.unique(why.codes[codes < 0], return_counts=True), strict=True):
            if code >= 0:
                self.tally.reasons[why.names[code]] += int(count)


def log_has_edges(rows: Trajectory, network: Network) -> bool:
    """A dataset that comes back: its edges are those of this map."""
    if not rows.has("edge_id") or not rows.has("edge_offset"):
        return False
    labels = rows.labels("edge_id")
    used = {labels.names[c] for c in np.unique(labels.codes[labels.codes >= 0]).tolist()}
    return used <= set(network.index)
