"""What ``--json`` prints meets the schema of the reference, for every command that has one; and every command has one."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from test_one_surface import COMMANDS

import fleetlog
from fleetlog.store.documents import json_text

SCHEMAS = Path(__file__).parents[2] / "docs" / "reference" / "json"
jsonschema = pytest.importorskip("jsonschema")

QUICK: dict[str, Callable[[fleetlog.Result, Path], fleetlog.Result]] = {
    "import": lambda r, s: r,
    "import_dry_run": lambda r, s: fleetlog.read_logs(s / "logs" / "T8.nmea.gz", dry_run=True),
    "info": lambda r, s: fleetlog.info(s / "truck.toml"),
    "export": lambda r, s: fleetlog.export(r, to="csv", output=s.parent / "out.csv"),
    "simulate": lambda r, s: fleetlog.simulate(
        site=s / "site.toml", truck=s / "truck.toml", vehicles=2, duration="2m", recording=False
    ),
    "simulate_cycle": lambda r, s: fleetlog.simulate(
        cycle="vdi2198", truck="counterbalance-2.5t", duration="2m", recording=False
    ),
    "analyze_trips": lambda r, s: fleetlog.analyze.trips(r),
    "analyze_stops": lambda r, s: fleetlog.analyze.stops(r),
    "analyze_density": lambda r, s: fleetlog.analyze.density(r, include_standing=True),
    "analyze_heatmap": lambda r, s: fleetlog.analyze.heatmap(r, by="hour"),
    "analyze_energy": lambda r, s: fleetlog.analyze.energy(r, truck="counterbalance-2.5t"),
}  # fmt: skip


@pytest.mark.parametrize("name", QUICK)
def test_answers_meet_their_schema(name: str, recorded: fleetlog.Result, sample: Path) -> None:
    schema = json.loads((SCHEMAS / f"{name}.json").read_text(encoding="utf-8"))
    answer = json.loads(json_text(QUICK[name](recorded, sample).summary))
    optional = {"output", "dataset"}  # of a command, which must say where
    schema["required"] = [k for k in schema.get("required", ()) if k not in optional]
    jsonschema.validate(answer, schema)


def test_every_command_has_a_schema_on_the_page() -> None:
    page = (SCHEMAS.parent / "json.md").read_text(encoding="utf-8")
    for path, _ in COMMANDS:
        assert f"\n## fleetlog {' '.join(path)}\n" in page, path
        assert (SCHEMAS / f"{'_'.join(path)}.json").is_file()


def schema(name: str) -> dict[str, object]:
    found: dict[str, object] = json.loads((SCHEMAS / f"{name}.json").read_text(encoding="utf-8"))
    return found


EVERYWHERE = {
    "term": "rolling_resistance", "channel": "battery_power", "statement": "It rolls harder.", "not_excluded": [],
    "needs": None, "depends_on": ["speed"], "where": None, "when": None,
    "parameters": [{"name": "coefficient", "value": 0.02, "low": 0.019, "high": 0.021, "unit": "1"}],
    "scope": {"vehicles": None, "from": None, "until": None},
    "evidence": {"p_value": 1e-9, "held_out_gain": 0.1, "alternatives": []},
    "fit": {"metric": "m", "before": 0.2, "after": 0.1},
}  # fmt: skip
SOMEWHERE = {
    **EVERYWHERE, "term": "grade", "not_excluded": ["surface_resistance"], "needs": "drive it the other way",
    "where": {"edges": [{"edge_id": "e", "from": 0.0, "to": 2.0, "value": 0.04, "low": 0.03, "high": 0.05}],
              "extent": [0.0, 0.0, 9.0, 9.0]},
    "when": {"column": "ambient_temperature", "below": 5.0, "unit": "degC"},
    "scope": {"vehicles": ["T3"], "from": "2026-03-02T06:00:00Z", "until": None},
    "evidence": {"p_value": 0.001, "held_out_gain": None,
                 "alternatives": [{"term": "surface_resistance", "held_out_gain": 0.03, "depends_on": ["x"]}]},
}  # fmt: skip


@pytest.mark.parametrize("finding", [EVERYWHERE, SOMEWHERE], ids=["everywhere", "somewhere"])
def test_findings_of_every_kind_meet_the_schema(finding: dict[str, object]) -> None:
    """What the contract says may be null, and what it may be else."""
    findings = schema("diagnose")["properties"]["findings"]  # type: ignore[index]
    jsonschema.validate([finding], findings)


@pytest.mark.parametrize("vehicles", [1, 5])
def test_near_misses_of_any_kinds_meet_the_schema(vehicles: int, sample: Path) -> None:
    """One truck meets nobody; five meet in some ways and not in others."""
    fleet = fleetlog.simulate(
        site=sample / "site.toml", truck=sample / "truck.toml", vehicles=vehicles, duration="5m",
        recording=False, shadow=False,
    )  # fmt: skip
    found = json.loads(json_text(fleetlog.analyze.near_misses(fleet).summary))
    jsonschema.validate(found, schema("analyze_near_misses") | {"required": ["kinds", "near_misses"]})


@pytest.mark.parametrize("truck", [None, "truck.toml"])
def test_reports_with_and_without_a_truck_meet_the_schema(
    truck: str | None, recorded: fleetlog.Result, sample: Path
) -> None:
    told = fleetlog.report(recorded, truck=truck and sample / truck, diagnosis=False).summary
    answer = json.loads(json_text(told))
    required = [k for k in schema("report")["required"] if k != "output"]  # type: ignore[attr-defined]
    jsonschema.validate(answer, schema("report") | {"required": required})
    answer["datasets"][0]["left_out"] = ["The truck model leaves nothing out."]
    jsonschema.validate(answer, schema("report") | {"required": required})
