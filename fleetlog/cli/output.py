"""The folder of an analysis: JSON, tables, GeoJSON, one picture, one recording; whole or not at all."""

from __future__ import annotations

from pathlib import Path

from fleetlog.cli.options import say
from fleetlog.core.result import Result
from fleetlog.core.site import Site


def answer(result: Result, site: Site, output: Path, overwrite: bool, as_json: bool, quiet: bool) -> None:
    """Write a result and say its lines, or its summary as JSON."""
    write_analysis(result, site, output, overwrite)
    say(result.lines, result.summary, as_json=as_json, quiet=quiet)


def write_analysis(result: Result, site: Site, out: str | Path, overwrite: bool = False) -> Path:
    """Write everything that a result gives into the folder ``out``.

    ``NAME.json`` (the summary), every table as Parquet, places as GeoJSON, ``NAME.png`` and ``recording.rrd``.
    An older folder is only replaced with ``overwrite``, and then only when all of this has been written.
    """
    from fleetlog.store.atomic import atomic_output
    from fleetlog.store.results import write_result
    from fleetlog.view.picture import write_picture
    from fleetlog.view.results import write_result_recording

    with atomic_output(out, overwrite=overwrite) as folder:
        write_result(result, folder, site.frame)
        write_picture(result, site, folder / f"{result.name}.png")
        write_result_recording(result, site, folder / "recording.rrd")
    return Path(out)
