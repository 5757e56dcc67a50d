"""Read logs, match them to the roads, write a dataset and its replay."""

from collections.abc import Sequence
from typing import Annotated, Any, cast

from fleetlog import engines, scratch
from fleetlog.api.answer import Answer, dataset_answer
from fleetlog.api.inputs import LogsLike, PathLike, SiteLike, as_path, as_site, existing, files_of
from fleetlog.api.verb import verb
from fleetlog.core.arguments import Between, PartOf
from fleetlog.errors import ArgumentError
from fleetlog.listening import progress


@verb(jobs=True)
def import_(
    logs: LogsLike, *, site: SiteLike | None = None,
    format: Annotated[str, PartOf("fleetlog.importers", "IMPORTER")] | None = None,
    profile: PathLike | None = None, align: bool = False, dry_run: bool = False, recording: bool = True,
    rate: Annotated[float, Between(0.0, 1e6, above=True)] = 2.0, append: bool = False,
    output: PathLike | None = None, overwrite: bool = False,
) -> Answer:  # fmt: skip
    """Read LOGs (files, folders, patterns), match them to the roads, write a dataset and its replay.

    In Python also ``read_logs``; a log may be a DataFrame with the columns of a raw log.

    Parameters
    ----------
    logs : files, folders and patterns.
    site : site file, or a road map directly; without it nothing is matched.
    format : format of the logs, where their content does not say it.
    profile : what the columns are (TOML); see docs/logs.md.
    align : fit the log's own frame (x, y) to the roads of the site.
    dry_run : show the first rows as they would be read; write nothing.
    rate : samples per second of each vehicle in the replay.
    append : add the rows to an existing dataset, with its site; no replay is written.
    output : folder of the dataset, or a URL (``s3://...``).

    Examples
    --------
    >>> import fleetlog
    >>> recorded = fleetlog.read_logs("sample/logs", site="sample/site.toml", recording=False)
    >>> recorded.summary["trips"], sorted(recorded.summary["vehicles"])[:3]
    (180, ['T1', 'T2', 'T3'])
    >>> recorded.dataset.read("T1").to_pandas().columns[:3].tolist()
    ['vehicle_id', 'timestamp', 'x']"""
    if append and (overwrite or site is not None or output is None):
        raise ArgumentError("goes with an output, not with --overwrite or --site", where="--append")
    if align and site is None:
        raise ArgumentError("--align fits a log to the roads of --site: name it")
    paths = [as_path(log) for log in cast("Sequence[LogsLike]", logs)]
    read: dict[str, Any] = {"format": format, "profile": None if profile is None else existing(profile)}
    if dry_run:
        from fleetlog.ingest.files import preview

        shown = preview(paths, **read)
        return Answer("import", shown.to_dict(), lines=shown.lines(), status=shown.exit_status)
    from fleetlog.core.site import Site
    from fleetlog.ingest.files import expanded
    from fleetlog.ingest.pipeline import import_logs
    from fleetlog.store import DatasetWriter

    target = scratch.folder() / "dataset" if output is None else as_path(output)
    inputs = files_of(*expanded(paths), site, profile)
    if append:
        writing = DatasetWriter.append(target, inputs=inputs)
    else:
        place = Site() if site is None else as_site(site)
        writing = DatasetWriter.create(target, "recorded", place, overwrite=overwrite, inputs=inputs)
    engines.current().ahead = engines.loading("fleetlog.view.recording") if recording and not append else ()
    with writing as writer:
        summary = import_logs(paths, writer.site, writer, align=align, **read)
        if recording and not append:
            from fleetlog.view.recording import write_recording

            progress("writing the replay", 1.0)
            writer.finish()
            write_recording(writer.path, writer.path / "recording.rrd", rate_hz=rate)
    if summary.rejected_file:
        summary.rejected_file = str(target / summary.rejected_file)
    where = None if output is None else target
    answer = dataset_answer("import", target, where, summary.to_dict(), summary.lines(), summary.exit_status)
    if summary.damaged:
        kept = summary.rejected_file or target
        answer.warning = f"{summary.rows_rejected:,} rows were rejected or damaged; see {kept}"
    return answer
