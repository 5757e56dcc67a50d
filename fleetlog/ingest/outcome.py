"""What the vehicles of an import came to, as one summary."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fleetlog.ingest.derive import suspect_unit
from fleetlog.ingest.edges import Tally
from fleetlog.ingest.stretch import MOST_PACES, Outcome
from fleetlog.ingest.summary import ImportSummary


def complete(summary: ImportSummary, outcomes: Sequence[Outcome]) -> None:
    """Add what the vehicles came to, in their order, to the summary of what was read."""
    edges = Tally()
    for outcome in outcomes:
        one = outcome.summary
        summary.rows, summary.trips = summary.rows + one.rows, summary.trips + one.trips
        summary.rows_joined += one.rows_joined
        summary.vehicles |= one.vehicles
        summary.derived_by_vehicle |= one.derived_by_vehicle
        summary.derived = sorted({*summary.derived, *one.derived})
        if outcome.edges is not None:
            edges.add(outcome.edges)
    summary.notes += _notes(summary, outcomes, edges)
    ends = [(o.written.first[v], o.written.last[v]) for o in outcomes for v in o.written.rows]
    if ends:
        span = min(first for first, _ in ends), max(last for _, last in ends)
        summary.start, summary.end = (f"{np.datetime64(t, 'us')}Z" for t in span)
    if edges.rows:
        summary.matched = edges.matched / edges.rows
        summary.off_map = dict(edges.reasons)


def _notes(s: ImportSummary, outcomes: Sequence[Outcome], edges: Tally) -> list[str]:
    """What a person should know of the sensors."""
    out = []
    if stuck := sum(o.stuck for o in outcomes):
        out.append(f"{stuck:,} values of speed, power or current are unknown: their sensor was stuck")
    if held := sum(o.held for o in outcomes):
        where = "placed between the fixes by the distance driven"
        out.append(f"{held:,} rows repeat a position while the truck moves: {where}")
    paces = [] if "speed" in s.derived else [p for o in outcomes for p in o.paces]
    if unit := suspect_unit(paces[:MOST_PACES]):
        like = f"{unit[1]:.2f} times that of the positions, as if it were in {unit[0]}"
        out.append(f"the speed is about {like}: check its unit")
    if edges.kept:
        out.append(f"the edges of {edges.kept:,} rows are those that the log has")
    return out
