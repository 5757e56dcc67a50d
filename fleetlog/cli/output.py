"""The folder of an analysis: JSON, tables, GeoJSON, one picture, one recording; whole or not at all."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fleetlog.cli.options import answer_options, engine_options, named_files, say

if TYPE_CHECKING:
    from fleetlog.core.result import Result
    from fleetlog.core.site import Site


def answers(command: Callable[..., tuple[Result, Site]]) -> Callable[..., None]:
    """Give an analysis the options ``-o``, ``--overwrite``, ``--json``, ``-q``; write and say what it
    returns.

    Its place is checked and held before the work begins.
    """

    @functools.wraps(command)
    def run(output: Path, overwrite: bool, as_json: bool, quiet: bool, **options: Any) -> None:
        from fleetlog.store.output import atomic_output

        with atomic_output(output, "analysis", overwrite=overwrite, inputs=named_files(options)) as folder:
            result, site = command(**options)
            _write(result, site, folder)
        say(result.lines, result.summary, as_json=as_json, quiet=quiet)

    return answer_options(engine_options(run))


def write_analysis(
    result: Result, site: Site, out: str | Path, overwrite: bool = False, inputs: Iterable[Path] = ()
) -> Path:
    """Write everything that a result gives into the folder ``out``.

    ``NAME.json`` (the summary), tables as Parquet, places as GeoJSON, ``NAME.png`` and ``recording.rrd``.
    An older folder is only replaced with ``overwrite``, and then only when all of this has been written.
    """
    from fleetlog.store.output import atomic_output

    with atomic_output(out, "analysis", overwrite=overwrite, inputs=inputs) as folder:
        _write(result, site, folder)
    return Path(out)


def _write(result: Result, site: Site, folder: Path) -> None:
    from fleetlog.store.results import write_result
    from fleetlog.view.picture import write_picture
    from fleetlog.view.results import write_result_recording

    write_result(result, folder, site.frame)
    write_picture(result, site, folder / f"{result.name}.png")
    write_result_recording(result, site, folder / "recording.rrd")
