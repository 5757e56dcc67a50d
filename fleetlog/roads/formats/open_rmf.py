"""Open-RMF: navigation graphs (``nav_graphs/0.yaml``) and the ``building.yaml`` of its traffic editor.

A navigation graph is in metres, a lane directed.  A building is drawn in pixels, y down: its measurements
give the scale, and a lane is two-way where it says so.  Several levels are kept in one network, their nodes
and places named ``LEVEL/...`` where there are more than one.  Chargers, parking spots, dispensers (pick) and
ingestors (drop) become places.  Source: the tools of github.com/open-rmf/rmf_traffic_editor.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.files import SETTINGS, read_whole
from fleetlog.core.network import Edge, reversed_edge
from fleetlog.core.site import Place, PlaceKind
from fleetlog.errors import SiteError
from fleetlog.roads.formats.base import Floats, MapOptions, Reader, RoadMap, Tally, number

MARKS: tuple[tuple[str, PlaceKind], ...] = (
    ("is_charger", "charge"), ("pickup_dispenser", "pick"), ("dropoff_ingestor", "drop"), ("is_parking_spot", "park"),
)  # fmt: skip


def sniff(head: bytes) -> bool:
    """YAML whose top has levels, with lanes or a drawing."""
    lines = head.splitlines()
    tops = (b"levels:", b"building_name:", b"coordinate_system:", b"crowd_sim:", b"doors:", b"graphs:")
    return sum(line.startswith(tops) for line in lines) >= 1 and not head.lstrip().startswith((b"{", b"<"))


def read(path: Path, options: MapOptions) -> RoadMap:
    """Read a graph or a building; see the module."""
    levels = _levels(path)
    tally = Tally()
    edges: list[Edge] = []
    places: list[Place] = []
    for name, level in levels.items():
        front = f"{name}/" if len(levels) > 1 else ""
        spots, words = _vertices(level, path, f"level {name}")
        edges += _lanes(level, spots, front, path, tally)
        places += _places(spots, words, front)
    if not edges:
        raise SiteError(f"no lane in it: {len(levels)} levels", where=path, do="export it with its lanes")
    return RoadMap(edges, tally.report("Open-RMF"), places=tuple(_named_apart(places)), has_elevation=False)


def _levels(path: Path) -> dict[str, dict[str, Any]]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        data = YAML(typ="safe", pure=True).load(read_whole(path, SETTINGS, SiteError))
    except (YAMLError, ValueError, RecursionError, TypeError, KeyError) as error:
        text = " ".join(str(error).split())[:120]
        raise SiteError(f"not readable as YAML: {text}", where=path, do="correct the file") from None
    levels = data.get("levels") if isinstance(data, dict) else None
    if not isinstance(levels, dict) or not all(isinstance(v, dict) for v in levels.values()):
        raise SiteError("has no levels", where=path, do="give a navigation graph or a building of Open-RMF")
    return {str(k): v for k, v in levels.items()}


def _rows(level: dict[str, Any], key: str, least: int, path: Path) -> list[list[Any]]:
    rows = level.get(key) or []
    if not isinstance(rows, list) or not all(isinstance(r, list) and len(r) >= least for r in rows):
        raise SiteError(f"{key} is not a list of lists", where=path, place=key, do="export it again")
    return rows


def _options(row: list[Any]) -> dict[str, Any]:
    """The values of a row's last entry; the traffic editor writes each with the number of its type."""
    last = row[-1] if isinstance(row[-1], dict) else {}
    return {str(k): v[1] if isinstance(v, list) and len(v) == 2 else v for k, v in last.items()}


def _vertices(level: dict[str, Any], path: Path, place: str) -> tuple[Floats, list[dict[str, Any]]]:
    """Positions [m] and what is said of each vertex."""
    rows = _rows(level, "vertices", 2, path)
    spots = np.array([[number(r[0], path, place), number(r[1], path, place), 0.0] for r in rows]).reshape(
        -1, 3
    )
    words = [{"name": r[3], **_options(r)} if len(r) > 3 else _options(r) for r in rows]
    if "drawing" not in level and "measurements" not in level:
        return spots, words
    return spots * [1.0, -1.0, 1.0] * _scale(level, spots, path, place), words


def _scale(level: dict[str, Any], spots: Floats, path: Path, place: str) -> float:
    """Metres a pixel: the mean over the measured lines."""
    found = []
    for row in _rows(level, "measurements", 3, path):
        a, b = (_index(v, len(spots), path, place) for v in row[:2])
        pixels = float(np.hypot(*(spots[a] - spots[b])[:2]))
        if pixels > 0.0:
            found.append(number(_options(row).get("distance"), path, place) / pixels)
    if not found or not np.mean(found) > 0.0:
        raise SiteError("has no measurement, so its scale is unknown", where=path, place=place,
                        do="measure a line in the traffic editor")  # fmt: skip
    return float(np.mean(found))


def _index(value: Any, count: int, path: Path, place: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < count:
        raise SiteError(f"there is no vertex {value!r}", where=path, place=place, do="correct the file")
    return value


def _lanes(level: dict[str, Any], spots: Floats, front: str, path: Path, tally: Tally) -> list[Edge]:
    edges: dict[str, Edge] = {}
    for k, row in enumerate(_rows(level, "lanes", 2, path)):
        tally.read += 1
        a, b = (_index(v, len(spots), path, f"lane {k}") for v in row[:2])
        said = _options(row)
        limit = number(said.get("speed_limit") or 0.0, path, f"lane {k}")
        points = spots[[a, b]]
        if np.hypot(*(points[1] - points[0])[:2]) < 1e-3:
            tally.drop("without length")
            continue
        tally.kept += 1
        low, high = min(a, b), max(a, b)
        road = f"{front}{low}-{high}"
        edge = Edge(road, f"{front}{low}", f"{front}{high}", spots[[low, high]], road, limit or math.nan)
        drawn, against = (edge, reversed_edge(edge)) if a < b else (reversed_edge(edge), edge)
        for one in (drawn, against) if said.get("bidirectional") is True else (drawn,):
            edges.setdefault(one.id, one)
    return list(edges.values())


def _places(spots: Floats, words: list[dict[str, Any]], front: str) -> list[Place]:
    out = []
    for k, (spot, said) in enumerate(zip(spots, words, strict=True)):
        kind = next((kind for mark, kind in MARKS if said.get(mark)), None)
        if kind is not None:
            out.append(Place(f"{front}{said.get('name') or k}", kind, float(spot[0]), float(spot[1])))
    return out


def _named_apart(places: list[Place]) -> list[Place]:
    seen: set[str] = set()
    return [p for p in places if not (p.id in seen or seen.add(p.id))]  # type: ignore[func-returns-value]


READER = Reader("Open-RMF", (".yaml", ".yml"), sniff, read)
