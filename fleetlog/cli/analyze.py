"""``fleetlog analyze``: one question a command, each in :mod:`fleetlog.cli.analyses`."""

from __future__ import annotations

from typing import ClassVar

import click

from fleetlog.cli.lazy import LazyGroup

LINES = {
    "trips": "Where trucks drive from and to, how far and how long.",
    "stops": "Where and why they stand.",
    "energy": "What every trip costs, by physical cause.",
    "density": "Where trucks crowd, and how critical it is.",
    "heatmap": "How much time trucks spend where.",
    "chargers": "Where chargers belong, and how many plugs.",
}


class Analyses(LazyGroup):
    """The analyses, loaded one by one."""

    verbs: ClassVar[dict[str, tuple[str, str]]] = {
        name: (f"fleetlog.cli.analyses.{name}", line) for name, line in LINES.items()
    }


@click.command(
    cls=Analyses,
    no_args_is_help=True,
    help="Trips, stops, energy, density, heat maps, chargers of a dataset.",
)
def command() -> None:
    """Group of the analyses."""
