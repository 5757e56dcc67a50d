"""ASAM MDF 4 measurements (``.mf4``), read by asammdf (the extra ``mf4``).

Channels are recognised by name and unit as the columns of a CSV are.  Channels of one group share their
times: a group that holds a position gives rows, any other one values at times of its own."""

import gc
import logging
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.trajectory import Values
from fleetlog.errors import FormatError
from fleetlog.importers._open import refuse_packed
from fleetlog.importers._profile import Fields, Source, fields_of
from fleetlog.importers._rows import BATCH
from fleetlog.importers._units import from_counts, microseconds
from fleetlog.importers.base import GEOGRAPHIC, LOCAL, Importer, RawBatch, ReadOptions, holding
from fleetlog.registry import extra


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """The rows of every group that holds something known, group by group."""
    refuse_packed(path)
    with _opened(path) as measurement:
        origin = options.origin or microseconds(measurement.header.start_time)
        groups = [_Group(measurement, number, options, origin) for number in range(len(measurement.groups))]
        if not any(g.placed for g in groups):
            do = "map its channels to latitude, longitude or x, y with --profile"
            names = ", ".join([name for group in groups for name in group.names][:20])
            holds = f"channels: {names}" if names else "it has no channel"
            raise FormatError(f"no group of channels holds a position ({holds})", where=path, do=do)
        done = 0
        for group in groups:
            for batch in group.batches(done):
                done = int(batch.record[-1])
                yield batch


def _opened(path: Path) -> Any:
    asammdf = extra("asammdf", "mf4", "reading MF4 needs asammdf", path, FormatError)
    # Damage is told in one line.  The library would log it too, and what it could not open it cannot close.
    logging.getLogger("asammdf").setLevel(logging.CRITICAL + 1)
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        return asammdf.MDF(path)
    except Exception as error:  # of several kinds, on damaged files
        what = f"cannot be read as MF4 ({type(error).__name__})"
    finally:
        gc.collect()
        sys.unraisablehook = hook
    raise FormatError(what, where=path, do="record it again, or repair it with asammdf")


class _Group:
    """The channels of one group, by name; what each is taken for."""

    def __init__(self, measurement: Any, number: int, options: ReadOptions, origin: int) -> None:
        self.measurement, self.report, self.origin = measurement, options.report, origin
        group, master = measurement.groups[number], measurement.masters_db.get(number)
        self.length = int(group.channel_group.cycles_nr) if master is not None else 0
        self.names: dict[str, tuple[None, int, int]] = {}
        for index, channel in enumerate(group.channels):
            if index != master:
                unit = (channel.unit or "").strip()
                self.names[f"{channel.name} [{unit}]" if unit else channel.name] = (None, number, index)
        self.fields: Fields = fields_of(self.names, options.profile, options.report)
        known = self.fields.columns
        self.placed = any(set(pair) <= known.keys() for pair in (GEOGRAPHIC, LOCAL))
        self.wanted = known | {name: Source(name) for name in (self.fields.kept if self.placed else [])}
        self.vehicle = options.name

    def batches(self, done: int) -> Iterator[RawBatch]:
        """The rows, numbered on from ``done``; none of a group in which nothing is known."""
        for first in range(0, self.length if self.fields.columns else 0, BATCH):
            try:
                yield self._batch(first, done + first)
            except Exception as error:
                what = f"a group of {self.length:,} rows breaks off after row {first:,}"
                self.report.damaged(f"{what} ({type(error).__name__})")
                return

    def _batch(self, first: int, done: int) -> RawBatch:
        named, size = [self.names[s.column] for s in self.wanted.values()], min(BATCH, self.length - first)
        signals = self.measurement.select(named, record_offset=first, record_count=size, copy_master=False)
        time = from_counts(np.asarray(signals[0].timestamps, np.float64), "s", self.origin)
        columns: dict[str, Values] = {}
        for (name, source), signal in zip(self.wanted.items(), signals, strict=True):
            if signal.samples.dtype.kind in "iufb" and signal.samples.ndim == 1:
                columns[name] = source.to_si(source.known(signal.samples.astype(np.float64)))
        record = np.arange(done + 1, done + 1 + len(time))
        return RawBatch.of(self.vehicle, time, columns, record, progress=(first + len(time)) / self.length)


IMPORTER = Importer("mf4", (".mf4", ".mdf"), holding(b"MDF     ", b"UnFinMF ", first=8), read)
