"""``fleetlog view``: open a replay in the Rerun viewer."""

from __future__ import annotations

from pathlib import Path

import click

from fleetlog.cli.options import existing, notice, quiet_option


@click.command()
@click.argument("path", type=existing)
@click.option(
    "--screenshot", type=click.Path(path_type=Path), help="Draw it without a screen into this PNG file."
)
@click.option("--at", help="Time of the screenshot (UTC, ISO 8601); the middle of the recording by default.")
@click.option(
    "--rate", type=click.FloatRange(0.01, 100.0), help="Samples a second when the replay is made again."
)
@quiet_option
def command(path: Path, screenshot: Path | None, at: str | None, rate: float | None, quiet: bool) -> None:
    """Open the replay of PATH, a dataset, the folder of an analysis, or an .rrd file, in the Rerun viewer.

    The replay of a dataset is made again where it is missing or older than the dataset, or when --rate is given.
    """
    from fleetlog.view import viewer

    rrd = viewer.recording_of(path, rate_hz=rate, say=lambda text: notice(text, quiet))
    if screenshot is not None:
        from fleetlog.view import headless

        when = None if at is None else viewer.nanoseconds_of(at)
        headless.screenshot(rrd, screenshot, at=when)
        notice(f"wrote {screenshot}", quiet)
        return
    viewer.show(rrd)
