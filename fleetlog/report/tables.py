"""The tables behind a report: a folder of Parquet files, or one workbook."""

from __future__ import annotations

import re
from pathlib import Path

import pandas as pd

from fleetlog.errors import InputError

TEXT_ONLY = {"strings_to_formulas": False, "strings_to_urls": False, "strings_to_numbers": False}
"""A text that begins with = is a text."""
MOST_ROWS = 1_000_000
"""A sheet holds no more."""


def is_workbook(path: Path) -> bool:
    """Whether tables are to be written as a workbook."""
    return path.suffix.lower() == ".xlsx"


def check_workbook() -> None:
    """Raise :class:`InputError` where workbooks cannot be written."""
    try:
        import xlsxwriter  # noqa: F401
    except ImportError:
        raise InputError(
            "writing .xlsx needs another package",
            do="install fleetlog[excel], or name a folder for Parquet files",
        ) from None


def write_parquet(tables: dict[str, pd.DataFrame], folder: Path) -> None:
    """``NAME.parquet`` for every table."""
    for name, table in tables.items():
        table.to_parquet(folder / f"{name}.parquet", index=False)


def write_workbook(tables: dict[str, pd.DataFrame], path: Path, zone: str) -> None:
    """One sheet a table; times are those of the zone, as a sheet knows none."""
    with pd.ExcelWriter(path, engine="xlsxwriter", engine_kwargs={"options": TEXT_ONLY}) as book:
        for name, table in tables.items():
            sheet = re.sub(r"[\[\]:*?/\\]", "_", name)[:31]
            _local(table.head(MOST_ROWS), zone).to_excel(
                book, sheet_name=sheet, index=False, freeze_panes=(1, 0)
            )
            book.sheets[sheet].autofit()


def _local(table: pd.DataFrame, zone: str) -> pd.DataFrame:
    times = table.select_dtypes("datetimetz").columns
    return table.assign(**{c: table[c].dt.tz_convert(zone).dt.tz_localize(None) for c in times})
