"""The whole algorithm on one screen: what physics a recording has that the model has not."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fleetlog.core.site import Site
from fleetlog.core.truck import Truck
from fleetlog.discovery import words
from fleetlog.discovery.explain import Explained, Options, energy_channel
from fleetlog.discovery.finding import Finding, Parameter, Verdict
from fleetlog.discovery.fleet import Fleet, absences, read_fleet
from fleetlog.discovery.model import Found
from fleetlog.discovery.sensors import Fault, examine
from fleetlog.discovery.travel import speed_channel
from fleetlog.errors import DataError, nearest
from fleetlog.physics.power import all_terms
from fleetlog.store import Dataset

MUCH = 0.25
"""Share of a channel that may stay unexplained without a word."""
ONCE = (
    "most places are passed once: kept back were pieces of road between others that were seen, and what belongs to a place "
    "cannot be told from what belonged to that moment; drive the road again"
)
APART = (
    "nothing says where the trips went, so each may have a floor of its own: kept back were parts of trips of which other parts "
    "were seen"
)
CHANNELS = ("battery_power", "soc", "speed")


@dataclass
class Diagnosis:
    """The verdict and all that is needed to draw and write it."""

    verdict: Verdict
    found: Found
    channels: dict[str, Explained]
    faults: list[Fault]
    fleet: Fleet


def diagnose(
    dataset: Dataset,
    truck: Truck,
    *,
    site: Site | None = None,
    channels: Sequence[str] = (),
    terms: Sequence[str] = (),
    holdout: str = "trips",
    against: Dataset | None = None,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """Say where recording and model differ, and what was left out.

    Parameters
    ----------
    dataset : the recording.
    truck : the nominal truck.
    site : in place of the one that the dataset was made with.
    channels, terms : restrict what is looked at, and what may be named; all by default.
    holdout : ``trips``, ``vehicles`` or ``days``: what is kept back for the last judgement.
    against : a simulated dataset; what its own rows show beyond the nominal truck is then part of the model.

    Raises
    ------
    DataError
        Where no channel can be judged, or a name is unknown.
    """
    _check(channels, CHANNELS, "channel")
    _check(terms, all_terms(), "term")
    options = Options(tuple(terms), holdout, seed)
    base = Found(truck) if against is None else known(against, truck, site, options, progress)

    progress("reading")
    fleet = read_fleet(dataset, truck, site)
    progress("sensors")
    fleet, faults = (
        examine(fleet) if not terms or {"clock_offset", "speed_scale"} & set(terms) else (fleet, [])
    )
    explained: dict[str, Explained] = {}
    for channel in present(fleet, channels):
        progress(channel)
        look = speed_channel if channel == "speed" else energy_channel
        explained[channel] = look(fleet, channel, base, options)
    if not explained:
        raise DataError(
            "no channel to judge", do="record battery power, state of charge, or positions on a road map"
        )

    judged = [e.fit for e in explained.values() if np.isfinite(e.fit.before)]
    if not judged:
        raise DataError(
            "the recording is too short to judge any channel by trips that are kept back",
            do="record more trips",
        )
    findings = [*(_of_fault(f, explained) for f in faults), *_merged(explained)]
    notes = absences(fleet) + unexplained(explained, findings)
    notes += [f"{name}: too little of it to judge" for name, e in explained.items() if e.fit not in judged]
    if any(e.task.recording.windows.pieces for e in explained.values()):
        notes.append(ONCE if fleet.has("x") else APART)
    if (
        len({(v if holdout == "vehicles" else t.time[0] // 86_400_000_000) for v, t in fleet.days}) < 2
        and holdout != "trips"
    ):
        notes.append(
            f"all rows are of one of the {holdout} to keep back: stretches of time were kept back instead"
        )
    verdict = Verdict(judged, findings, notes)
    return Diagnosis(verdict, together(base, explained), explained, faults, fleet)


def known(
    dataset: Dataset, truck: Truck, site: Site | None, options: Options, progress: Callable[[str], None]
) -> Found:
    """What a simulated dataset holds beyond the nominal truck, learnt from its own rows."""
    progress("simulation")
    fleet = read_fleet(dataset, truck, site)
    explained = {}
    for channel in present(fleet, ()):
        look = speed_channel if channel == "speed" else energy_channel
        explained[channel] = look(fleet, channel, Found(truck), options)
    return together(Found(truck), explained)


def unexplained(explained: dict[str, Explained], findings: list[Finding]) -> list[str]:
    """A warning where nothing was named and much is left: then nothing is known, rather than nothing missing."""
    return [
        f"{e.fit.name}: {e.fit.after:.0%} of it stays unexplained, and these data do not say by what"
        for e in explained.values()
        if e.fit.after > MUCH and not any(f.channel == e.fit.name for f in findings)
    ]


def present(fleet: Fleet, wanted: Sequence[str]) -> list[str]:
    """Channels that the recording has; speed needs a map to say how fast one might have driven."""
    have = [c for c in ("battery_power", "soc") if fleet.has(c)]
    if fleet.sparse and len(have) == 2 and "battery_power" not in wanted:
        # A power that is seen now and then adds up to nothing exact; the state of charge has seen it all.
        have = ["soc"]
    if fleet.network is not None and fleet.has("edge_id") and (not fleet.sparse or "speed" in wanted):
        have.append("speed")
    return [c for c in have if not wanted or c in wanted]


def together(base: Found, explained: dict[str, Explained]) -> Found:
    """One model of everything found in any channel."""
    found = base
    for e in explained.values():
        for name, values in e.result.state.found.values.items():
            for parameter, value in values.items():
                found = found.with_value(name, parameter, value)
        for name, field in e.result.state.found.fields.items():
            found = replace(found, fields={**found.fields, name: field})
    return found


def _merged(explained: dict[str, Explained]) -> list[Finding]:
    """Findings of all channels, strongest first; what power has explained is not said again of the state of charge."""
    out: list[Finding] = []
    for channel in ("battery_power", "soc", "speed"):
        for finding in explained[channel].findings if channel in explained else []:
            if not any(f.term == finding.term != "unknown" for f in out):
                out.append(finding)
    return sorted(out, key=lambda f: -f.strength)


def _of_fault(fault: Fault, explained: dict[str, Explained]) -> Finding:
    term = all_terms()[fault.term]
    first = term.parameters[0]
    low, high = fault.value - 1.96 * fault.error, fault.value + 1.96 * fault.error
    parameters = [Parameter(first.name, fault.value, low, high, first.unit)]
    channel = "battery_power" if fault.term == "clock_offset" else "speed"
    metric = (
        "share of power left unexplained"
        if fault.term == "clock_offset"
        else "deviation of travelled distance"
    )
    fit = {"metric": metric, "before": fault.before, "after": fault.after}
    evidence = {"p_value": fault.p_value, "held_out_gain": fault.before - fault.after, "alternatives": []}
    vehicles = {"vehicles": {str(v): value for v, value in fault.by_vehicle.items()}}
    text = words.statement(fault.term, parameters, None, None)
    return Finding(
        fault.term,
        channel,
        text,
        [],
        None,
        list(term.depends_on),
        None,
        vehicles,
        parameters,
        evidence,
        fit,
        10.0,
    )


def _check(given: Sequence[str], known_names: Iterable[str], what: str) -> None:
    names = list(known_names)
    for name in given:
        if name not in names:
            raise DataError(f"unknown {what} {name!r}", do=nearest(name, names))
