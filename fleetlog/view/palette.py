"""Colours, the same in recordings and pictures: of things, and of values within limits."""

import colorsys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats
from fleetlog.core.result import EdgeValues, Grid

if TYPE_CHECKING:
    from matplotlib.colors import Colormap, Normalize

Colour = tuple[int, int, int]

_TABLE = tomllib.loads(Path(__file__).with_name("colours.toml").read_text(encoding="utf-8"))
_VEHICLES: list[Colour] = [(r, g, b) for r, g, b in _TABLE.pop("vehicles")]
_PARTS = ({name: (*colour,) for name, colour in part.items()} for part in _TABLE.values())
PLACES, ACTIVITIES, NAMED, MARKS, RINGS, _SITE, _FLEET, STAGES = _PARTS
ROAD, ROAD_EDGE, ARROW, ONE_WAY, BUILDING, COVERED, LIMITED = _SITE.values()
CHARGING, RESERVED, WAITING, CRITICAL, CALM, RECORDED, SIMULATED, *_SOC = _FLEET.values()

# Colour-blind safe; low is pale on paper, dark on the viewer's ground; zero between signs is grey or white.
PAPER, SCREEN, DIVERGING = "magma_r", "inferno", "RdBu_r"
SIGNS = ((120, 200, 255), (50, 120, 220), (104, 107, 113), (225, 90, 50), (255, 180, 120))
"""Below zero, zero and above on the dark ground: bright is far from zero."""
SKEWED = 8.0  # Where the largest values are this many times the median, colours follow their logarithm


def vehicle_colour(number: int) -> Colour:
    """Colour of the ``number``-th vehicle: seven well separated ones, then hues that never repeat exactly."""
    if number < len(_VEHICLES):
        return _VEHICLES[number]
    r, g, b = colorsys.hls_to_rgb(number * 0.618034 % 1.0, 0.55 + 0.12 * (number % 3 - 1), 0.7)
    return int(255 * r), int(255 * g), int(255 * b)


def paper_colour(name: str, number: int) -> tuple[float, float, float]:
    """Of a curve or part on white paper, from 0 to 1: of its name, or darker of the ``number``-th vehicle."""
    r, g, b = NAMED.get(name) or (0.82 * c for c in vehicle_colour(number))
    return r / 255, g / 255, b / 255


def shade(colour: Colour, number: int) -> Colour:
    """One of seven shades of a colour, from darker to lighter."""
    factor = 0.7 + 0.07 * (number * 3 % 7)
    r, g, b = (min(255, int(c * factor)) for c in colour)
    return r, g, b


def soc_colours(soc: NDArray[Any]) -> NDArray[np.uint8]:
    """(N, 3) of states of charge (share): to 20 % red, to 50 % yellow, above green; grey where unknown."""
    colours = np.array([*_SOC, (150, 150, 150)], np.uint8)
    return np.asarray(colours[np.digitize(soc, [0.2, 0.5, np.inf], right=True)])


def faded(colour: Colour, share: float, ground: Colour = (18, 20, 24)) -> Colour:
    """A colour mixed with the ground: all of it where ``share`` is 1."""
    r, g, b = (int(share * c + (1.0 - share) * d) for c, d in zip(colour, ground, strict=True))
    return r, g, b


@dataclass(frozen=True)
class Scale:
    """Limits of a colour map; ``clipped``: values above ``high`` exist.  Values beyond the ``knee`` are
    spread by their logarithm, as a few are many times the others; inf: none."""

    low: float
    high: float
    diverging: bool = False
    clipped: bool = False
    knee: float = float("inf")

    def norm(self) -> "Normalize":
        """From values to shares from 0 to 1, and back by its ``inverse``."""
        from matplotlib.colors import AsinhNorm, Normalize

        if np.isfinite(self.knee):
            return AsinhNorm(self.knee, self.low, self.high, clip=True)
        return Normalize(self.low, self.high, clip=True)

    def at(self, share: Floats) -> Floats:
        """The values at shares from 0 to 1."""
        return np.asarray(self.norm().inverse(share), dtype=np.float64)

    def ticks(self) -> list[float] | None:
        """Round values evenly along a colour bar; None where matplotlib finds them itself."""
        if not np.isfinite(self.knee):
            return None
        return sorted({float(f"{v:.1g}") for v in self.at(np.linspace(0.0, 1.0, 6 - self.diverging))})


def scale_of(values: Floats, diverging: bool = False) -> Scale:
    """Limits from (or about) 0 to the greatest value, or the 98th (99th) percentile if few exceed it."""
    known = np.asarray(values, dtype=np.float64)
    if not len(known := known[np.isfinite(known)]):
        return Scale(-1.0 if diverging else 0.0, 1.0, diverging)
    if diverging:
        known = np.abs(known)
    used, top = known[known != 0.0], float(known.max())
    usual = float(np.quantile(used, 0.99 if diverging else 0.98)) if len(used) else 0.0
    high = usual if 0.0 < usual < 0.67 * top else top
    low = 0.0 if diverging else min(0.0, float(known.min()))
    if high - low < 1e-300:
        high = low + 1.0
    low = -high if diverging else low
    middle = float(np.median(used)) if len(used) else high
    skewed = high > 0.0 and low in (0.0, -high) and high > SKEWED * middle
    return Scale(low, high, diverging, top > high, max(middle, 1e-6 * high) if skewed else float("inf"))


def scales_of(shapes: Sequence[object]) -> dict[str, Scale]:
    """Scale of every map, by name; maps of one kind and label share theirs, so that they compare."""
    maps = [s for s in shapes if isinstance(s, Grid | EdgeValues)]
    groups: dict[tuple[type, str, bool], list[Floats]] = {}
    for s in maps:
        groups.setdefault((type(s), s.label, s.diverging), []).append(np.ravel(s.values))
    common = {key: scale_of(np.concatenate(values), key[2]) for key, values in groups.items()}
    return {s.name: common[type(s), s.label, s.diverging] for s in maps}


def colour_map(diverging: bool, screen: bool) -> "Colormap":
    """The colour map of a kind of value on a kind of ground."""
    import matplotlib
    from matplotlib.colors import LinearSegmentedColormap, ListedColormap

    if diverging and screen:
        return LinearSegmentedColormap.from_list("screen", np.array(SIGNS) / 255.0)
    whole = matplotlib.colormaps[DIVERGING if diverging else SCREEN if screen else PAPER]
    # The last tenth nearest to the ground is left out, so that the lowest values still show.
    return whole if diverging else ListedColormap(whole(np.linspace(0.28 if screen else 0.08, 1.0, 256)))


def screen_colours(values: Floats, scale: Scale) -> NDArray[Any]:
    """(..., 4) uint8 colours for the viewer; wholly transparent where the value is NaN."""
    rgba = np.array(colour_map(scale.diverging, True)(scale.norm()(np.nan_to_num(values)), bytes=True))
    rgba[~np.isfinite(values), 3] = 0
    return rgba
