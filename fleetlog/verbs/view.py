"""Open a replay, an analysis, a map or a log in the Rerun viewer."""

import shutil
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Annotated

from fleetlog import scratch
from fleetlog.api.answer import Answer
from fleetlog.api.inputs import DatasetLike, PathLike, as_path, as_site, existing, files_of
from fleetlog.api.verb import verb
from fleetlog.core.arguments import Between, Moment
from fleetlog.errors import ArgumentError, InputError
from fleetlog.listening import notice


@verb()
def view(
    path: DatasetLike, *, beside: DatasetLike | None = None, save: PathLike | None = None,
    screenshot: PathLike | None = None, at: Moment | None = None,
    rate: Annotated[float, Between(0.01, 100.0)] | None = None, day: str | None = None,
    overwrite: bool = False,
) -> Answer:  # fmt: skip
    """Open PATH in the Rerun viewer: a dataset, an analysis, an .rrd file, a map, a site or a log.

    The replay of a dataset is made again where it is missing or older than the dataset, or when --rate is
    given. With --beside, PATH is the recorded fleet (orange) and the other one the simulated (blue).

    Parameters
    ----------
    path : what is to be shown.
    beside : another dataset, drawn on the same timeline with the differences.
    save : keep the recording of --beside in this .rrd file.
    screenshot : draw it without a screen into this PNG file.
    at : time of the screenshot (UTC, ISO 8601); the middle of the recording by default.
    rate : samples per second when the replay is made again.
    day : show this day of a dataset only (UTC, YYYY-MM-DD)."""
    from fleetlog.store.output import atomic_output
    from fleetlog.view import viewer
    from fleetlog.view.comparison import write_comparison
    from fleetlog.view.recording import RATE

    def written(target: PathLike | None, kind: str) -> AbstractContextManager[Path | None]:
        if target is None:
            return nullcontext()
        return atomic_output(as_path(target), kind, overwrite=overwrite, folder=False, inputs=inputs)

    if save is not None and beside is None:
        raise ArgumentError("--save goes with --beside")
    source, inputs = existing(path), files_of(path, beside)
    if day is not None and not (source / "dataset.json").is_file():
        raise ArgumentError(f"goes with a dataset, and {source} is none", where="--day")
    with written(screenshot, "picture") as picture, written(save, "recording") as kept:
        if beside is not None:
            notice("making the comparison")
            # The viewer goes by the ending of the name, which a file in the making has not.
            rrd = scratch.folder() / "comparison.rrd"
            write_comparison(source, existing(beside), rrd, rate_hz=rate or RATE, day=day)
            if kept is not None:
                shutil.copyfile(rrd, kept)
        else:
            drawn = source.is_file() and source.suffix.lower() != ".rrd"
            rrd = _drawn(source) if drawn else viewer.recording_of(source, rate_hz=rate, day=day, say=notice)
        if picture is not None:
            viewer.screenshot(rrd, picture, at=None if at is None else 1000 * int(at))
        elif kept is None:
            viewer.show(rrd)
    wrote = [str(as_path(p)) for p in (screenshot, save) if p is not None]
    return Answer("view", {"path": str(source), "wrote": wrote}, lines=[f"wrote {name}" for name in wrote])


def _drawn(path: Path) -> Path:
    """The recording of a map, a site or a log."""
    from fleetlog.core.result import Result
    from fleetlog.verbs.import_ import import_
    from fleetlog.verbs.info import describe, told
    from fleetlog.view.results import write_result_recording

    summary = describe(path)
    if summary["kind"] == "log":
        return import_(path).dataset.path / "recording.rrd"
    if summary["kind"] not in ("site", "map"):
        what = f"is a {summary['kind']}: nothing to draw"
        raise InputError(what, where=path, do="name a dataset, an analysis, a map, a site or a log")
    site = as_site(path)
    shown = Result(site.name, {}, lines=[line.strip() for line in told(summary)])
    return write_result_recording(shown, site, scratch.folder() / "site.rrd")
