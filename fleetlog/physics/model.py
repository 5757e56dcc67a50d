"""Physics on disk: ``model.toml`` and ``fields/TERM.parquet``, as ``diagnose`` and ``calibrate`` find it.

format_version = 1
truck = "counterbalance-48V"       # the nominal truck that it was found against, for the reader
off = []                           # terms left out of the sum
[term.auxiliary_load] power = 661.0 [term.grade]
field = "fields/grade.parquet"     # the first parameter per stretch of road
[interval.auxiliary_load] power = [640.0, 690.0]
[[own]]                            # what some vehicles, or some hours, have in place of that
vehicles = ["T3"]                  # absent: all
from = 2026-03-14T09:00:00Z        # absent: from the first row on
until = 2026-03-14T17:00:00Z       # absent: to the last row
drift = true                       # comes in evenly from the one to the other
[own.term.rolling_resistance] coefficient = 0.019"""

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from fleetlog.core.network import Network
from fleetlog.core.schema import anything, flag, list_of, load_toml, moment, real, table, tables, text, whole
from fleetlog.core.truck import Truck
from fleetlog.errors import InputError, chosen
from fleetlog.physics.field import Field, load_field, mirrored, save_field
from fleetlog.physics.power import Own, Physics, all_terms
from fleetlog.physics.term import Term, Values

FILE = "model.toml"
KEYS = {
    "format_version": whole(), "truck": text, "off": list_of(text), "term": tables, "interval": tables,
    "own": list_of(anything),
}  # fmt: skip
OWN_KEYS = {"vehicles": list_of(text, 1), "from": moment, "until": moment, "drift": flag, "term": tables}
NUMBER = real(-1e12, 1e12)


def save_physics(path: str | Path, physics: Physics, network: Network | None = None) -> None:
    """Write ``physics`` (all but its truck) into a folder: model.toml, and its fields beside it."""
    folder = Path(path)
    data = {
        "format_version": 1, "truck": physics.truck.name, "off": sorted(physics.off),
        "term": _term_tables(physics, folder, network),
    }  # fmt: skip
    if physics.intervals:
        data["interval"] = {n: {k: list(v) for k, v in p.items()} for n, p in physics.intervals.items()}
    if physics.own:
        data["own"] = [_own_table(o, folder, network) for o in physics.own]
    (folder / FILE).write_text(tomli_w.dumps(data), encoding="utf-8")


def _own_table(own: Own, folder: Path, network: Network | None) -> dict[str, Any]:
    times = {"from": own.begin, "until": own.until}
    return {
        **({} if own.vehicles is None else {"vehicles": list(own.vehicles)}),
        **{key: datetime.fromtimestamp(at, UTC) for key, at in times.items() if np.isfinite(at)},
        **({"drift": True} if own.drift else {}),
        "term": _term_tables(own, folder, network),
    }


def _term_tables(of: Physics | Own, folder: Path, network: Network | None) -> dict[str, dict[str, Any]]:
    """The tables of terms as TOML has them; their fields are written beside the model."""
    out: dict[str, Any] = {n: {k: float(np.asarray(x)) for k, x in v.items()} for n, v in of.values.items()}
    for name, field in of.fields.items():
        place = f"fields/{name}.parquet"
        save_field(folder / place, field, network)
        out.setdefault(name, {})["field"] = place
    return out


def load_physics(path: str | Path, truck: Truck, network: Network | None = None) -> Physics:
    """The physics of a model file, or of its folder, for a truck and the network that motions will lie on;
    :class:`InputError` names the file, the term or parameter at fault and the nearest known one."""
    path = Path(path)
    file = path / FILE if path.is_dir() else path
    do = "give the output of fleetlog diagnose, or its model.toml"
    data = table(load_toml(file, do=do), KEYS, file, "")
    if data.get("format_version", 1) != 1:
        raise InputError(f"format version {data['format_version']}, this fleetlog reads 1", where=file)
    values, found = _read_terms(data.get("term", {}), network, file)
    off = frozenset(_term(name, file).name for name in data.get("off", ()))
    two, given = list_of(NUMBER, 2, 2), data.get("interval", {}).items()
    intervals = {
        _term(n, file).name: table(p, dict.fromkeys(p, two), file, f"interval.{n}") for n, p in given
    }
    own = tuple(_own(o, f"own.{i}", network, file) for i, o in enumerate(data.get("own", ())))
    return Physics(truck, values, off, found, intervals, own)


def _read_terms(
    tables: Mapping[str, Any], network: Network | None, file: Path
) -> tuple[dict[str, Values], dict[str, Field]]:
    values: dict[str, Values] = {}
    found: dict[str, Field] = {}
    for name, entries in tables.items():
        term = _term(name, file)
        numbers = table(entries, {**dict.fromkeys(term.by_name, NUMBER), "field": text}, file, f"term.{name}")
        if place := numbers.pop("field", None):
            found[name] = _field(term, place, network, file)
        if numbers or name not in found:  # A field needs no entry of numbers of its own.
            values[name] = numbers
    return values, found


def _own(data: Any, place: str, network: Network | None, file: Path) -> Own:
    given = table(data, OWN_KEYS, file, place)
    begin, until = given.get("from", -np.inf), given.get("until", np.inf)
    drift = given.get("drift", False)
    if begin >= until or (drift and not np.isfinite(until - begin)):
        do = "give from and until, the later one last"
        raise InputError("no time lies between from and until", where=file, place=place, do=do)
    values, found = _read_terms(given.get("term", {}), network, file)
    return Own(values, given.get("vehicles"), begin, until, drift, found)


def _term(name: str, file: Path) -> Term:
    return chosen(all_terms(), name, f"unknown term {name!r}", InputError, where=file, place=f"term.{name}")


def _field(term: Term, place: str, network: Network | None, file: Path) -> Field:
    """The field at a place in the folder of the model, or below it."""
    parquet, spot = file.parent / place, f"term.{term.name}.field"
    if not term.field:
        raise InputError("this term does not vary over the roads", where=file, place=spot, do="give a number")
    if not parquet.resolve().is_relative_to(file.parent.resolve()):
        outside = f"{place!r} lies outside the model's folder"
        raise InputError(outside, where=file, place=spot, do="move it there")
    if not parquet.exists():
        raise InputError(f"{parquet.name} is missing", where=file, place=spot)
    field = load_field(parquet, network)
    # What belongs to the road itself acts in both directions; a rule of traffic only where it was seen.
    return mirrored(field, network, term.odd) if network is not None and term.acts == "force" else field
