"""From values to colours, with the same limits in recordings and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.result import EdgeValues, Grid
from fleetlog.core.trajectory import Floats

if TYPE_CHECKING:
    from matplotlib.colors import Colormap, Normalize

# Colour-blind safe; pale is low on paper, dark is low on the viewer's dark ground, and grey or white is zero
# between two signs.
PAPER, SCREEN, DIVERGING = "magma_r", "inferno", "RdBu_r"
SIGNS = ((120, 200, 255), (50, 120, 220), (104, 107, 113), (225, 90, 50), (255, 180, 120))
"""Below zero, zero and above on the dark ground: bright is far from zero."""
SKEWED = 8.0  # Where the largest values are this many times the median, colours follow their logarithm


@dataclass(frozen=True)
class Scale:
    """Limits of a colour map.  ``clipped``: values above ``high`` exist.

    Values beyond the ``knee`` are spread by their logarithm, as a few are many times the others; inf: none.
    """

    low: float
    high: float
    diverging: bool = False
    clipped: bool = False
    knee: float = float("inf")

    def norm(self) -> Normalize:
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
    known = known[np.isfinite(known)]
    if not len(known):
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
    knee = max(middle, 1e-6 * high) if skewed else float("inf")
    return Scale(low, high, diverging, top > high, knee)


def scales_of(shapes: Sequence[object]) -> dict[str, Scale]:
    """Scale of every map, by name; maps of one kind and label share theirs, so that they compare."""
    maps = [s for s in shapes if isinstance(s, Grid | EdgeValues)]
    groups: dict[tuple[type, str, bool], list[Floats]] = {}
    for s in maps:
        groups.setdefault((type(s), s.label, s.diverging), []).append(np.ravel(s.values))
    common = {key: scale_of(np.concatenate(values), key[2]) for key, values in groups.items()}
    return {s.name: common[type(s), s.label, s.diverging] for s in maps}


def colour_map(diverging: bool, screen: bool) -> Colormap:
    """The colour map of a kind of value on a kind of ground."""
    import matplotlib
    from matplotlib.colors import LinearSegmentedColormap, ListedColormap

    if diverging and screen:
        return LinearSegmentedColormap.from_list("screen", np.array(SIGNS) / 255.0)
    whole = matplotlib.colormaps[DIVERGING if diverging else SCREEN if screen else PAPER]
    if diverging:
        return whole
    # The last tenth nearest to the ground is left out, so that the lowest values still show.
    return ListedColormap(whole(np.linspace(0.28 if screen else 0.08, 1.0, 256)))


def screen_colours(values: Floats, scale: Scale) -> NDArray[Any]:
    """(..., 4) uint8 colours for the viewer; wholly transparent where the value is NaN."""
    shares = scale.norm()(np.nan_to_num(values))
    rgba = np.array(colour_map(scale.diverging, True)(shares, bytes=True))
    rgba[~np.isfinite(values), 3] = 0
    return rgba
