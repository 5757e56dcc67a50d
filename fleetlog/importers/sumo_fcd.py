"""SUMO's floating car data (``--fcd-output``), XML: every vehicle at every step.

``angle`` is clockwise from north [degrees]; ``x, y`` are metres of the network, or degrees where SUMO was run
with ``--fcd-output.geo``. ``time`` counts seconds from the start of the simulation, so it is placed at the
epoch that the file names (fleetlog's exporter writes it) or at 1970."""

import re
from contextlib import suppress
from pathlib import Path
from typing import Any

from fleetlog.importers._open import HEAD, head_of
from fleetlog.importers._rows import Elements, finite, heading_of_course
from fleetlog.importers._units import iso_time
from fleetlog.importers.base import GEOGRAPHIC, LOCAL, Importer, ReadOptions, holding

_EPOCH, _KNOWN = re.compile(rb"fleetlog-epoch ([0-9T:.Z+-]{10,40})"), ("id", "x", "y", "angle")


class _Fcd(Elements):
    """One row a vehicle and step."""

    places = (LOCAL, GEOGRAPHIC)
    wanted, passed = ("vehicle",), ("person", "timestep")

    def __init__(self, path: Path, options: ReadOptions) -> None:
        super().__init__(path, options)
        if not self.origin and (epoch := _EPOCH.search(head_of(path, 4096))):
            with suppress(ValueError):
                self.origin = iso_time(epoch[1].decode())
        self._geographic: bool | None = None

    def take(self, vehicle: Any, number: int) -> None:
        attributes, step = vehicle.attrib, vehicle.getparent()
        if self._geographic is None:
            # the first vehicle tells: SUMO writes degrees with six decimals
            x, y = finite(attributes.get("x")), finite(attributes.get("y"))
            decimals = min(len((attributes.get(k) or "").partition(".")[2]) for k in ("x", "y"))
            self._geographic = decimals >= 5 and abs(x) <= 180.0 and abs(y) <= 90.0
        seconds = finite(step.get("time") if step is not None else None)
        rows, names = (self.tables[1], GEOGRAPHIC[::-1]) if self._geographic else (self.rows, LOCAL)
        if not abs(seconds) < 1e12:
            rows.reject(number, "step without a time", dict(attributes))
            return
        values: dict[str, Any] = {n: finite(attributes.get(k)) for n, k in zip(names, "xy", strict=True)}
        for name in (n for n in attributes if n not in _KNOWN):
            figure, text = finite(attributes[name]), attributes[name] or None
            values[name] = figure if figure == figure or name in ("z", "speed") else text
        if "angle" in attributes:
            values["heading"] = heading_of_course(finite(attributes["angle"]))
        time = self.origin + round(seconds * 1e6)
        rows.add(attributes.get("id") or "vehicle", time, number, values, attributes)


IMPORTER = Importer("sumo-fcd", (".xml",), holding(b"<fcd-export", first=HEAD), _Fcd.batches)
