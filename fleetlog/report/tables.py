"""The tables behind a report: a folder of Parquet files, or one workbook."""

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pandas as pd

from fleetlog.errors import InputError
from fleetlog.store.output import atomic_output

TEXT_ONLY = {"strings_to_formulas": False, "strings_to_urls": False, "strings_to_numbers": False}
"""A text that begins with = is a text."""
MOST_ROWS = 1_000_000
"""A sheet holds no more."""


def check_workbook() -> None:
    """Raise :class:`InputError` where workbooks cannot be written."""
    try:
        import xlsxwriter  # noqa: F401
    except ImportError:
        do = "install fleetlog[excel], or name a folder for Parquet files"
        raise InputError("writing .xlsx needs another package", do=do) from None


@contextmanager
def held(
    target: Path | None, overwrite: bool, inputs: Iterable[Path]
) -> Iterator[Callable[[dict[str, pd.DataFrame], str], None]]:
    """Hold the place of the tables, if any; the function that is given writes them, times in a zone."""
    if target is None:
        yield lambda tables, zone: None
        return
    book = target.suffix.lower() == ".xlsx"
    if book:
        check_workbook()
    with atomic_output(target, "report tables", overwrite=overwrite, folder=not book, inputs=inputs) as out:
        yield lambda tables, zone: write_workbook(tables, out, zone) if book else write_parquet(tables, out)


def write_parquet(tables: dict[str, pd.DataFrame], folder: Path) -> None:
    """``NAME.parquet`` for every table."""
    for name, table in tables.items():
        table.to_parquet(folder / f"{name}.parquet", index=False)


def write_workbook(tables: dict[str, pd.DataFrame], path: Path, zone: str) -> None:
    """One sheet a table; times are those of the zone, as a sheet knows none."""
    with pd.ExcelWriter(path, engine="xlsxwriter", engine_kwargs={"options": TEXT_ONLY}) as book:
        for name, table in tables.items():
            sheet, local = re.sub(r"[\[\]:*?/\\]", "_", name)[:31], _local(table.head(MOST_ROWS), zone)
            local.to_excel(book, sheet_name=sheet, index=False, freeze_panes=(1, 0))
            book.sheets[sheet].autofit()


def _local(table: pd.DataFrame, zone: str) -> pd.DataFrame:
    times = table.select_dtypes("datetimetz").columns
    return table.assign(**{c: table[c].dt.tz_convert(zone).dt.tz_localize(None) for c in times})
