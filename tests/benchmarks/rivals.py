"""Other ways to say what a model leaves out, on the same recordings, trips and error.

    python tests/benchmarks/rivals.py [FOLDER ...]      folders with recorded.csv.gz, site.toml, truck.toml and key.json

Rivals get the residual power of the nominal model by ten-second window and, as means over the window: speed, acceleration,
payload, curvature, heading as cosine and sine, temperature, position, lift speed.  A constant factor scales the nominal model;
polynomial sparse regression (pysindy: all products up to degree 3, thresholded least squares, threshold chosen on a quarter of
the training trips) and symbolic regression (gplearn: population 500, 15 generations) fit the residual.  What is held out is the
same fifth of the trips that ``fleetlog diagnose`` keeps back; the error is the rms error of energy by window over rms energy.
``pip install pysindy gplearn``.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.truck import load_truck
from fleetlog.discovery.diagnose import diagnose
from fleetlog.discovery.recording.splits import HELD_OUT
from fleetlog.discovery.search.problem import Problem
from fleetlog.store import Dataset

NAMES = ["v", "a", "load", "curv", "east", "north", "temp", "x", "y", "lift"]


@dataclass(frozen=True)
class Table:
    """What rivals get, by window: (W, 10) scaled means of the variables, modelled and recorded mean power [W], seconds, trip, fold."""

    variables: np.ndarray
    model: np.ndarray
    recorded: np.ndarray
    seconds: np.ndarray
    trip: np.ndarray
    fold: np.ndarray


def table(problem: Problem) -> Table:
    """All whole windows of an energy channel."""
    channel = problem.channel
    parts = []
    for unit in channel.units():
        c, use = unit.own, unit.whole
        m = c.motion
        total = np.maximum(c.energy(np.ones(len(m))), 1e-9)
        variables = (m.speed, m.acceleration, m.payload / 1e3, np.abs(m.curvature) * 10.0, np.cos(m.heading), np.sin(m.heading),
                     np.nan_to_num(m.ambient_temperature) / 10.0, m.x / 100.0, m.y / 100.0, np.maximum(m.lift_speed, 0.0))  # fmt: skip
        seconds = np.maximum(unit.windows.duration, 1e-6)
        columns = (
            np.stack([c.energy(v) / total for v in variables], axis=1),
            1e3 * channel.predict(unit, channel.base) / seconds, 1e3 * unit.recorded / seconds, seconds, unit.windows.trip,
            problem.split.fold(unit.windows),
        )  # fmt: skip
        parts.append([column[use] for column in columns])
    return Table(*(np.concatenate(p) for p in zip(*parts, strict=True)))


def sindy(x: np.ndarray, y: np.ndarray, trips: np.ndarray) -> tuple[Any, str]:
    """A sparse polynomial of the residual, and its largest terms in words."""
    import pysindy

    library = pysindy.PolynomialLibrary(degree=3)
    library.fit(x)
    features = np.asarray(library.transform(x))
    names = library.get_feature_names(NAMES)
    inner = np.isin(
        trips, np.random.default_rng(1).permutation(np.unique(trips))[: len(np.unique(trips)) // 4]
    )
    size = np.maximum(features.std(axis=0), 1e-9)
    size[0] = 1.0
    best: tuple[float, Any] = (np.inf, None)
    for threshold in (10.0, 30.0, 100.0, 200.0, 400.0, 1e9):
        optimizer = pysindy.STLSQ(threshold=threshold, alpha=1e-3)
        optimizer.fit(features[~inner] / size, y[~inner][:, None])
        missed = float(np.mean((y[inner] - np.asarray(optimizer.coef_)[0] @ (features[inner] / size).T) ** 2))
        best = min(best, (missed, threshold), key=lambda b: b[0])
    optimizer = pysindy.STLSQ(threshold=best[1], alpha=1e-3)
    optimizer.fit(features / size, y[:, None])
    coefficient = np.asarray(optimizer.coef_)[0] / size
    order = np.argsort(-np.abs(coefficient * size))
    kept = [names[i] for i in order if coefficient[i] != 0.0]
    said = f"{len(kept)} terms" + (f": {', '.join(kept[:3])}" if kept else "")
    return (lambda z: np.asarray(library.transform(z)) @ coefficient), said


def symbolic(x: np.ndarray, y: np.ndarray, trips: np.ndarray) -> tuple[Any, str]:
    """A formula of the residual."""
    from gplearn.genetic import SymbolicRegressor

    size = float(y.std())
    search = SymbolicRegressor(
        population_size=500, generations=15, function_set=("add", "sub", "mul", "div", "abs", "max", "min"), metric="mse",
        parsimony_coefficient=1e-3, feature_names=NAMES, random_state=0,
    )  # fmt: skip
    search.fit(x, y / size)
    text = str(search._program)
    return (lambda z: size * search.predict(z)), text if len(text) < 60 else text[:57] + "..."


def compare(folder: Path) -> None:
    """The rows of one recording."""
    truth = json.loads((folder / "key.json").read_text())
    said = ", ".join(truth["terms"]) if "terms" in truth else truth["term"]
    with tempfile.TemporaryDirectory() as scratch:
        data = Path(scratch) / "data"
        tool = [
            sys.executable,
            "-m",
            "fleetlog",
            "import",
            str(folder / "recorded.csv.gz"),
            "--site",
            str(folder / "site.toml"),
        ]
        subprocess.run([*tool, "-o", str(data), "-q"], check=True)
        begin = time.process_time()
        d = diagnose(Dataset(data), load_truck(str(folder / "truck.toml")))
        spent = time.process_time() - begin
    e = d.channels["battery_power"]
    w = table(e.problem)
    test, x, model, recorded, seconds, trips = (
        w.fold == HELD_OUT,
        w.variables,
        w.model,
        w.recorded,
        w.seconds,
        w.trip,
    )
    train = ~test

    def error(power: np.ndarray) -> float:
        return float(
            np.sqrt(
                np.mean(((recorded - power) * seconds)[test] ** 2) / np.mean((recorded * seconds)[test] ** 2)
            )
        )

    def row(method: str, value: float, named: str, cpu: float) -> None:
        print(
            f"| {folder.name} ({said or 'none'}) | {method} | {value:.3f} | {named} | {cpu:.1f} |", flush=True
        )

    row("nominal model", error(model), "", 0.0)
    factor = float(model[train] @ recorded[train] / (model[train] @ model[train]))
    row("constant factor", error(factor * model), f"x {factor:.3f}", 0.0)
    for method, rival in (("sparse polynomial", sindy), ("symbolic regression", symbolic)):
        begin = time.process_time()
        predict, named = rival(x[train], (recorded - model)[train], trips[train])
        row(method, error(model + predict(x)), f"`{named}`", time.process_time() - begin)
    named = ", ".join(f.term for f in d.verdict.findings) or "none"
    row("fleetlog diagnose", e.fit.after, named, spent)


def main() -> None:
    """All folders given, else the six shared ones."""
    warnings.filterwarnings("ignore")
    shared = Path(__file__).parents[3] / "shared" / "data" / "blind"
    print(
        "| recording (concealed) | method | held-out error | says | CPU s |\n| --- | --- | --- | --- | --- |"
    )
    for folder in [Path(a) for a in sys.argv[1:]] or sorted(shared.iterdir()):
        compare(folder)


if __name__ == "__main__":
    main()
