"""GPX 1.0 and 1.1: tracks with times.

Waypoints and routes are no motion and are left out, with a note.  ``speed`` [m/s] and ``course`` [degrees]
may stand in an extension; numbers in other extensions are kept.  A file is one vehicle, named by the file; a
file that fleetlog wrote names its vehicles by its tracks."""

from pathlib import Path
from typing import Any

from fleetlog.core.columns import BY_NAME
from fleetlog.core.words import count
from fleetlog.importers._rows import LEFT_OUT, NAMES, Elements, bare, finite, heading_of_course
from fleetlog.importers.base import Importer, ReadOptions, holding

_KEPT: dict[str, str] = NAMES["gpx"]


class _Gpx(Elements):
    """The points of all tracks, in the order of the file."""

    wanted, passed = ("trkpt",), ("wpt", "rtept", "trkseg", "trk")

    def __init__(self, path: Path, options: ReadOptions) -> None:
        super().__init__(path, options)
        self._tracks: set[str] = set()
        self._segment, self._vehicle = None, self.vehicle

    def take(self, point: Any, number: int) -> None:
        if (segment := point.getparent()) is not self._segment:
            self._segment, track = segment, segment.getparent().findtext("{*}name", "").strip()
            self._tracks.update([track] if track else [])
            ours = (point.getroottree().getroot().get("creator") or "").startswith("fleetlog")
            self._vehicle = track if track and ours and self.options.vehicle is None else self.vehicle
        values: dict[str, Any] = {"latitude": finite(point.get("lat")), "longitude": finite(point.get("lon"))}
        leaves = {bare(leaf.tag): leaf for leaf in point}
        for name, leaf in leaves.items():
            if name != "time" and not _known(values, name, leaf.text) and len(leaf):
                _extend(values, leaf)
        time = getattr(leaves.get("time"), "text", None)
        self.rows.add_iso(self._vehicle, time, number, values, point.attrib)

    def nothing(self) -> tuple[str, str]:
        others = [count(self.seen[t], noun) for t, (noun, _) in LEFT_OUT["gpx"].items() if self.seen[t]]
        what = f"no track in it, only {' and '.join(others)}" if others else "no track point in it"
        if self.seen["trkpt"]:
            points, why = count(self.seen["trkpt"], "track point"), self.rows.take().rejects[0].reason
            what = f"none of its {points} can be used: {why}"
        return what, "record the track with times" if any(self.seen.values()) else "check the format"

    def describe(self) -> None:
        super().describe()
        if len(self._tracks) > 1:
            tracks = count(len(self._tracks), "track")
            self.report.note(f"{tracks} with different names read as vehicle {self.vehicle}")


def _known(values: dict[str, Any], name: str, text: str | None) -> bool:
    """Take what every device calls alike."""
    if column := _KEPT.get(name):
        values[column] = heading_of_course(finite(text)) if column == "heading" else finite(text)
    return column is not None


def _extend(values: dict[str, Any], part: Any) -> None:
    """Take what an extension says besides: numbers and labels under their own names."""
    for leaf in part.iterdescendants("{*}*"):
        name = bare(leaf.tag)
        if not _known(values, name, leaf.text) and not len(leaf):
            figure, column = finite(leaf.text), BY_NAME.get(name)
            if figure == figure and name not in ("latitude", "longitude"):
                values[name] = figure
            elif leaf.text and column is not None and column.kind == "label":
                values[name] = leaf.text


IMPORTER = Importer("gpx", (".gpx",), holding(b"<gpx", b"<\x00g\x00p\x00x\x00"), _Gpx.batches)
