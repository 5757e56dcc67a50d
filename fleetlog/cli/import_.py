"""``fleetlog import``: logs to a dataset and its replay."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fleetlog import interrupt
from fleetlog.cli.options import (
    Between,
    anywhere,
    engine_options,
    existing,
    json_option,
    notice,
    overwrite_option,
    printable,
    quiet_option,
    say,
)

if TYPE_CHECKING:
    from fleetlog.core.site import Site
    from fleetlog.ingest.summary import ImportSummary


@click.command(name="import")
@click.argument("logs", nargs=-1, required=True, metavar="LOG...")
@click.option(
    "--site", type=existing, help="Site file, or a road map directly; without it nothing is matched."
)
@click.option("--format", help="Format of the logs, where their content does not say it.")
@click.option("--profile", type=existing, help="What the columns are (TOML); see docs/logs.md.")
@click.option("-o", "--output", type=anywhere, help="Folder of the dataset.")
@click.option("--dry-run", is_flag=True, help="Show the first rows as they would be read; write nothing.")
@click.option("--no-recording", is_flag=True, help="Leave the replay out (fleetlog view can make it later).")
@click.option(
    "--rate",
    type=Between(0.0, 1e6, min_open=True),
    default=2.0,
    show_default=True,
    help="Samples a second of each vehicle in the replay.",
)
@click.option("--append", is_flag=True, help="Add the rows to a dataset that is there; its site is used.")
@overwrite_option
@json_option
@quiet_option
@engine_options
def command(
    logs: tuple[str, ...], site: Path | None, format: str | None, profile: Path | None, output: Path | None,
    dry_run: bool, no_recording: bool, rate: float, append: bool, overwrite: bool, as_json: bool, quiet: bool,
) -> int:  # fmt: skip
    """Read LOGs (files, folders, patterns), match them to the roads, write a dataset and its replay."""
    _check_format(format)
    if dry_run:
        from fleetlog.ingest.preview import preview

        shown = preview(logs, format=format, profile=profile)
        say(shown.lines(), shown.to_dict(), as_json=as_json, quiet=quiet)
        return shown.exit_status
    if output is None:
        raise click.UsageError("say where the dataset goes with -o, or look first with --dry-run")
    if append and (overwrite or site is not None):
        raise click.UsageError("--append goes with neither --overwrite nor --site: the dataset has its own")
    shown_at = None if no_recording or append else rate
    summary = _import(logs, site, format, profile, output, shown_at, append, overwrite, quiet)
    if summary.rejected_file:
        summary.rejected_file = str(output / summary.rejected_file)
    lines = [*summary.lines(), f"dataset: {output}"]
    say(lines, {**summary.to_dict(), "dataset": str(output)}, as_json=as_json, quiet=quiet)
    if summary.damaged and quiet:
        notice(
            f"fleetlog: {summary.rows_rejected:,} rows were rejected or damaged; "
            f"see {summary.rejected_file or output}"
        )
    return summary.exit_status


def _import(
    logs: tuple[str, ...], site: Path | None, format: str | None, profile: Path | None, output: Path,
    rate: float | None, append: bool, overwrite: bool, quiet: bool,
) -> ImportSummary:  # fmt: skip
    """The import and, unless ``rate`` is None, the replay."""
    from fleetlog.importers._profile import load_profile
    from fleetlog.ingest.pipeline import import_logs
    from fleetlog.store import DatasetWriter

    about = load_profile(profile) if profile else None
    inputs = [*map(Path, logs), *filter(None, (site, profile))]
    target = (
        DatasetWriter.append(output, inputs=inputs)
        if append
        else DatasetWriter.create(output, "recorded", _site(site, quiet), overwrite=overwrite, inputs=inputs)
    )
    with _progress(quiet) as progress, target as writer:
        summary = import_logs(logs, writer.site, writer, format=format, profile=about, progress=progress)
        if rate is not None:
            from fleetlog.view.recording import write_recording

            progress("writing the replay", 1.0)
            writer.finish()
            write_recording(writer.path, writer.path / "recording.rrd", rate_hz=rate)
    return summary


def _check_format(name: str | None) -> None:
    """A format that does not exist is wrong usage, not a fault of the logs."""
    from fleetlog.errors import InputError
    from fleetlog.importers.base import by_name

    try:
        if name is not None:
            by_name(name)
    except InputError as error:
        raise click.UsageError(error.line()) from None


def _site(path: Path | None, quiet: bool) -> Site:
    from fleetlog.core.site import Site

    if path is None:
        return Site()
    from fleetlog.roads import load_site

    site, reports = load_site(path)
    for report in reports:
        notice(report.line(), quiet)
    return site


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[str, float], None]]:
    """A bar on a terminal, nothing elsewhere; every step raises an interrupt that a library swallowed."""
    if quiet or not sys.stderr.isatty():
        yield lambda _text, _share: interrupt.check()
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("import", total=1.0)

        def tell(text: str, share: float) -> None:
            interrupt.check()
            bar.update(task, description=escape(printable(text)), completed=share)

        yield tell
