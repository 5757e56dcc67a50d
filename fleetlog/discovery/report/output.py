"""The folder of a diagnosis: JSON, model, fields; page and recording are drawn elsewhere."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from fleetlog.core.result import Result
from fleetlog.discovery.diagnose import Diagnosis
from fleetlog.discovery.hypotheses.scope import FLEET
from fleetlog.discovery.report import fields, maps
from fleetlog.discovery.report.finding import ChannelFit, Finding
from fleetlog.physics.field import Field
from fleetlog.physics.model import save_physics
from fleetlog.physics.own import Own
from fleetlog.physics.power import Physics, all_terms
from fleetlog.store.documents import plain, write_json

MOST_LINES = 12


def write_diagnosis(d: Diagnosis, folder: Path) -> None:
    """Write everything but what is drawn into an existing folder."""
    write_json(folder / "diagnosis.json", d.verdict.document(), indent=1)
    save_physics(folder, physics(d), d.fleet.network)
    (folder / "fields").mkdir(exist_ok=True)


def physics(d: Diagnosis) -> Physics:
    """Return the model found: numbers of the fleet and single trucks, fields by stretch, intervals."""
    found: dict[str, Field] = {}
    intervals: dict[str, dict[str, tuple[float, float]]] = {}
    timed: list[Own] = []
    for e in d.channels.values():
        for name, values in e.fields.items():
            term = all_terms()[name]
            found[name] = fields.as_field(e.problem.channel.cells(term), values, term, d.fleet.network)
            when = d.found.when.get(name, FLEET)
            if when.timed:
                timed.append(Own({}, None, when.begin, when.until, when.drift, {name: found.pop(name)}))
        for knob, n in e.numbers.items():
            if knob.scope.whole:
                intervals.setdefault(knob.term, {})[knob.parameter] = (n.low, n.high)
    own = [replace(o, vehicles=(v,)) for i, v in enumerate(d.fleet.vehicles) for o in d.found.own(i)]
    told = (*_gathered(own, d.fleet.vehicles), *timed)
    return Physics(d.fleet.truck, dict(d.found.values()), fields=found, intervals=intervals, own=told)


def _gathered(own: list[Own], vehicles: tuple[str, ...]) -> tuple[Own, ...]:
    """What vehicles have in common told once, of all where it is all."""
    alike: list[Own] = []
    for o in own:
        same = [i for i, a in enumerate(alike) if replace(a, vehicles=o.vehicles) == o]
        if same:
            alike[same[0]] = replace(o, vehicles=(*(alike[same[0]].vehicles or ()), *(o.vehicles or ())))
        else:
            alike.append(o)
    return tuple(replace(a, vehicles=None) if a.vehicles == vehicles else a for a in alike)


def shapes(d: Diagnosis) -> list[Any]:
    """Return everything drawable, of the first energy channel."""
    for channel in ("battery_power", "soc"):
        if channel in d.channels:
            return list(maps.shapes(d.channels[channel]))
    return []


def as_result(d: Diagnosis) -> Result:
    """Return the diagnosis for ``view``."""
    return Result("diagnosis", plain(d.verdict.document()), shapes=shapes(d), lines=lines(d))


HEADS = {
    "none": "Nothing is missing: recording and model agree within the noise of the recording.",
    "unknown": "The recording differs from the model, and known physics does not explain all of it.",
}


def lines(d: Diagnosis) -> list[str]:
    """Return the answer in a few lines for a terminal."""
    v = d.verdict
    count = len(v.findings)
    head = HEADS.get(v.word, f"The model leaves out {count} effect{'s' if count > 1 else ''}:")
    out = [head if any(c.judged for c in v.channels) else "Too little was recorded to judge any channel."]
    for f in v.findings[:4]:
        out.extend(_finding(f))
    out += [_channel(c, c.name in v.unexplained) for c in v.channels]
    room = max(MOST_LINES - len(out), 0)
    return [*out, *(f"  note: {n}" for n in v.notes[:room])]


def _finding(f: Finding) -> list[str]:
    out = [f"  {f.term} ({f.channel}): {f.statement}."]
    if f.not_excluded:
        out.append(f"    Not excluded: {', '.join(f.not_excluded)}. To tell them apart, {f.needs}.")
    return out


def _channel(c: ChannelFit, unexplained: bool) -> str:
    if c.before is None or c.after is None:
        return f"  {c.name}: not judged: {c.reason}"
    floor = "" if c.floor is None else f", noise floor {c.floor:.1%}"
    more = "; the rest is unexplained" if unexplained else ""
    return f"  {c.name}: error on unseen trips {c.before:.1%} -> {c.after:.1%}{floor}{more}"
