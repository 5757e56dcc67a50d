"""``fleetlog learn``: roads, places and zones from traces alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fleetlog.cli.options import (
    Between,
    existing,
    json_option,
    output_option,
    overwrite_option,
    quiet_option,
    say,
)

if TYPE_CHECKING:
    from fleetlog.core.site import Site
    from fleetlog.learn.learn import Learned


@click.command("learn")
@click.argument("dataset", type=existing)
@click.option("--site", type=existing, help="An existing site or map: propose what it lacks.")
@click.option(
    "--lane", type=Between(0.5, 20.0), default=2.3, show_default=True,
    help="Opposite directions closer than this are one road [m].",
)  # fmt: skip
@click.option(
    "--spur", type=Between(0.0, 200.0), default=7.0, show_default=True,
    help="Dead ends shorter than this lead into a bay and are no road [m].",
)  # fmt: skip
@click.option("--min-passes", type=click.IntRange(1), default=1, show_default=True,
              help="Leave out roads driven less often.")  # fmt: skip
@click.option("--min-visits", type=click.IntRange(1), default=3, show_default=True,
              help="Leave out places visited less often.")  # fmt: skip
@output_option("Folder of the site.")
@overwrite_option
@json_option
@quiet_option
def command(
    dataset: Path, site: Path | None, lane: float, spur: float, min_passes: int, min_visits: int, output: Path,
    overwrite: bool, as_json: bool, quiet: bool,
) -> None:  # fmt: skip
    """Learn the site of DATASET from its traces alone: roads, places and zones, each with its evidence."""
    from fleetlog.learn.learn import learn
    from fleetlog.learn.roads import Settings
    from fleetlog.learn.write import write_learned
    from fleetlog.store import Dataset
    from fleetlog.store.output import atomic_output

    given = [dataset, *([site] if site else [])]
    with atomic_output(output, "site", overwrite=overwrite, inputs=given) as folder:
        known = _known(site)
        found = learn(
            Dataset(dataset), site=known, settings=Settings(lane, spur, min_passes), min_visits=min_visits
        )
        write_learned(found, folder)
        _draw(found, folder / "learn.png")
    say([*found.result.lines, f"site: {output}"], {**found.result.summary, "site": str(output)},
        as_json=as_json, quiet=quiet)  # fmt: skip


def _known(path: Path | None) -> Site | None:
    if path is None:
        return None
    from fleetlog.roads import load_site

    return load_site(path)[0]


def _draw(found: Learned, path: Path) -> None:
    from fleetlog.view.picture import write_picture

    write_picture(found.result, found.site, path)
