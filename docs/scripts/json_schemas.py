"""The schemas of what ``--json`` prints, from what the commands say of the sample data.

python docs/scripts/json_schemas.py        write docs/reference/json/*.json and docs/reference/json.md

A key is required where every run had it.  Every number may be null: unknown is null, never zero.  What was null
in every run may be anything.
"""

from __future__ import annotations

import contextlib
import json
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
OUT = ROOT / "docs" / "reference" / "json"
MAPS = {
    "recognised", "rejected", "rejected_values", "derived_by_vehicle", "off_map", "by", "ledger_kwh", "measured_from",
    "waiting_s", "columns", "extent", "entities", "product", "entity", "activity_hours", "factors", "summary", "reports",
    "tasks", "rows", "kinds", "filled", "not_judged",
}  # fmt: skip
"""Keys whose objects have keys of the data: names of vehicles, columns, terms, kinds of encounters."""
OPEN = {"where", "when"}
"""Objects that say what they have to, null where that is everywhere or always (docs/diagnose.md)."""
TYPES = {str: "string", bool: "boolean", int: "integer", float: "number", type(None): "null"}


def runs(sample: Path) -> Iterator[tuple[str, Any]]:
    """What each command answers, with the command."""
    import fleetlog
    from fleetlog.api.verb import REQUIRED
    from fleetlog.cli.main import verb_lines

    site, truck = sample / "site.toml", sample / "truck.toml"
    recorded = fleetlog.read_logs(sample / "logs", site=site)
    one = fleetlog.read_logs(sample / "logs" / "fleet.csv.gz", site=site, recording=False)
    yield "import", recorded
    yield "import", fleetlog.read_logs(sample / "logs" / "T8.nmea.gz", recording=False)
    yield "import --dry-run", fleetlog.read_logs(sample / "logs", dry_run=True)
    fleet: dict[str, Any] = {"site": site, "truck": truck, "vehicles": 4, "duration": "10m"}
    simulated = fleetlog.simulate(**fleet, output=sample.parent / "simulated")
    yield "simulate", simulated
    yield "simulate", fleetlog.simulate(like=one, truck=truck, duration="10m", recording=False, shadow=False)
    yield (
        "simulate --same-mission",
        fleetlog.simulate(like=one, truck=truck, same_mission=True, recording=False),
    )
    yield (
        "simulate --same-mission",
        fleetlog.simulate(like=one, truck=truck, same_mission=True, together=True, recording=False),
    )
    yield "simulate --cycle", fleetlog.simulate(cycle="vdi2198", truck=truck, duration="5m", recording=False)
    yield "simulate --vary", fleetlog.simulate(**{**fleet, "vehicles": "2,4"}, runs=2)
    for name in fleetlog.analyze.lines():
        needed = {o.name for o in getattr(fleetlog.analyze, name).options if o.default is REQUIRED}
        options = {"truck": truck} if "truck" in needed else {}
        for data in (recorded, simulated):
            with contextlib.suppress(fleetlog.FleetlogError):
                yield f"analyze {name}", fleetlog.analyze(name, data, **options)
    yield "analyze heatmap", fleetlog.analyze.heatmap(recorded, compare=simulated)
    yield "analyze chargers", fleetlog.analyze.chargers(one, k=2, check=True, truck=truck, duration="30m")
    yield "diagnose", fleetlog.diagnose(one, truck=truck, output=sample.parent / "diagnosis")
    yield "calibrate", fleetlog.calibrate(one, truck=truck)
    if "report" in verb_lines():
        yield "report", fleetlog.report(one, truck=truck, diagnosis=False)
        yield "report", fleetlog.report([one, simulated])
    if "learn" in verb_lines():
        yield "learn", fleetlog.learn(one)
    for to in ("csv", "sumo-net"):
        yield "export", fleetlog.export(one, to=to, output=sample.parent / to)
    yield "view", fleetlog.view(recorded, beside=simulated, save=sample.parent / "both.rrd")
    yield "demo", fleetlog.demo(data=sample.parent / "again")
    yield "record", captured(sample.parent / "messages.jsonl")
    described = [
        recorded, simulated, sample / "logs" / "fleet.csv.gz", site, truck, sample / "roads.geojson",
        sample.parent / "diagnosis", simulated.output / "recording.rrd",
    ]  # fmt: skip
    for thing in described:
        yield "info", fleetlog.info(thing)


def captured(file: Path) -> Any:
    """What ``record`` answers that hears nothing for a second, from the broker of the tests (wheel amqtt)."""
    import fleetlog

    sys.path.insert(0, str(ROOT / "tests" / "ingest"))
    from test_record import Broker, free_port

    port = free_port()
    with Broker(port):
        return fleetlog.record(f"mqtt://127.0.0.1:{port}/#", output=file, duration=1.0)


def schema_of(values: list[Any], key: str = "") -> dict[str, Any]:
    """The schema that all ``values`` meet."""
    kinds = {TYPES.get(type(v), "object" if isinstance(v, dict) else "array") for v in values}
    if key in OPEN:
        return {"type": ["null", "object"]}
    if kinds == {"null"}:
        return {}
    objects = [v for v in values if isinstance(v, dict)]
    items = [x for v in values if isinstance(v, list) for x in v]
    if kinds & {"number", "integer"}:
        kinds = (kinds - {"integer"} if "number" in kinds else kinds) | {"null"}
    out: dict[str, Any] = {"type": sorted(kinds) if len(kinds) > 1 else next(iter(kinds))}
    if objects and key in MAPS | {"vehicles"}:
        inner = [x for v in objects for x in v.values()]
        return {**out, "additionalProperties": schema_of(inner)} if inner else out
    if objects:
        found: dict[str, list[Any]] = defaultdict(list)
        for v in objects:
            for name, value in v.items():
                found[name].append(value)
        out["properties"] = {n: schema_of(found[n], n) for n in sorted(found)}
        out["required"] = sorted(n for n in found if len(found[n]) == len(objects))
    if items:
        out["items"] = schema_of(items)
    return out


def page(schemas: dict[str, dict[str, Any]]) -> str:
    """The page that lists them, with the keys of each."""
    out = [
        "<!-- made by docs/scripts/json_schemas.py -->\n\n# JSON\n\nWhat `--json` prints, as JSON Schema (2020-12). "
        "Unknown is null; keys may be added. The same object is `Result.summary` in Python and `NAME.json` in the "
        "folder of an analysis.\n"
    ]
    for name, schema in schemas.items():
        out.append(
            f"\n## fleetlog {name}\n\n[{file_of(name)}](json/{file_of(name)})\n\n| key | type |\n| --- | --- |"
        )
        for key, value in schema.get("properties", {}).items():
            kind = value.get("type", "any")
            kind = kind if isinstance(kind, str) else " or ".join(kind)
            out.append(f"| `{key}` | {kind}{'' if key in schema['required'] else ', where it applies'} |")
    return "\n".join(out) + "\n"


def file_of(name: str) -> str:
    """``analyze_density.json`` of ``analyze density``."""
    return name.replace(" --", "_").replace(" ", "_").replace("-", "_") + ".json"


def main() -> None:
    """Run everything once, write the schemas and the page."""
    import fleetlog
    from fleetlog.store.documents import json_text

    said: dict[str, list[Any]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder:
        sample = Path(folder) / "sample"
        fleetlog.demo(data=sample)
        for name, answer in runs(sample):
            where = {} if answer.output is None else {"output": str(answer.output)}
            said[name].append(json.loads(json_text({**answer.summary, **where})))
    OUT.mkdir(exist_ok=True)
    schemas = {name: schema_of(values) for name, values in said.items()}
    for name, schema in schemas.items():
        head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"fleetlog {name}"}
        (OUT / file_of(name)).write_text(json.dumps({**head, **schema}, indent=1) + "\n", encoding="utf-8")
    (OUT.parent / "json.md").write_text(page(schemas), encoding="utf-8")


if __name__ == "__main__":
    main()
