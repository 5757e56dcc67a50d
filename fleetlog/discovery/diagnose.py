"""The whole algorithm on one screen: what physics a recording has that the model has not."""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial

from fleetlog import engines
from fleetlog.core.site import Site
from fleetlog.core.truck import Truck
from fleetlog.core.words import percent
from fleetlog.discovery.channels.base import Channel, lay_out
from fleetlog.discovery.channels.choose import CHANNELS, ROWS, channel_of, present
from fleetlog.discovery.explain import Explained, Searched, Task, explain, searched, unseen
from fleetlog.discovery.model import Model
from fleetlog.discovery.recording.fleet import COLUMNS, Fleet, absences, read_fleet
from fleetlog.discovery.recording.sensors import Fault, examine
from fleetlog.discovery.recording.splits import Kind, Split, make_split, passed_once
from fleetlog.discovery.report import words
from fleetlog.discovery.report.finding import Verdict
from fleetlog.discovery.report.others import of_fault
from fleetlog.discovery.settings import SETTINGS, Settings
from fleetlog.errors import ArgumentError, DataError, nearest
from fleetlog.physics.power import all_terms
from fleetlog.store import Dataset


@dataclass
class Diagnosis:
    """The verdict and all that is needed to draw and write it."""

    verdict: Verdict
    found: Model
    channels: dict[str, Explained]
    fleet: Fleet


def diagnose(
    dataset: Dataset, truck: Truck, *, site: Site | None = None, channels: Sequence[str] = (),
    terms: Sequence[str] = (), without: Sequence[str] = (), holdout: Kind = "trips",
    against: Dataset | None = None, seed: int = 0, settings: Settings = SETTINGS,
    progress: Callable[[str], None] = lambda _: None,
) -> Diagnosis:  # fmt: skip
    """Say where recording and model differ, and what was left out.

    ``site`` replaces the dataset's own; ``channels`` and ``terms`` restrict what is looked at and what may be
    named; the columns ``without`` are withheld; only the final scores read what ``holdout`` keeps back; what
    the rows of ``against``, a simulated dataset, show beyond the nominal truck is then part of the model.

    :class:`DataError` where no channel can be judged, :class:`ArgumentError` where a name is unknown.
    """
    check(channels=channels, terms=terms, without=without)
    base = Model(truck)
    if against is not None:
        progress("simulation")
        base = diagnose(against, truck, site=site, settings=settings).found

    progress("reading")
    fleet = read_fleet(dataset, truck, site, without)
    split = _split(fleet, holdout, settings, seed)
    progress("sensors")
    logged, (fleet, faults) = fleet, examine(fleet, split, tuple(terms))
    progress("windows")
    found = [channel_of(name, fleet, base, settings, split) for name in present(fleet, channels)]
    if not found:
        raise DataError("no channel to judge", do="record power, state of charge, or positions on a road map")
    lay_out(found)
    explained: dict[str, Explained] = {}
    search = partial(searched, base, tuple(terms))

    def conclude(own: Task, result: Searched) -> None:
        progress(_name(own))
        explained[_name(own)] = explain(own, base, result)
        own.sample.channel.put_back()

    def alone(channel: Channel) -> None:
        conclude(own := Task(channel, split, settings), search(own))

    # The longest search is a worker's; all about the other channels is done beside it.
    longest = Task(found[0], split, settings)
    beside = [partial(alone, channel) for channel in found[:0:-1]]
    with closing(engines.current().run(search, [longest], _name, beside)) as results:
        conclude(longest, *results)
    explained = {c.name: explained[c.name] for c in found}
    for e in [e for f in faults if (e := explained.get(f.channel)) and e.fit.before]:
        # The nominal model knows of no fault of a logger.
        e.fit.before = unseen(channel_of(e.fit.name, logged, base, settings, split), e.before)
    return Diagnosis(_verdict(fleet, explained, faults), together(base, explained), explained, fleet)


def _name(own: Task) -> str:
    return own.problem.channel.name


def together(base: Model, explained: dict[str, Explained]) -> Model:
    """Return one model of everything found in any channel."""
    for new in (e.after for e in explained.values()):
        base = replace(base, at=base.at | new.at, fields=base.fields | new.fields, when=base.when | new.when)
    return base


def _split(fleet: Fleet, holdout: Kind, settings: Settings, seed: int) -> Split:
    vehicles = sorted({d.vehicle for d in fleet.days})
    window = max(settings.window, ROWS * fleet.update)
    return make_split(
        holdout, fleet.trips, fleet.seconds, vehicles, list(fleet.dates), settings.folds, settings.held_out,
        seed, window, bool(fleet.own_trips) or passed_once(fleet.days, window),
    )  # fmt: skip


def _verdict(fleet: Fleet, explained: dict[str, Explained], faults: list[Fault]) -> Verdict:
    findings = [of_fault(f, fleet.vehicles) for f in faults]
    for e in explained.values():
        # What one channel has explained is not told again of the next.
        told = [(f.term, f.scope) for f in findings]
        findings += [f for f in e.findings if f.term == "unknown" or (f.term, f.scope) not in told]
    order = sorted(findings, key=lambda f: -f.strength)
    once = any(e.problem.split.once for e in explained.values())
    unexplained = [n for n, e in explained.items() if e.unexplained]
    adjustments = [a for e in explained.values() for a in e.adjustments]
    notes = absences(fleet, once) + [n for e in explained.values() for n in _hidden(e)]
    sparse = frozenset().union(*(e.problem.channel.sparse for e in explained.values()))
    left_out = [*fleet.left_out, *(fleet.vehicles[v] for v in sorted(sparse))]
    return Verdict([e.fit for e in explained.values()], order, adjustments, unexplained, notes, left_out)


def _hidden(e: Explained) -> list[str]:
    """What a channel hides, and what is slight. No travel time is known better than the profile is right."""
    channel, settings, notes = e.problem.channel, e.problem.settings, list(e.problem.channel.notes)
    trucks, kinds = channel.fleet.vehicles, channel.fleet.loggers
    for kind in (k for k in kinds if not channel.sparse.issuperset(k)):
        if (own := channel.own_error[kind[0]]) > max(settings.material, settings.profile_error):
            whose = f" of {', '.join(trucks[v] for v in kind)}" if len(kinds) > 1 else ""
            apart = "rows are too far apart to show effects of less than"
            notes.append(f"{channel.name}{whose}: {apart} {percent(own)}")
    if channel.sparse and e.fit.before is not None:
        apart = ", ".join(f"{trucks[v]} ({channel.fleet.steps[v]:.0f} s)" for v in sorted(channel.sparse))
        notes.append(f"{channel.name}: not judged of trucks whose rows are too far apart: {apart}")
    for vehicle, share in e.strain.items():
        if share > settings.material:
            whose = "" if vehicle is None else f" that set {trucks[vehicle]} apart from the others"
            many = f"{channel.name}: numbers of the truck file{whose}, each within its tolerance, change"
            off = "together, more than chance would: one of them may be far off"
            notes.append(f"{many} {percent(share)} {off}")
    if e.hidden and e.findings:
        notes.append(f"{channel.name}: {e.hidden}")
    if e.slight is not None:
        h, share = e.slight
        notes.append(f"{channel.name}: {words.slight(h.term, h.depends_on, share, settings.material)}")
    notes += [f"{channel.name}: {words.unseen(h.depends_on)}" for h in e.unseen]
    return notes


def check(**names: Sequence[str]) -> None:
    """Raise :class:`ArgumentError` where a name of an option is unknown."""
    known = {"channels": CHANNELS, "terms": tuple(all_terms()), "without": COLUMNS}
    for option, name in ((o, n) for o, given in names.items() for n in given if n not in known[o]):
        do = nearest(name, known[option], words.said_of_terms() if option == "terms" else {})
        raise ArgumentError(f"unknown {name!r}", where=f"--{option}", do=do)
