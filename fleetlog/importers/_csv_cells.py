"""Cells of a text log to numbers, one by one where a whole column cannot be converted at once."""

import re

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from fleetlog.core.arrays import Floats, Mask

_NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"
_ODD = r"(?i)^[+-]?(nan|inf|infinity)$"
_DEGREES = re.compile(
    r"^\s*(?P<head>[NSEWnsew])?\s*(?P<sign>[+-])?\s*(?P<d>\d{1,3}(?:\.\d+)?)\s*(?:°|d|deg|:|\s)\s*"
    r"(?:(?P<m>\d{1,2}(?:\.\d+)?)\s*(?:'|′|m|min|:|\s|$)\s*)?"
    r"(?:(?P<s>\d{1,2}(?:\.\d+)?)\s*(?:\"|″|''|s|sec)?\s*)?(?P<tail>[NSEWnsew])?\s*$"
)


def numbers(cells: pa.Array, decimal: str = ".") -> tuple[Floats, Mask]:
    """Values of text cells, NaN where empty or ``nan``, and which cells are no numbers (infinity is none)."""
    text = pc.utf8_trim_whitespace(cells)
    if decimal != ".":
        text = pc.replace_substring(text, decimal, ".")
    good = pc.fill_null(pc.match_substring_regex(text, _NUMBER), False)
    kept = pc.if_else(good, pc.replace_substring_regex(text, r"^\+", ""), pa.scalar(None, pa.string()))
    values = np.array(kept.cast(pa.float64()).fill_null(np.nan), dtype=np.float64)
    nan = pc.fill_null(pc.match_substring_regex(text, "(?i)^[+-]?nan$"), False)
    empty = pc.fill_null(pc.equal(text, ""), True)
    bad = ~np.asarray(pc.or_(pc.or_(good, nan), empty))
    return values, bad


def degrees(cells: pa.Array, decimal: str = ".") -> tuple[Floats, Mask]:
    """Degrees of cells as ``49.977``, ``49 58.614 N`` or ``49°58'36.8"N``, and which cells are neither."""
    values, bad = numbers(cells, decimal)
    for row in np.flatnonzero(bad).tolist():
        value = one_angle(str(cells[row].as_py()).replace(decimal, "."))
        if value is not None:
            values[row], bad[row] = value, False
    return values, bad


def one_angle(text: str) -> float | None:
    """One angle in degrees, minutes and seconds, south and west negative; None where it is not one."""
    match = _DEGREES.match(text)
    if match is None or (match["head"] and match["tail"]):
        return None
    minutes, seconds = float(match["m"] or 0.0), float(match["s"] or 0.0)
    if minutes >= 60.0 or seconds >= 60.0:
        return None
    value = float(match["d"]) + minutes / 60.0 + seconds / 3600.0
    letter = (match["head"] or match["tail"] or "N").upper()
    return -value if (letter in "SW") != (match["sign"] == "-") else value
