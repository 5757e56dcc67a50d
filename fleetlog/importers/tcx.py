"""Garmin TCX: the trackpoints of all activities and courses, with altitude and speed."""

from typing import Any

from fleetlog.core.words import count
from fleetlog.importers._rows import NAMES, Elements, bare, finite
from fleetlog.importers.base import Importer, holding

_LEAVES: dict[str, str] = NAMES["tcx"]


class _Tcx(Elements):
    """One row a trackpoint that has a position."""

    wanted, passed = ("Trackpoint",), ("Track",)

    def take(self, point: Any, number: int) -> None:
        if point.find("{*}Position") is None:
            self.seen["still"] += 1
            return
        texts = {bare(leaf.tag): leaf.text for leaf in point.iter()}
        values = {name: finite(texts[leaf]) for leaf, name in _LEAVES.items() if leaf in texts}
        self.rows.add_iso(self.vehicle, texts.get("Time"), number, values)

    def nothing(self) -> tuple[str, str]:
        points = count(self.seen["Trackpoint"], "trackpoint")
        return f"none of its {points} has time and position", "record the activity with its position"


IMPORTER = Importer("tcx", (".tcx",), holding(b"<TrainingCenterDatabase"), _Tcx.batches)
