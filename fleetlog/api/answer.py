"""The result of a function of the library: numbers, tables, and how to write and show them."""

import base64
import html
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fleetlog import engines, scratch
from fleetlog.api.inputs import PathLike, as_path, files_of
from fleetlog.core.arrays import DataFrame
from fleetlog.core.result import Result
from fleetlog.core.site import Site
from fleetlog.errors import DataError

if TYPE_CHECKING:
    from fleetlog.store import Dataset

HEAD = 5  # Rows of a table in a notebook
PICTURE_COST = 1.0  # Of a picture, about [s]


@dataclass
class Answer(Result):
    """The result of a function of the library.

    Attributes
    ----------
    name : of the question, as ``density``.
    summary : JSON-ready figures; what ``--json`` prints.
    tables : DataFrames by name.
    lines : the answer in a few sentences; what the command prints.
    status : exit status of the command: 0, or 3 where some of the data were damaged or rejected.
    warning : what even a quiet command says.
    output : where it was written, if it was.
    value : the object behind it: a Dataset, a Diagnosis, a fitted truck."""

    site: Site | None = None
    status: int = 0
    output: Path | None = None
    value: Any = None
    kind: str = "analysis"
    folder: bool = True
    write: Callable[[Path], object] | None = None
    page: str = ""
    warning: str = ""
    inputs: tuple[Path, ...] = ()

    @classmethod
    def of(cls, result: Result, site: Site | None = None, **more: Any) -> "Answer":
        """Return the answer of an analysis: its folder has JSON, tables, a picture and a recording."""
        more.setdefault("write", partial(write_folder, result, site or Site(), page=more.get("page", "")))
        return cls(**{f.name: getattr(result, f.name) for f in fields(Result)}, site=site, **more)

    @property
    def dataset(self) -> "Dataset":
        """The dataset that an import or a simulation made."""
        from fleetlog.store import Dataset

        if isinstance(self.value, Dataset):
            return self.value
        raise DataError(f"{self.name} gives no dataset", do="use the result of read_logs or simulate")

    def save(self, output: PathLike, *, overwrite: bool = False) -> Path:
        """Write everything to ``output``, as the command does with ``-o``; whole or not at all."""
        folder = self.folder and self.write is not None
        with destination(output, self.kind, overwrite, self.inputs, folder) as keep:
            keep(self)
        return as_path(output)

    def show(self) -> None:
        """Open the recording in the Rerun viewer, or the page in a browser."""
        if self.page:
            import webbrowser

            file = scratch.folder() / "page.html"
            file.write_text(self.page, encoding="utf-8")
            webbrowser.open(file.as_uri())
            return
        from fleetlog.view import viewer

        written = self.output if self.output is not None and self.output.exists() else None
        if written is None and (not self.folder or self.write is None):
            raise DataError(f"{self.name} has no recording to show", do="print it, or look at its tables")
        viewer.show(viewer.recording_of(written or self.save(scratch.folder() / self.name)))

    def __str__(self) -> str:
        return "\n".join(self.lines)

    def __repr__(self) -> str:
        return f"<Result {self.name}: tables {', '.join(self.tables) or 'none'}>\n{self}"

    def _repr_html_(self) -> str:
        """The answer for a notebook: sentences, the picture, the head of every table."""
        if self.page:
            return f'<iframe srcdoc="{html.escape(self.page)}" width="100%" height="700"></iframe>'
        from fleetlog.report.content import render

        picture = ""
        if self.shapes:
            from fleetlog.view.picture import write_picture

            png = write_picture(self, self.site or Site(), scratch.folder() / "picture.png").read_bytes()
            picture = base64.b64encode(png).decode()
        heads = {name: t.head(HEAD).to_html(max_cols=12, border=0) for name, t in self.tables.items()}
        return render("answer.html", answer=self, heads=heads, picture=picture)


@contextmanager
def destination(
    output: PathLike | None, kind: str, overwrite: bool, read: Iterable[Any], folder: bool = True
) -> Iterator[Callable[[Answer], Answer]]:
    """Check and hold the place of an output; the function that is given writes an answer there, or keeps it
    without ``output`` in memory.  The files among ``read``, arguments, are not written over."""
    from fleetlog.store.documents import write_json
    from fleetlog.store.output import atomic_output

    files = files_of(*read)
    place = None if output is None else as_path(output)

    def keep(answer: Answer) -> Answer:
        if target is not None:
            (answer.write or partial(write_json, value=answer.summary, indent=1))(target)
        answer.output = place
        answer.kind, answer.folder, answer.inputs = kind, folder, tuple(files)
        return answer

    made = partial(atomic_output, kind=kind, overwrite=overwrite, folder=folder, inputs=files)
    with nullcontext() if place is None else made(place) as target:
        yield keep


def write_folder(result: Result, site: Site, folder: Path, page: str = "", recording: bool = True) -> None:
    """Write ``NAME.json``, Parquet tables, GeoJSON places, ``NAME.png``; a page and a recording if any."""
    from fleetlog.store.results import write_result
    from fleetlog.view.picture import write_picture
    from fleetlog.view.results import write_result_recording

    if page:
        (folder / "report.html").write_text(page, encoding="utf-8")
    replay = partial(write_result_recording, result, site, folder / "recording.rrd")
    beside: engines.Tasks = [partial(write_result, result, folder, site.frame), *[replay] * recording]
    picture = partial(write_picture, result, site), [folder / f"{result.name}.png"]
    list(engines.current().here.run(*picture, beside=beside, cost=PICTURE_COST))


def dataset_answer(
    name: str, path: Path, output: Path | None, summary: Mapping[str, Any], lines: list[str], status: int = 0
) -> Answer:
    """Return the answer of a run that has written a dataset to ``path``, be it a temporary one."""
    from fleetlog.store import Dataset

    data = Dataset(path)
    figures = {**summary, **({"dataset": str(output)} if output else {})}
    return Answer(
        name, figures, Tables(path), lines=lines, site=data.site, status=status, output=output, value=data,
        kind=f"{data.kind} dataset", write=lambda folder: shutil.copytree(path, folder, dirs_exist_ok=True),
    )  # fmt: skip


class Tables(dict[str, Any]):
    """The Parquet tables of a folder by name, read when asked for."""

    def __init__(self, folder: Path) -> None:
        super().__init__({p.stem: p for p in sorted(folder.glob("*.parquet"))})

    def __getitem__(self, name: str) -> DataFrame:
        import pandas as pd

        if not isinstance(table := super().__getitem__(name), pd.DataFrame):
            with table.open("rb") as stream:
                self[name] = table = pd.read_parquet(stream)
        return table

    def items(self) -> Any:
        """Names and tables."""
        return [(name, self[name]) for name in self]
