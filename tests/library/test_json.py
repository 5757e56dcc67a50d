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
