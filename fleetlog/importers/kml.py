"""KML: tracks with times (``gx:Track``), and placemarks of a point with a ``TimeStamp``.

Lines without times say where, not when: they are left out."""

from typing import Any

from fleetlog.core.words import count
from fleetlog.importers._rows import Elements, bare, finite
from fleetlog.importers.base import Importer, holding


class _Kml(Elements):
    """One row a moment of a track, or a placemark with a time; records count each kind."""

    wanted, passed = ("Track", "Placemark"), ("LineString",)

    def take(self, element: Any, _: int) -> None:
        tag = bare(element.tag)
        record = self.seen[tag]
        if tag == "Track":
            # ``when`` and ``coord`` go in pairs; one too many is one rejected record.
            times = [e.text for e in element if bare(e.tag) == "when"]
            spots = [(e.text or "").split() for e in element if bare(e.tag) == "coord"]
            for time, spot in zip(times, spots, strict=False):
                self._add(record, time, spot)
            if len(times) != len(spots):
                self.rows.reject(record, f"{len(times)} times for {len(spots)} places")
            return
        when, spot = (element.find(p) for p in ("{*}TimeStamp/{*}when", "{*}Point/{*}coordinates"))
        if when is not None and spot is not None:
            self._add(record, when.text, (spot.text or "").strip().split(","))

    def _add(self, record: int, time: str | None, spot: list[str]) -> None:
        values = dict(zip(("longitude", "latitude", "z"), map(finite, spot), strict=False))
        self.rows.add_iso(self.vehicle, time, record, values, spot)

    def nothing(self) -> tuple[str, str]:
        lines = count(self.seen["LineString"], "line")
        return f"no track with times in it, {lines} without", "export it with times (gx:Track)"


IMPORTER = Importer("kml", (".kml",), holding(b"<kml"), _Kml.batches)
