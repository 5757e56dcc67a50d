"""The folder of a diagnosis: JSON, model, fields, report; the recording is drawn by ``view``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fleetlog.core.result import Result
from fleetlog.discovery import fields, maps
from fleetlog.discovery.diagnose import Diagnosis
from fleetlog.discovery.report import html
from fleetlog.physics.field import Field
from fleetlog.physics.model import save_physics
from fleetlog.physics.power import Physics, all_terms
from fleetlog.store.documents import plain, write_json


def write_diagnosis(d: Diagnosis, folder: Path) -> None:
    """Everything but the recording into an existing folder."""
    write_json(folder / "diagnosis.json", d.verdict.document(), indent=1)
    save_physics(folder, physics(d), d.fleet.network)
    (folder / "fields").mkdir(exist_ok=True)
    (folder / "report.html").write_text(html(d, shapes(d)), encoding="utf-8")


def physics(d: Diagnosis) -> Physics:
    """The model found, fields looked up by stretch, with intervals."""
    found_fields: dict[str, Field] = {}
    intervals: dict[str, dict[str, tuple[float, float]]] = {}
    for e in d.channels.values():
        for name, values in e.result.fields.items():
            term = all_terms()[name]
            found_fields[name] = fields.as_field(e.task.cells(term), values, term, d.fleet.network)
        for name, numbers in e.result.numbers.items():
            intervals[name] = {k: (v - 1.96 * s, v + 1.96 * s) for k, (v, s) in numbers.items()}
    values_of = {k: dict(v) for k, v in d.found.values.items() if k not in found_fields}
    return Physics(
        d.fleet.truck, {k: dict(v) for k, v in values_of.items()}, fields=found_fields, intervals=intervals
    )


def shapes(d: Diagnosis) -> list[Any]:
    """Everything drawable, the energy channel first."""
    out: list[Any] = []
    for channel in ("battery_power", "soc"):
        if channel in d.channels and not out:
            out.extend(maps.shapes(d.channels[channel]))
    return out


def as_result(d: Diagnosis) -> Result:
    """For ``view``."""
    return Result("diagnosis", plain(d.verdict.document()), shapes=shapes(d), lines=lines(d))


def lines(d: Diagnosis) -> list[str]:
    """The answer in at most ten lines for a terminal."""
    v = d.verdict
    head = {
        "none": "Nothing is missing: recording and model agree within what the data can tell.",
        "found": f"{len(v.findings)} thing{'s' if len(v.findings) > 1 else ''} that the model leaves out:",
        "unknown": "The model leaves something out that no known term explains:",
    }[v.word]
    out = [head]
    for f in v.findings[:4]:
        numbers = ", ".join(
            f"{p.name} {p.value:.4g} [{p.low:.4g}, {p.high:.4g}] {p.unit if p.unit != '1' else ''}".strip()
            for p in f.parameters[:2]
        )
        out.append(f"  {f.term} ({f.channel}): {f.statement}." + (f" {numbers}" if numbers else ""))
        if f.not_excluded:
            out.append(f"    not excluded: {', '.join(f.not_excluded)}; {f.needs}")
    out += [
        f"  {c.name}: held-out error {c.before:.3f} -> {c.after:.3f} (floor {c.floor:.3f})"
        for c in v.channels
    ]
    room = 10 - len(out)
    return [*out, *(f"  note: {n}" for n in v.notes[: max(room, 0)])][:10]
