"""What an analysis answers: numbers, tables and a few shapes; ``store`` writes it, ``view`` draws it."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from fleetlog.core.arrays import Array, DataFrame, Floats, Index, Ints, Mask


@dataclass(frozen=True)
class Grid:
    """A raster over the floor: ``values`` from south to north and from west to east, NaN where empty.
    ``x0, y0`` is the south-west corner [m], ``cell`` its size [m]; ``diverging`` colours about zero."""

    name: str
    values: Floats
    x0: float
    y0: float
    cell: float
    label: str
    diverging: bool = False
    mask: Mask | None = None


@dataclass(frozen=True)
class EdgeValues:
    """Values on stretches of directed edges: ``edge`` (N,) indices, ``start``/``end`` (N,) offsets [m]."""

    name: str
    edge: Index
    start: Floats
    end: Floats
    values: Floats
    label: str
    diverging: bool = False


@dataclass(frozen=True)
class Marks:
    """Labelled points on the floor ((N, 2) m): stops, chargers, critical areas. ``size`` (N,) in metres.
    ``name`` says in the legend what each is."""

    name: str
    xy: Floats
    labels: tuple[str, ...]
    size: Floats
    kind: Literal["place", "charger", "critical", "point", "pick", "drop", "park", "charge"] = "point"

    def __post_init__(self) -> None:
        """What has no place is no mark."""
        known = np.asarray(np.isfinite(self.xy).all(axis=1))
        if not known.all():
            labels = tuple(label for label, keep in zip(self.labels, known, strict=True) if keep)
            vars(self).update(xy=self.xy[known], labels=labels, size=self.size[known])


@dataclass(frozen=True)
class Flows:
    """Arrows over the floor, from ``start`` to ``end`` ((N, 2) m), the wider the greater ``weight`` (N,): the
    greatest of ``of`` pairs, where those are more."""

    name: str
    start: Floats
    end: Floats
    weight: Floats
    label: str
    of: int = 0


@dataclass(frozen=True)
class MovingLines:
    """Lines on the floor that change: at ``time[i]`` (int64 us) ``lines[i]`` ((k, 2, 2) m), with flags;
    ``label`` in the legend."""

    name: str
    time: Ints
    lines: tuple[Floats, ...]
    critical: tuple[Mask, ...]
    label: str = ""


@dataclass(frozen=True)
class Series:
    """Curves over time or another axis: ``x`` (N,) (int64 us when ``over_time``), ``y`` by name. The axis of
    ``counts`` has zero in it."""

    name: str
    x: Array
    y: dict[str, Floats]
    x_label: str
    y_label: str
    over_time: bool = False
    stacked: bool = False
    counts: bool = False


@dataclass(frozen=True)
class Bars:
    """Labelled bars; ``parts`` are what each is made up of, by name, in order."""

    name: str
    labels: tuple[str, ...]
    values: Floats
    label: str
    parts: dict[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True)
class Spread:
    """Curves with confidence intervals: of each, the results of some runs at each value of a setting."""

    name: str
    values: tuple[str, ...]
    curves: dict[str, list[Floats]]
    x_label: str
    y_label: str


def half_width(values: Floats) -> float:
    """Half the 95 % confidence interval of the mean of (N,) values (Student's t); NaN for a single value."""
    from scipy.stats import t

    n = len(values)
    return float(t.ppf(0.975, n - 1) * values.std(ddof=1) / np.sqrt(n)) if n > 1 else float("nan")


Shape = Grid | EdgeValues | Marks | Flows | MovingLines | Series | Bars | Spread


@dataclass
class Result:
    """The answer to one question. ``summary`` is JSON-ready; a quantity's key ends in its unit or ``units``
    says it. ``tables`` are written as Parquet, ``places`` (with columns x, y) as GeoJSON too. ``lines`` are
    at most ten sentences. ``squares`` names tables of square cells about x, y, with their size [m]."""

    name: str
    summary: dict[str, Any]
    tables: dict[str, DataFrame] = field(default_factory=dict)
    places: dict[str, DataFrame] = field(default_factory=dict)
    shapes: list[Shape] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)
    squares: dict[str, float] = field(default_factory=dict)
