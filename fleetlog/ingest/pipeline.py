"""Logs to a dataset, in seven steps: find, read, order, set down, clean, match, write.

Everything read is set down by vehicle first (:mod:`fleetlog.ingest.rows`), group of logs by group;
then every vehicle is cleaned, placed, matched and written, stretch by stretch.  Groups and vehicles are jobs
of the engine in use.  Memory is bounded by a stretch whatever the size of the logs.  A stretch ends where a
trip begins, so that no trip is torn and matching starts at a standstill."""

import shutil
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

from fleetlog import engines
from fleetlog.core.site import MapFrame, Site
from fleetlog.core.words import listed, reasons
from fleetlog.errors import DataError, InputError
from fleetlog.importers._profile import Profile, load_profile
from fleetlog.ingest.clean import sort_rows
from fleetlog.ingest.files import Log, find_logs, names_of
from fleetlog.ingest.reading import READ_SHARE, Read, groups_of, read_group
from fleetlog.ingest.rows import REJECTED, Slip, gather, windows
from fleetlog.ingest.stretch import Plan, import_vehicle, load_matcher, probe
from fleetlog.ingest.summary import ImportSummary, Outcome, added_up, complete
from fleetlog.listening import progress
from fleetlog.store.documents import provenance
from fleetlog.store.writer import DatasetWriter

ROW_COST, ROW_BYTES = 3e-6, 60.0  # Of a row, about: to read it, or match and write it [s]; its length
NO_ROWS = 0.0005  # A smaller share of rows on roads is shown as 0.0 %
ALIGN_VEHICLES = 20  # Vehicles whose tracks are fitted to the roads
UNPLACED = "roads, places, heat maps, density and travel times say nothing of them"


def import_logs(
    paths: Sequence[str | Path], site: Site | None, writer: DatasetWriter, *, format: str | None = None,
    profile: str | Path | Profile | None = None, align: bool = False,
) -> ImportSummary:  # fmt: skip
    """Read ``paths`` (files, folders, patterns) and write their rows through ``writer``.

    ``site`` is None where there is no map: then the frame comes from the data.  The writer's site, provenance
    and summary are set; its ``finish`` is left to the caller.  ``align`` fits the frame of local positions to
    the roads of ``site``.  :class:`~fleetlog.errors.InputError` where nothing usable was found."""
    profile = load_profile(profile) if isinstance(profile, str | Path) else profile
    logs = find_logs(paths, format)
    inputs = [f for log in logs for f in ([log.path] if log.path.is_file() else sorted(log.path.rglob("*")))]
    if profile is not None and profile.path:
        inputs.append(Path(profile.path))
    scratch = writer.path / ".spill"
    scratch.mkdir()
    try:
        said = cache(partial(provenance, inputs, site=site))
        reads = list(_read(logs, scratch, profile, (said, partial(load_matcher, site))))
        _check_read(reads, logs)
        site, frames = site or Site(), profile.map_frames if profile is not None else ()
        site = replace(site, map_frames=tuple(dict.fromkeys((*site.map_frames, *frames))))
        every = frames[0] if len(frames) == 1 else None  # a profile that states one states it of all rows
        plan = Plan(writer.path, scratch, site, names_of(logs), before=writer.before, every=every)
        summary = _write(reads, plan, writer, align=align)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    writer.provenance, writer.summary = said(), summary.to_dict()
    if writer.old is not None:
        first = writer.old.meta["provenance"]
        writer.provenance = {**first, "appended": [*first.get("appended", ()), writer.provenance]}
        writer.summary = added_up(writer.old.meta.get("summary", {}), writer.summary)
    return summary


def _read(logs: list[Log], scratch: Path, profile: Profile | None, ahead: engines.Tasks) -> Iterator[Read]:
    """What the groups of logs gave; who waits for them does what is ``ahead``."""
    groups = groups_of(logs)
    cost = ROW_COST * sum(log.path.stat().st_size for log in logs if log.path.is_file()) / ROW_BYTES
    engine = engines.current()
    if engine.pays(cost):  # of one log, kernels would be loaded when workers have them
        engine.ahead = [*engine.ahead, *ahead[: len(groups)]]
    work = partial(read_group, scratch, names_of(logs), profile)
    with closing(engine.run(work, groups, lambda group: str(group[1][0].path), cost=cost)) as reads:
        for (first, group), read in zip(groups, reads, strict=True):
            progress(f"reading {group[-1].path.name}", READ_SHARE * (first + len(group)) / len(logs))
            yield read


def _check_read(reads: Sequence[Read], logs: list[Log]) -> None:
    """One clear line where there is nothing to go on with."""
    errors, rows = [e for r in reads for e in r.errors], any(r.slips for r in reads)
    if errors and (len(logs) == 1 or not rows):
        raise errors[0]
    if any(r.positioned or r.driven for r in reads):
        return
    where = logs[0].path if len(logs) == 1 else f"{logs[0].path} and {len(logs) - 1} more"
    if rows:
        do = "map latitude and longitude, x and y, or speed in a profile (--profile FILE.toml)"
        raise InputError("no position and no speed in the log", where=where, do=do)
    counts = sum((r.rejects.rows for r in reads), Counter[str]())
    why = f" (refused: {reasons(dict(counts.most_common(3)))})" if counts else ""
    bare = not counts and {log.importer.name for log in logs if log.importer} == {"csv"}
    what = "has a header and no rows" if bare else f"no usable row in the log{why}"
    raise InputError(what, where=where, do="see docs/logs.md")


def _aligned(slips: Mapping[str, Sequence[Slip]], site: Site, summary: ImportSummary) -> MapFrame:
    """The frame of the log, fitted to the roads."""
    from fleetlog.ingest.align import align

    tracks = []
    for vehicle in sorted(slips)[:ALIGN_VEHICLES]:
        rows, _ = next(windows(slips[vehicle]))
        if "latitude" in rows:
            raise InputError("the log is geographic: it needs no alignment", do="leave --align out")
        rows = sort_rows(rows)
        tracks.append((rows.floats("x"), rows.floats("y")))
    found = align(tracks, site.roads())
    summary.alignment = found.summary
    summary.notes.append(found.line)
    return found.frame


def _write(reads: Sequence[Read], plan: Plan, writer: DatasetWriter, *, align: bool) -> ImportSummary:
    """Vehicle by vehicle into the dataset."""
    summary = ImportSummary(files=[f for read in reads for f in read.files])
    summary.rows_read = sum(f.rows for f in summary.files)
    slips: dict[str, list[Slip]] = defaultdict(list)
    own: dict[str, bool] = {}
    for read in reads:
        for slip in read.slips:
            slips[slip.vehicle].append(slip)
        for name, text in read.own.items():
            own[name] = own.get(name, False) or text
    every = _aligned(slips, plan.site, summary) if align else plan.every
    placed, driven = (frozenset().union(*(getattr(r, n) for r in reads)) for n in ("positioned", "driven"))
    plan = probe(replace(plan, own=own, positioned=placed, driven=driven, every=every), slips)
    writer.site = plan.site
    summary.notes += plan.notes
    if unplaced := sorted(driven - placed):
        summary.notes += (f"no positions of {listed(unplaced)}: {UNPLACED}",)
    outcomes = list(_vehicles(plan, slips))
    for outcome in outcomes:
        writer.pieces += outcome.pieces
        writer.columns |= outcome.columns
    complete(summary, outcomes)
    if summary.matched is not None and summary.rows and summary.matched < NO_ROWS:
        do = "check the site's frame and the log's coordinates and units, or import without --site"
        what = f"0.0 % of the {summary.rows:,} rows are on a road of site {plan.site.name!r}"
        raise DataError(what, do=do)  # another place, or another frame
    every_reject = [*(r.rejects for r in reads), *(o.rejects for o in outcomes)]
    rejects = gather(every_reject, writer.path, None if writer.old is None else writer.old.path / REJECTED)
    summary.rejected, summary.rejected_values = dict(rejects.rows), dict(rejects.values)
    summary.rejected_file = REJECTED if rejects.file else None
    if not summary.rows:
        what = f"every row was refused: {reasons(summary.rejected)}"
        raise InputError(what, where=summary.files[0].file, do="state columns, units and crs in a profile")
    return summary


def _vehicles(plan: Plan, slips: Mapping[str, list[Slip]]) -> Iterator[Outcome]:
    """What each vehicle came to, in their order."""
    jobs = [(number, vehicle, slips[vehicle]) for number, vehicle in enumerate(sorted(slips))]
    rows = [sum(slip.rows for slip in job[2]) for job in jobs]
    done, cost, work = 0, ROW_COST * sum(rows), partial(import_vehicle, plan)
    with closing(engines.current().run(work, jobs, lambda job: f"vehicle {job[1]}", cost=cost)) as outcomes:
        for (_, vehicle, _), mine, outcome in zip(jobs, rows, outcomes, strict=True):
            done += mine
            progress(f"matched and written: {vehicle}", READ_SHARE + (1.0 - READ_SHARE) * done / sum(rows))
            yield outcome
