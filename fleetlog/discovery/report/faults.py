"""Faults of the recording as findings."""

from fleetlog.discovery.recording.sensors import Fault
from fleetlog.discovery.report import words
from fleetlog.discovery.report.finding import Finding, Parameter
from fleetlog.discovery.search.intervals import NORMAL
from fleetlog.physics.power import all_terms


def finding_of(fault: Fault) -> Finding:
    """Return the finding of a fault; it goes first, as everything else is judged with it put right."""
    term = all_terms()[fault.term]
    first = term.parameters[0]
    half = NORMAL * fault.error
    parameters = [
        Parameter(first.name, fault.value, fault.value - half, fault.value + half, first.unit, first.neutral)
    ]
    vehicles = None if fault.all_vehicles else sorted(fault.by_vehicle)
    evidence = {"p_value": fault.p_value, "held_out_gain": fault.before - fault.after, "alternatives": []}
    return Finding(
        fault.term, fault.channel, words.statement(term, parameters, None, None), [], None,
        list(term.depends_on), None,
        {"vehicles": {v: float(x) for v, x in fault.by_vehicle.items()}},
        {"vehicles": vehicles, "from": None, "until": None}, parameters, evidence,
        {"metric": fault.metric, "before": fault.before, "after": fault.after}, 1.0 + fault.before,
    )  # fmt: skip
