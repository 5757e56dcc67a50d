"""``fleetlog view``: open a replay in the Rerun viewer."""

from __future__ import annotations

import tempfile
from pathlib import Path

import click

from fleetlog.cli.options import anywhere, existing, notice, quiet_option


@click.command()
@click.argument("path", type=existing)
@click.option(
    "--beside", type=existing, help="Another dataset, drawn on the same timeline with the differences."
)
@click.option("--save", type=anywhere, help="Keep the recording of --beside in this .rrd file.")
@click.option("--screenshot", type=anywhere, help="Draw it without a screen into this PNG file.")
@click.option("--at", help="Time of the screenshot (UTC, ISO 8601); the middle of the recording by default.")
@click.option(
    "--rate", type=click.FloatRange(0.01, 100.0), help="Samples a second when the replay is made again."
)
@quiet_option
def command(
    path: Path, beside: Path | None, save: Path | None, screenshot: Path | None, at: str | None, rate: float | None,
    quiet: bool,
) -> None:  # fmt: skip
    """Open the replay of PATH, a dataset, the folder of an analysis, or an .rrd file, in the Rerun viewer.

    The replay of a dataset is made again where it is missing or older than the dataset, or when --rate is given.
    With --beside, PATH is the recorded fleet (orange) and the other one the simulated (blue).
    """
    if save is not None and beside is None:
        raise click.UsageError("--save goes with --beside")
    from fleetlog.view import viewer

    when = None if at is None else viewer.nanoseconds_of(at)
    if beside is None:
        rrd = viewer.recording_of(path, rate_hz=rate, say=lambda text: notice(text, quiet))
        if screenshot is not None and when is None:
            when = viewer.middle_of_driving(path)
        _open(rrd, screenshot, when, quiet)
        return
    with tempfile.TemporaryDirectory() as folder:
        both = save or Path(folder) / "comparison.rrd"
        from fleetlog.view.comparison import write_comparison
        from fleetlog.view.recording import RATE

        notice(f"making {both if save else 'the comparison'}", quiet)
        write_comparison(path, beside, both, rate_hz=rate or RATE)
        if save is None or screenshot is not None:
            _open(both, screenshot, when, quiet)


def _open(rrd: Path, screenshot: Path | None, when: int | None, quiet: bool) -> None:
    """Show a recording in a window, or draw it into a file."""
    from fleetlog.view import headless, viewer

    if screenshot is None:
        viewer.show(rrd)
        return
    headless.screenshot(rrd, screenshot, at=when)
    notice(f"wrote {screenshot}", quiet)
