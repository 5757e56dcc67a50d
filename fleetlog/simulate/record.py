"""From steps to rows of the dataset, in bounded memory."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.trajectory import Labels, Trajectory, Values
from fleetlog.simulate.energy import Batch, Energy
from fleetlog.simulate.state import Log
from fleetlog.store.writer import DatasetWriter

Floats = NDArray[np.float64]
ROWS = 4_000_000
"""Rows that are kept before they are written; 80 bytes each."""
DIGITS = {
    "x": 3, "y": 3, "z": 3, "heading": 4, "speed": 4, "edge_offset": 3, "lateral_offset": 3, "payload": 1,
    "fork_height": 3, "battery_power": 2, "battery_voltage": 3, "battery_current": 3, "soc": 8,
}  # fmt: skip
"""Decimals that are written: millimetres and the like, so that files are small."""


class Recorder:
    """Takes batches of steps, keeps every ``every``-th one as a row, and writes rows when enough have come together.

    Power of a row is the mean over the ``every`` steps around it, so that power times the time between rows adds up to
    the energy.
    """

    def __init__(
        self,
        writer: DatasetWriter,
        names: list[str],
        edges: tuple[str, ...],
        start: int,
        dt: float,
        every: int,
        step: int,
        hilly: bool,
    ) -> None:
        self.writer, self.names, self.edges, self.start, self.hilly = writer, names, edges, start, hilly
        self.dt, self.every, self.batch = dt, every, step
        self.capacity = max(ROWS // max(len(names), 1), step // every)
        self._time: list[NDArray[np.int64]] = []
        self._parts: list[dict[str, NDArray[Any]]] = []
        self._n = 0
        self.written = 0

    def add(self, log: Log, place: Batch, energy: Energy, step0: int) -> None:
        """One batch."""
        pick = slice(self.every // 2, None, self.every)
        k = log.piece.shape[1] // self.every

        def mean(values: Floats) -> Floats:
            if self.every == 1:
                return values
            return np.asarray(values.reshape(len(self.names), k, self.every).mean(axis=2))

        columns = {
            "x": place.x[:, pick], "y": place.y[:, pick], "heading": place.heading[:, pick], "speed": log.v[:, pick],
            "edge_offset": place.offset[:, pick], "lateral_offset": place.lateral[:, pick], "payload": log.load[:, pick],
            "fork_height": log.height[:, pick], "battery_power": mean(energy.power), "soc": energy.soc[:, pick],
        }  # fmt: skip
        if self.hilly:
            columns["z"] = place.z[:, pick]
        if energy.voltage is not None and energy.current is not None:
            columns["battery_voltage"], columns["battery_current"] = (
                mean(energy.voltage),
                mean(energy.current),
            )
        if self._n + k > self.capacity:
            self.flush()
        # Rounding copies, so nothing of the batch itself is kept.
        part: dict[str, NDArray[Any]] = {c: np.round(values, DIGITS[c]) for c, values in columns.items()}
        part["edge_id"], part["trip_id"] = place.edge[:, pick].copy(), log.trip[:, pick].astype(np.int64)
        self._parts.append(part)
        steps = step0 + np.arange(self.every // 2, log.piece.shape[1], self.every)
        self._time.append(self.start + steps * round(self.dt * 1e6))
        self._n += k

    def flush(self) -> None:
        """Write what is kept, truck by truck."""
        if not self._n:
            return
        time = np.concatenate(self._time)
        names = [c for c in self._parts[0] if c != "edge_id"]
        for v, name in enumerate(self.names):
            columns: dict[str, Values] = {c: np.concatenate([p[c][v] for p in self._parts]) for c in names}
            columns["edge_id"] = self._labels(np.concatenate([p["edge_id"][v] for p in self._parts]))
            self.writer.write(Trajectory(name, time, columns))
        self.written += self._n * len(self.names)
        self._n, self._time, self._parts = 0, [], []

    def _labels(self, edge: NDArray[np.int32]) -> Labels:
        """Only the names that occur: a part's dictionary stays small."""
        count = np.bincount(edge, minlength=len(self.edges))
        used = np.flatnonzero(count)
        codes = np.cumsum(count > 0, dtype=np.int32) - 1
        return Labels(codes[edge], tuple(self.edges[i] for i in used))
