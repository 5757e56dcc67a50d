"""Time lost to other trucks as a finding."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.channels.base import Channel
from fleetlog.discovery.channels.lost import Lost
from fleetlog.discovery.hypotheses.stretches import Stretches
from fleetlog.discovery.report import words
from fleetlog.discovery.report.fields import LARGE, Values, runs
from fleetlog.discovery.report.finding import Finding, Parameter
from fleetlog.discovery.search.intervals import NORMAL
from fleetlog.discovery.settings import Settings
from fleetlog.physics.power import all_terms


def counts(lost: Lost, settings: Settings) -> bool:
    """Whether time lost is beyond chance, and material where another truck was in the way."""
    return lost.p_value < float(np.exp(-settings.evidence)) and lost.share >= settings.material * lost.touched


def finding_of(lost: Lost, channel: Channel, fit: dict[str, Any]) -> Finding:
    """Return the finding; ``fit`` is the error with that time and without."""
    term = next(t for t in all_terms().values() if t.acts == "traffic")
    lanes = channel.cells(term)
    assert isinstance(lanes, Stretches)
    first, half = term.parameters[0], NORMAL * lost.error
    share = Parameter(first.name, lost.share, max(lost.share - half, 0.0), lost.share + half, first.unit)
    where = _where(lost, lanes)
    gain = None if fit["before"] is None or fit["after"] is None else fit["before"] - fit["after"]
    return Finding(
        term.name, channel.name, words.statement(term, [share], where, None), [], None,
        list(term.depends_on), where, None,
        {"vehicles": None, "from": None, "until": None}, [share],
        {"p_value": lost.p_value, "held_out_gain": gain, "alternatives": []}, fit, lost.share,
    )  # fmt: skip


def _where(lost: Lost, lanes: Stretches) -> dict[str, Any]:
    """Stretches of lane where most is lost, the worst first; ``value`` is the share of the time spent
    there."""
    sure = lost.lost > NORMAL * lost.spread
    sure = sure if sure.any() else lost.lost >= lost.lost.max()
    keep = sure & (lost.lost >= LARGE * float(np.quantile(lost.lost[sure], 0.9)))
    rows = []
    for run in (r for e in np.unique(lanes.road_edge[keep]) for r in _on(lanes, keep, int(e))):
        seconds, time = float(lost.lost[run].sum()), max(float(lost.time[run].sum()), 1e-9)
        half = NORMAL * float(np.sqrt((lost.spread[run] ** 2).sum()))
        rows.append((seconds, {
            "edge_id": lanes.network.edge_ids[lanes.road_edge[run[0]]], "from": float(lanes.start[run[0]]),
            "to": float(lanes.end[run[-1]]), "value": seconds / time, "low": max(seconds - half, 0.0) / time,
            "high": (seconds + half) / time,
        }))  # fmt: skip
    low, high = lanes.middle()[keep].min(axis=0), lanes.middle()[keep].max(axis=0)
    extent = [float(low[0]), float(low[1]), float(high[0]), float(high[1])]
    return {"edges": [r for _, r in sorted(rows, key=lambda r: -r[0])], "extent": extent}


def _on(lanes: Stretches, keep: NDArray[np.bool_], edge: int) -> list[NDArray[np.intp]]:
    on = np.flatnonzero(lanes.road_edge == edge)
    return [on[r] for r in runs(keep[on], np.ones(len(on)))]


def values(lost: Lost) -> Values:
    """Return the share of the time lost by stretch of lane, for pictures and files."""
    time = np.maximum(lost.time, 1e-9)
    nothing = np.zeros((len(time), 0))
    return Values(lost.lost / time, lost.spread / time, lost.passages, nothing, np.zeros((0, 0)))
