"""What becomes of a file: the exit status that it deserves, its lines, and the rows that were kept."""

from __future__ import annotations

import json
import shutil
import warnings
from dataclasses import dataclass, field
from pathlib import Path

from fleetlog.analysis.tariff import load_tariff
from fleetlog.core.site import Place, Site
from fleetlog.core.truck import load_truck
from fleetlog.errors import FleetlogError
from fleetlog.importers._open import ReadReport
from fleetlog.importers._profile import load_profile
from fleetlog.importers.base import Importer, ReadOptions, detect, read_guarded
from fleetlog.ingest.pipeline import import_logs
from fleetlog.physics.model import load_physics
from fleetlog.roads import load_site
from fleetlog.simulate.tasks import read_tasks
from fleetlog.store import DatasetWriter
from fleetlog.verbs.simulate import simulate


@dataclass
class Outcome:
    """``status`` as the command's, ``lines`` all that is said, ``rows`` what was kept (of a map: its edges)."""

    status: int
    lines: list[str] = field(default_factory=list)
    rows: int = 0
    columns: set[str] = field(default_factory=set)

    @property
    def text(self) -> str:
        return "\n".join(self.lines)


def _of_error(error: FleetlogError) -> Outcome:
    line = error.line()
    assert "\n" not in line and len(line) < 3000, line[:300]
    return Outcome(1, [error.line()])


def read(path: Path, profile: Path | None = None, importer: Importer | None = None) -> Outcome:
    """A log as its reader gives it; the cleaning that follows is left out."""
    report = ReadReport(path)
    out = Outcome(0)
    rejected = False
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            options = ReadOptions(report, load_profile(profile) if profile else None)
            for batch in read_guarded(importer or detect(path), path, options):
                assert len(batch.vehicle) == len(batch.time) == len(batch.record)
                assert all(len(v) == len(batch) for v in batch.columns.values())
                out.rows += len(batch) if batch.has_position else 0
                out.columns |= set(batch.columns)
                out.lines += sorted({r.reason for r in batch.rejects})
                rejected |= bool(batch.rejects)
        except FleetlogError as error:
            return _of_error(error)
    out.lines += [*report.damage, *report.notes, *map(" is ".join, report.recognised.items())]
    out.status = 3 if rejected or report.damage else 0
    return out


def imported(
    paths: Path | list[Path], folder: Path, site: Path | None = None, profile: Path | None = None
) -> Outcome:
    """The whole import, into ``folder``/out."""
    target = folder / "out"
    shutil.rmtree(target, ignore_errors=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            place = load_site(site)[0] if site else Site()
            with DatasetWriter.create(target, "recorded", place) as writer:
                summary = import_logs(
                    paths if isinstance(paths, list) else [paths], place, writer, profile=profile
                )
        except FleetlogError as error:
            return _of_error(error)
    json.loads((target / "dataset.json").read_text(), parse_constant=_no_number)
    kept = summary.rows + summary.rows_rejected + summary.rows_joined
    assert kept == summary.rows_read, f"{summary.rows_read} rows read, {kept} accounted for"
    return Outcome(summary.exit_status, summary.lines(), summary.rows, set())


def _no_number(name: str) -> None:
    raise AssertionError(f"{name} in dataset.json")


def settings(path: Path) -> Outcome:
    """A map, or a file of settings by its name."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            if path.name == "truck.toml":
                load_truck(path)
            elif path.name == "profile.toml":
                load_profile(path)
            elif path.name == "model.toml":
                load_physics(path, load_truck("counterbalance-2.5t"))
            elif path.name == "tariff.toml":
                load_tariff(path)
            elif path.name == "tasks.csv":
                places = tuple(Place(name, "pick", 0.0, 0.0) for name in "pq")
                read_tasks(path, Site(places=places), load_truck("counterbalance-2.5t"))
            elif path.name == "experiment.toml":
                simulate.converted(experiment=str(path))
            else:
                site, _ = load_site(path)
                return Outcome(0, rows=len(site.network) if site.network else 0)
        except FleetlogError as error:
            return _of_error(error)
    return Outcome(0)
