"""Logs to a dataset, in seven steps: find, read, order, set down, clean, match, write.

Everything read is set down by vehicle and day first (:mod:`fleetlog.ingest.spill`), group of logs by group;
then every vehicle is cleaned, placed, matched and written, stretch by stretch.  Groups and vehicles are jobs
of the engine in use.  Memory is bounded by a stretch whatever the size of the logs.  A stretch ends where a
trip begins, so that no trip is torn and matching starts at a standstill.
"""

from __future__ import annotations

import itertools
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from fleetlog import engines
from fleetlog.core.site import MapFrame, Site
from fleetlog.errors import InputError
from fleetlog.importers._profile import Profile, load_profile
from fleetlog.ingest.clean import sort_rows
from fleetlog.ingest.files import Log, find_logs, names_of
from fleetlog.ingest.place import check_matched
from fleetlog.ingest.reading import Read, groups_of, read_group
from fleetlog.ingest.rejects import NAME, gather
from fleetlog.ingest.spill import Down
from fleetlog.ingest.stretch import Plan, import_vehicle, probe
from fleetlog.ingest.summary import ImportSummary, Outcome, added_up, complete
from fleetlog.store.provenance import provenance

if TYPE_CHECKING:
    from fleetlog.store.writer import DatasetWriter

Progress = Callable[[str, float], None]
"""Called with what is being done and the share of all that is done, 0 to 1."""
READ_SHARE = 0.5
ROW_COST, ROW_BYTES = 3e-6, 60.0
"""Of a row, about: to read it, or to match and write it [s]; its length in a log."""
ALIGN_VEHICLES = 20
"""Vehicles whose tracks are fitted to the roads."""


def import_logs(
    paths: Sequence[str | Path], site: Site | None, writer: DatasetWriter, *, format: str | None = None,
    profile: str | Path | Profile | None = None, progress: Progress | None = None, align: bool = False,
) -> ImportSummary:  # fmt: skip
    """Read ``paths`` (files, folders, patterns) and write their rows through ``writer``.

    ``site`` is None where there is no map: then the frame comes from the data.  The writer's site, provenance
    and summary are set; its ``finish`` is left to the caller.  ``align`` fits the frame of local positions to
    the roads of ``site``.  :class:`~fleetlog.errors.InputError` where nothing usable was found.
    """
    profile = load_profile(profile) if isinstance(profile, str | Path) else profile
    logs = find_logs(paths, format)
    scratch = writer.path / ".spill"
    scratch.mkdir()
    try:
        reads = list(_read(logs, scratch, profile, progress))
        _check_read(reads, logs)
        site, frames = site or Site(), profile.map_frames if profile is not None else ()
        site = replace(site, map_frames=tuple(dict.fromkeys((*site.map_frames, *frames))))
        every = frames[0] if len(frames) == 1 else None  # a profile that states one states it of all rows
        summary = _write(reads, logs, site, writer, scratch, progress, align=align, every=every)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    inputs = [f for log in logs for f in ([log.path] if log.path.is_file() else sorted(log.path.rglob("*")))]
    if profile is not None and profile.path:
        inputs.append(Path(profile.path))
    writer.provenance, writer.summary = provenance(inputs), summary.to_dict()
    if (before := writer.before).provenance:
        added = [*before.provenance.get("appended", ()), writer.provenance]
        writer.provenance = {**before.provenance, "appended": added}
        writer.summary = added_up(before.summary, writer.summary)
    return summary


def _read(
    logs: list[Log], scratch: Path, profile: Profile | None, progress: Progress | None
) -> Iterator[Read]:
    """What the groups of logs gave."""

    def tell(log: Log, share: float) -> None:
        if progress:
            progress(f"reading {log.path.name}", READ_SHARE * (logs.index(log) + share) / len(logs))

    groups = groups_of(logs)
    cost = ROW_COST * sum(log.path.stat().st_size for log in logs if log.path.is_file()) / ROW_BYTES
    engine = _engine(cost, len(groups))
    told = tell if type(engine) is engines.Engine else None
    work = partial(read_group, scratch, names_of(logs), profile, told)
    with closing(engine.run(work, groups, lambda group: str(group[1][0].path))) as reads:
        for (_, group), read in zip(groups, reads, strict=True):
            tell(group[-1], 1.0)
            yield read


def _engine(cost: float, jobs: int) -> engines.Engine:
    engine = engines.current()
    return engine if jobs > 1 and engine.pays(cost) else engines.Engine()


def _check_read(reads: Sequence[Read], logs: list[Log]) -> None:
    """One clear line where there is nothing to go on with."""
    errors, rows = [e for r in reads for e in r.errors], sum(r.down.rows for r in reads)
    if errors and len(logs) == 1:
        raise errors[0]
    if any(r.positioned for r in reads):
        return
    where = logs[0].path if len(logs) == 1 else f"{logs[0].path} and {len(logs) - 1} more"
    if errors and not rows:
        raise errors[0]
    if rows:
        do = "map latitude and longitude, or x and y, in a profile"
        raise InputError("no position in the log", where=where, do=do)
    counts = sum((r.refused.rows for r in reads), Counter[str]())
    refused = _reasons(dict(counts.most_common(3)))
    why = f" (refused {refused})" if refused else ""
    raise InputError(f"no usable row in the log{why}", where=where, do="see docs/logs.md")


def _reasons(counts: dict[str, int]) -> str:
    return ", ".join(f"{n:,}: {reason}" for reason, n in counts.items())


def _aligned(down: Down, site: Site, summary: ImportSummary) -> MapFrame:
    """The frame of the log, fitted to the roads."""
    from fleetlog.ingest.align import align

    tracks = []
    for vehicle in down.vehicles[:ALIGN_VEHICLES]:
        for rows, _ in itertools.islice(down.windows(vehicle), 1):
            if "latitude" in rows:
                raise InputError("the log is geographic: it needs no alignment", do="leave --align out")
            rows = sort_rows(rows)
            tracks.append((rows.floats("x"), rows.floats("y")))
    found = align(tracks, site.roads())
    summary.alignment = found.to_dict()
    summary.notes.append(found.line())
    return found.frame


def _write(
    reads: Sequence[Read], logs: list[Log], site: Site, writer: DatasetWriter, scratch: Path,
    progress: Progress | None, *, align: bool, every: MapFrame | None,
) -> ImportSummary:  # fmt: skip
    """Vehicle by vehicle into the dataset."""
    summary, down = ImportSummary(), Down()
    for read in reads:
        summary.files += read.files
        summary.rows_read += read.rows
        down.add(read.down)
    positioned = frozenset(v for read in reads for v in read.positioned)
    every = _aligned(down, site, summary) if align else every
    plan = Plan(writer.path, scratch, site, names_of(logs), down.own, positioned, writer.before, every)
    plan = probe(plan, down)
    writer.site = plan.site
    summary.notes += plan.notes
    outcomes = list(_vehicles(plan, down, progress))
    for outcome in outcomes:
        writer.written.add(outcome.written)
    complete(summary, outcomes)
    check_matched(summary.matched, summary.rows, plan.site)
    refusals = [*(r.refused for r in reads), *(o.refused for o in outcomes)]
    refused = gather(refusals, writer.path, older=writer.before.rejected)
    summary.rejected, summary.rejected_values = dict(refused.rows), dict(refused.values)
    summary.rejected_file = NAME if refused.file else None
    if not summary.rows:
        raise InputError("every row was refused", do=_reasons(summary.rejected))
    return summary


def _vehicles(plan: Plan, down: Down, progress: Progress | None) -> Iterator[Outcome]:
    """What each vehicle came to, in their order."""
    jobs = [(number, vehicle, down.of(vehicle)) for number, vehicle in enumerate(down.vehicles)]
    total, done = max(down.rows, 1), 0
    engine = _engine(ROW_COST * total, len(jobs))
    results = engine.run(partial(import_vehicle, plan), jobs, lambda job: f"vehicle {job[1]}")
    with closing(results) as outcomes:
        for (_, vehicle, mine), outcome in zip(jobs, outcomes, strict=True):
            done += mine.rows
            if progress:
                share = READ_SHARE + (1.0 - READ_SHARE) * done / total
                progress(f"matched and written: {vehicle}", share)
            yield outcome
