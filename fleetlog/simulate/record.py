"""From steps to rows of the dataset, in bounded memory."""

from __future__ import annotations

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
    ) -> None:
        self.writer, self.names, self.edges, self.start = writer, names, edges, start
        self.dt, self.every, self.batch = dt, every, step
        self.capacity = max(ROWS // max(len(names), 1) // (step // every), 1) * (step // every)
        self._time: list[int] = []
        self._rows: dict[str, NDArray[np.float64]] = {}
        self._edge = np.empty((len(names), self.capacity), np.int32)
        self._trip = np.empty((len(names), self.capacity), np.int32)
        self._n = 0
        self.written = 0

    def add(self, log: Log, place: Batch, energy: Energy, step0: int) -> None:
        """One batch."""
        pick = np.arange(self.every // 2, log.piece.shape[1], self.every)
        k = len(pick)

        def mean(values: Floats) -> Floats:
            if self.every == 1:
                return values
            return np.asarray(values.reshape(len(self.names), k, self.every).mean(axis=2))

        columns = {
            "x": place.x[:, pick], "y": place.y[:, pick], "heading": place.heading[:, pick], "speed": log.v[:, pick],
            "edge_offset": place.offset[:, pick], "lateral_offset": place.lateral[:, pick], "payload": log.load[:, pick],
            "fork_height": log.height[:, pick], "battery_power": mean(energy.power), "soc": energy.soc[:, pick],
        }  # fmt: skip
        if np.any(place.z):
            columns["z"] = place.z[:, pick]
        if energy.voltage is not None and energy.current is not None:
            columns["battery_voltage"], columns["battery_current"] = (
                mean(energy.voltage),
                mean(energy.current),
            )
        if self._n + k > self.capacity:
            self.flush()
        span = slice(self._n, self._n + k)
        for name, values in columns.items():
            if name not in self._rows:
                self._rows[name] = np.zeros((len(self.names), self.capacity))
            self._rows[name][:, span] = values
        self._edge[:, span], self._trip[:, span] = place.edge[:, pick], log.trip[:, pick]
        step = round(self.dt * 1e6)
        self._time += (self.start + (step0 + pick) * step).tolist()
        self._n += k

    def flush(self) -> None:
        """Write what is kept, truck by truck."""
        n = self._n
        if not n:
            return
        time = np.array(self._time, dtype=np.int64)
        for v, name in enumerate(self.names):
            columns: dict[str, Values] = {c: np.round(a[v, :n], DIGITS[c]) for c, a in self._rows.items()}
            columns["edge_id"] = self._labels(self._edge[v, :n])
            columns["trip_id"] = self._trip[v, :n].astype(np.int64)
            self.writer.write(Trajectory(name, time, columns))
        self.written += n * len(self.names)
        self._n, self._time = 0, []

    def _labels(self, edge: NDArray[np.int32]) -> Labels:
        """Only the names that occur: a part's dictionary stays small."""
        used, codes = np.unique(edge, return_inverse=True)
        return Labels(codes.astype(np.int32), tuple(self.edges[i] for i in used))
