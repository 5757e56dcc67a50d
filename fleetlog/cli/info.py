"""``fleetlog info``: what a path holds."""

from __future__ import annotations

from pathlib import Path

import click

from fleetlog.cli.options import existing, json_option, say
from fleetlog.errors import EXIT_DAMAGED, EXIT_DONE


@click.command("info")
@click.argument("path", type=existing)
@json_option
def command(path: Path, as_json: bool) -> int:
    """Describe PATH: a dataset, log, map, site, truck or recording."""
    from fleetlog.cli.describe import describe

    summary, lines = describe(path)
    say(lines, summary, as_json=as_json)
    return EXIT_DAMAGED if summary.get("damage") or summary.get("rejected") else EXIT_DONE
