"""A result with every drawable shape."""

from __future__ import annotations

import numpy as np
import pandas as pd
from fixtures_view import START

from fleetlog.core.result import Bars, EdgeValues, Flows, Grid, Marks, MovingLines, Result, Series


def every_shape() -> Result:
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:48, 0:72]
    heat = np.where(
        (np.abs(y - 4) < 2) | (np.abs(x - 64) < 2),
        20.0 + 3.0 * x * (y < 8) + rng.gamma(2.0, 20.0, x.shape),
        np.nan,
    )
    n = 7
    time = START + np.arange(0, 240, 2, dtype=np.int64) * 1_000_000
    lines = tuple(
        np.array([[[i % 60, 0], [(i % 60) + 8, 0]], [[60, 10], [60, 16]]], float)[: i % 3]
        for i in range(len(time))
    )
    flags = tuple(np.array([i % 2 == 0, True])[: i % 3] for i in range(len(time)))
    walk = np.cumsum(rng.normal(size=(2, len(time))), axis=1)
    places = pd.DataFrame({"x": [20.0, 60.0], "y": [0.0, 20.0], "label": ["A", "B"]})
    return Result(
        "everything",
        {"rows": 3150, "share": float("nan")},
        tables={"numbers": pd.DataFrame({"value": [1.0, 2.0]})},
        places={"sites": places},
        shapes=[
            Grid("heat", heat, -4.0, -4.0, 1.0, "time [s/m2]"),
            EdgeValues(
                "residual", np.arange(n, dtype=np.int32), np.zeros(n), np.full(n, 30.0), np.linspace(-3, 4, n),
                "energy [J/m]", diverging=True,
            ),
            Marks("sites", places[["x", "y"]].to_numpy(), ("A", "B"), np.array([2.0, 3.0]), "charger"),
            Marks("tight", np.array([[60.0, 0.0]]), ("area 1",), np.array([6.0]), "critical"),
            Flows("trips", np.array([[0.0, 0.0], [60.0, 20.0]]), np.array([[60.0, 20.0], [0.0, 0.0]]), np.array([9.0, 2.0]), "trips"),
            MovingLines("clusters", time, lines, flags),
            Series("power", time, {"drive": np.abs(walk[0]), "lift": np.abs(walk[1])}, "time", "kW", over_time=True, stacked=True),
            Series("reliability", np.linspace(0, 1, 20), {"observed": np.linspace(0, 1, 20) ** 1.1}, "stated", "observed"),
            Bars("states", ("a", "b"), np.array([3.0, 4.0]), "h", {"waiting": np.array([1.0, 3.0]), "idle": np.array([2.0, 1.0])}),
            Bars("delay", ("area 1", "area 2", "a place with a rather long name indeed"), np.array([30.0, 12.0, 4.0]), "delay [s]"),
        ],
        lines=["3 trucks waited 46 s in 2 places.", "Most of it at area 1."],
    )  # fmt: skip
