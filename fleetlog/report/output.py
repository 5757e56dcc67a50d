"""Where a report goes: the page and its tables, both or neither."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from fleetlog.report.report import Report
from fleetlog.report.tables import check_workbook, is_workbook, write_parquet, write_workbook
from fleetlog.store.output import atomic_output


@contextmanager
def written(
    page: Path, tables: Path | None, *, overwrite: bool, inputs: Iterable[Path] = ()
) -> Iterator[Callable[[Report], None]]:
    """Hold the places of a page and its tables, which appear when the block ends well; gives what writes them."""
    inputs = list(inputs)
    with ExitStack() as held:
        out = held.enter_context(
            atomic_output(page, "report", overwrite=overwrite, folder=False, inputs=inputs)
        )
        beside: Path | None = None
        if tables is not None:
            book = is_workbook(tables)
            if book:
                check_workbook()
            kind = "report tables"
            beside = held.enter_context(
                atomic_output(tables, kind, overwrite=overwrite, folder=not book, inputs=inputs)
            )

        def write(report: Report) -> None:
            out.write_text(report.html, encoding="utf-8")
            if beside is not None and tables is not None and is_workbook(tables):
                write_workbook(report.tables, beside, report.zone)
            elif beside is not None:
                write_parquet(report.tables, beside)

        yield write
