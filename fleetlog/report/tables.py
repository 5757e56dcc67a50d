"""The tables behind a report: a folder of Parquet files, or one workbook."""

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pandas as pd

from fleetlog.errors import InputError
from fleetlog.store.output import atomic_output

TEXT_ONLY = {"strings_to_formulas": False, "strings_to_urls": False, "strings_to_numbers": False}
"""A text that begins with = is a text."""
MOST_ROWS = 1_000_000  # A sheet holds no more


@contextmanager
def held(
    target: Path | None, overwrite: bool, inputs: Iterable[Path]
) -> Iterator[Callable[[dict[str, pd.DataFrame], str], None]]:
    """Hold the place of the tables, if any; the function that is given writes them, times in a zone."""
    if target is None:
        yield lambda tables, zone: None
        return
    book = target.suffix.lower() == ".xlsx"
    if book and find_spec("xlsxwriter") is None:
        do = "install fleetlog[excel], or name a folder for Parquet files"
        raise InputError("writing .xlsx needs another package", do=do)
    with atomic_output(target, "report tables", overwrite=overwrite, folder=not book, inputs=inputs) as out:
        yield partial(_write_workbook if book else _write_parquet, out)


def _write_parquet(folder: Path, tables: dict[str, pd.DataFrame], zone: str) -> None:
    for name, table in tables.items():
        table.to_parquet(folder / f"{name}.parquet", index=False)


def _write_workbook(path: Path, tables: dict[str, pd.DataFrame], zone: str) -> None:
    """One sheet a table; times are those of the zone, as a sheet knows none."""
    with pd.ExcelWriter(path, engine="xlsxwriter", engine_kwargs={"options": TEXT_ONLY}) as book:
        for name, table in tables.items():
            sheet, rows = re.sub(r"[\[\]:*?/\\]", "_", name)[:31], table.head(MOST_ROWS)
            times = rows.select_dtypes("datetimetz").columns
            local = rows.assign(**{c: rows[c].dt.tz_convert(zone).dt.tz_localize(None) for c in times})
            local.to_excel(book, sheet_name=sheet, index=False, freeze_panes=(1, 0))
            book.sheets[sheet].autofit()
