"""Findings that need no search: faults of the recording, time lost to others, and what outlasts trips."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fleetlog.core.words import percent
from fleetlog.discovery.channels.base import Channel
from fleetlog.discovery.channels.paths import Lost
from fleetlog.discovery.hypotheses.cells import LARGE, Stretches
from fleetlog.discovery.model import FLEET, Scope
from fleetlog.discovery.recording.sensors import Fault
from fleetlog.discovery.report import finding, words
from fleetlog.discovery.report.fields import Values, row
from fleetlog.discovery.report.finding import NORMAL, Errors, Finding, Parameter, interval
from fleetlog.discovery.settings import Settings
from fleetlog.physics.power import all_terms
from fleetlog.physics.term import Term


def of_fault(fault: Fault, vehicles: Sequence[str]) -> Finding:
    """Return the finding of a fault; it goes first, as everything else is judged with it put right."""
    term, off = all_terms()[fault.term], fault.off
    first = term.parameters[0]
    number = interval(first, off.value, off.error, first.neutral)
    errors = Errors(fault.metric, fault.before, fault.after, off.p_value)
    whose = FLEET if off.all_vehicles else Scope(tuple(sorted(off.by_vehicle, key=lambda v: vehicles[v])))
    scope = words.scope(whose, vehicles)
    found = _finding(term, fault.channel, number, errors, None, 1.0 + fault.before, scope)
    by_name = {vehicles[v]: float(x) for v, x in off.by_vehicle.items()}
    found.when = {"vehicles": by_name} if len(set(by_name.values())) > 1 else None
    return found


def counts(lost: Lost, settings: Settings) -> bool:
    """Whether time lost is beyond chance, and material where another truck was in the way."""
    return lost.p_value < float(np.exp(-settings.evidence)) and lost.share >= settings.material * lost.touched


def of_lost(lost: Lost, channel: Channel, errors: Errors) -> Finding:
    """Return the finding of time lost; ``errors`` with the windows in which that happened, and without."""
    term = next(t for t in all_terms().values() if t.acts == "traffic")
    lanes = channel.cells(term)
    assert isinstance(lanes, Stretches)
    share = interval(term.parameters[0], lost.share, lost.error, 0.0)
    everyone = words.scope(FLEET, ())
    return _finding(term, channel.name, share, errors, _where(lost, lanes), lost.share, everyone)


def values(lost: Lost) -> Values:
    """Return the share of the time lost by stretch of lane, for pictures and files."""
    time = np.maximum(lost.time, 1e-9)
    return Values(lost.lost / time, lost.passages, np.diag(lost.spread / time), *[np.eye(len(time))] * 2)


def lasts(lasting: finding.Lasting, channel: Channel, settings: Settings) -> bool:
    """Whether what trips that follow one another have in common is beyond chance, the model's own error, and
    material."""
    evident = lasting.p_value < float(np.exp(-settings.evidence))
    own = channel.plain_error if lasting.vehicle is None else float(channel.own_error[lasting.vehicle])
    return evident and lasting.share > max(settings.material, own)


def of_lasting(evident: Sequence[finding.Lasting], fit: finding.ChannelFit, trucks: Sequence[str]) -> Finding:
    """Return the finding of what outlasts trips, or stands, and follows nothing that was recorded."""
    most = max(evident, key=lambda one: one.share)
    errors = Errors(fit.metric, fit.after, fit.after, most.p_value)
    odd = tuple(one.vehicle for one in evident if one.vehicle is not None)
    if most.vehicle is None:
        whose, what = FLEET, f"{percent(most.share)} of their {'time' if fit.name == 'speed' else 'energy'}"
        text = (
            f"Trips in a row differ from the model in the same way, by {what}; no column of the log shows why"
        )
    else:
        whose = Scope(odd) if 2 * len(odd) <= len(trucks) else FLEET
        what = f"by {percent(most.share)} of the mean power"
        text = f"A consumer that no column shows goes on and off: trucks at rest differ from the model {what}"
    needs = "record what is switched on and off (heaters, pumps, brakes) as columns of the log"
    return Finding(
        "unknown", fit.name, text, [], needs, ["time"], None, None, words.scope(whose, trucks), [],
        errors.evidence([]), errors.fit, most.share,
    )  # fmt: skip


def _finding(
    term: Term, channel: str, number: Parameter, errors: Errors, where: dict[str, Any] | None,
    strength: float, scope: dict[str, Any],
) -> Finding:  # fmt: skip
    text = words.statement(term, [number], where, scope)
    return Finding(
        term.name, channel, text, [], None, list(term.depends_on), where, None, scope, [number],
        errors.evidence([]), errors.fit, strength,
    )  # fmt: skip


def _where(lost: Lost, lanes: Stretches) -> dict[str, Any]:
    """Stretches of lane where most is lost, the worst first; ``value`` is the share of the time there."""
    sure = lost.lost > NORMAL * lost.spread
    sure = sure if sure.any() else lost.lost >= lost.lost.max()
    keep = sure & (lost.lost >= LARGE * float(np.quantile(lost.lost[sure], 0.9)))
    rows = []
    for run in lanes.runs(keep, np.ones(len(lanes))):
        seconds, time = float(lost.lost[run].sum()), max(float(lost.time[run].sum()), 1e-9)
        half = NORMAL * float(np.sqrt((lost.spread[run] ** 2).sum()))
        ends = max(seconds - half, 0.0) / time, (seconds + half) / time
        rows.append((seconds, row(lanes, run, seconds / time, *ends)))
    return {"edges": [r for _, r in sorted(rows, key=lambda r: -r[0])], "extent": lanes.extent(keep)}
