"""``fleetlog view``: open a replay in the Rerun viewer."""

from __future__ import annotations

import tempfile
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import click

from fleetlog.cli.options import (
    Between,
    anywhere,
    existing,
    named_files,
    notice,
    overwrite_option,
    quiet_option,
)


@click.command()
@click.argument("path", type=existing)
@click.option(
    "--beside", type=existing, help="Another dataset, drawn on the same timeline with the differences."
)
@click.option("--save", type=anywhere, help="Keep the recording of --beside in this .rrd file.")
@click.option("--screenshot", type=anywhere, help="Draw it without a screen into this PNG file.")
@overwrite_option
@click.option("--at", help="Time of the screenshot (UTC, ISO 8601); the middle of the recording by default.")
@click.option("--rate", type=Between(0.01, 100.0), help="Samples a second when the replay is made again.")
@quiet_option
def command(
    path: Path, beside: Path | None, save: Path | None, screenshot: Path | None, overwrite: bool,
    at: str | None, rate: float | None, quiet: bool,
) -> None:  # fmt: skip
    """Open the replay of PATH, a dataset, the folder of an analysis, or an .rrd file, in the Rerun viewer.

    The replay of a dataset is made again where it is missing or older than the dataset, or when --rate is
    given. With --beside, PATH is the recorded fleet (orange) and the other one the simulated (blue).
    """
    if save is not None and beside is None:
        raise click.UsageError("--save goes with --beside")
    from fleetlog.view import viewer

    when = None if at is None else viewer.nanoseconds_of(at)
    inputs = named_files({"path": path, "beside": beside})
    with (
        _written(screenshot, "picture", overwrite, inputs) as picture,
        _written(save, "recording", overwrite, inputs) as kept,
    ):
        if beside is None:
            rrd = viewer.recording_of(path, rate_hz=rate, say=lambda text: notice(text, quiet))
            if screenshot is not None and when is None:
                when = viewer.middle_of_driving(path)
            _open(rrd, picture, when)
        else:
            _compare(path, beside, kept, picture, when, rate, quiet)
    if screenshot is not None:
        notice(f"wrote {screenshot}", quiet)


def _written(
    target: Path | None, kind: str, overwrite: bool, inputs: list[Path]
) -> AbstractContextManager[Path | None]:
    """The scratch file of an output that was asked for."""
    from fleetlog.store.output import atomic_output

    if target is None:
        return nullcontext()
    return atomic_output(target, kind, overwrite=overwrite, folder=False, inputs=inputs)


def _compare(
    path: Path,
    beside: Path,
    kept: Path | None,
    picture: Path | None,
    when: int | None,
    rate: float | None,
    quiet: bool,
) -> None:
    """Make the recording of two datasets; show it unless it was only to be kept."""
    from fleetlog.view.comparison import write_comparison
    from fleetlog.view.recording import RATE

    notice("making the comparison", quiet)
    with tempfile.TemporaryDirectory() as folder:
        both = kept or Path(folder) / "comparison.rrd"
        write_comparison(path, beside, both, rate_hz=rate or RATE)
        if kept is None or picture is not None:
            _open(both, picture, when)


def _open(rrd: Path, picture: Path | None, when: int | None) -> None:
    """Show a recording in a window, or draw it into a file."""
    from fleetlog.view import headless, viewer

    if picture is None:
        viewer.show(rrd)
    else:
        headless.screenshot(rrd, picture, at=when)
