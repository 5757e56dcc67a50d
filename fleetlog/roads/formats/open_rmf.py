"""Open-RMF: navigation graphs (``nav_graphs/0.yaml``) and the ``building.yaml`` of its traffic editor.

A navigation graph is in metres, a lane directed.  A building is drawn in pixels, y down: its measurements
give the scale, and a lane is two-way where it says so.  Several levels are kept in one network, their nodes
and places named ``LEVEL/...`` where there are more than one.  Chargers, parking spots, dispensers (pick) and
ingestors (drop) become places.  Source: the tools of github.com/open-rmf/rmf_traffic_editor."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.files import SETTINGS, read_whole
from fleetlog.core.network import Edge, reversed_edge
from fleetlog.core.site import PlaceKind
from fleetlog.errors import SiteError
from fleetlog.roads.formats.base import MapOptions, Reader, RoadMap, Tally, at, number

Level = dict[str, Any]

MARKS: tuple[tuple[str, PlaceKind], ...] = (
    ("is_charger", "charge"), ("pickup_dispenser", "pick"), ("dropoff_ingestor", "drop"),
    ("is_parking_spot", "park"),
)  # fmt: skip


def _read(path: Path, options: MapOptions) -> RoadMap:
    levels, tally = _levels(path), Tally()
    for name, level in levels.items():
        front = f"{name}/" if len(levels) > 1 else ""
        with at(f"level {name}"):
            spots, words = _vertices(level)
        _add_lanes(level, spots, front, tally)
        for k, (spot, said) in enumerate(zip(spots, words, strict=True)):
            if kind := next((kind for mark, kind in MARKS if said.get(mark)), None):
                tally.stop(f"{front}{said.get('name') or k}", kind, spot)
    nothing, do = f"no lane in it: {len(levels)} levels", "export it with its lanes"
    return tally.road_map("Open-RMF", nothing, do, has_elevation=False)


def _levels(path: Path) -> dict[str, Level]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        data = YAML(typ="safe", pure=True).load(read_whole(path, SETTINGS, SiteError))
    except (YAMLError, ValueError, RecursionError, TypeError, KeyError) as error:
        text = " ".join(str(error).split())[:120]
        raise SiteError(f"not readable as YAML: {text}", do="correct the file") from None
    levels = data.get("levels") if isinstance(data, dict) else None
    if not isinstance(levels, dict) or not all(isinstance(v, dict) for v in levels.values()):
        raise SiteError("has no levels", do="give a navigation graph or a building of Open-RMF")
    return {str(k): v for k, v in levels.items()}


def _rows(level: Level, key: str, least: int) -> list[list[Any]]:
    rows = level.get(key) or []
    if not isinstance(rows, list) or not all(isinstance(r, list) and len(r) >= least for r in rows):
        raise SiteError(f"{key} is not a list of lists", place=key, do="export it again")
    return rows


def _options(row: list[Any]) -> dict[str, Any]:
    """The values of a row's last entry; the traffic editor writes each with the number of its type."""
    last = row[-1] if isinstance(row[-1], dict) else {}
    return {str(k): v[1] if isinstance(v, list) and len(v) == 2 else v for k, v in last.items()}


def _vertices(level: Level) -> tuple[Floats, list[dict[str, Any]]]:
    """Positions [m] and what is said of each vertex."""
    rows = _rows(level, "vertices", 2)
    spots = np.array([[number(r[0]), number(r[1]), 0.0] for r in rows]).reshape(-1, 3)
    words = [{"name": r[3], **_options(r)} if len(r) > 3 else _options(r) for r in rows]
    if "drawing" not in level and "measurements" not in level:
        return spots, words
    return spots * [1.0, -1.0, 1.0] * _scale(level, spots), words


def _scale(level: Level, spots: Floats) -> float:
    """Metres a pixel: the mean over the measured lines."""
    rows = _rows(level, "measurements", 3)
    ends = np.array([[_index(v, len(spots)) for v in row[:2]] for row in rows], int).reshape(-1, 2)
    metres = np.array([number(_options(row).get("distance")) for row in rows])
    pixels = np.linalg.norm(spots[ends[:, 0]] - spots[ends[:, 1]], axis=1)
    scale = float(np.mean(metres[pixels > 0.0] / pixels[pixels > 0.0])) if pixels.any() else 0.0
    if not scale > 0.0:
        do = "measure a line in the traffic editor"
        raise SiteError("has no measurement, so its scale is unknown", do=do)
    return scale


def _index(value: Any, count: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < count:
        raise SiteError(f"there is no vertex {value!r}", do="correct the file")
    return value


def _add_lanes(level: Level, spots: Floats, front: str, tally: Tally) -> None:
    seen: set[str] = set()
    for k, row in enumerate(_rows(level, "lanes", 2)):
        said = _options(row)
        with at(f"lane {k}"):
            a, b = (_index(v, len(spots)) for v in row[:2])
            limit = number(said.get("speed_limit") or 0.0)
        low, high = min(a, b), max(a, b)
        road = f"{front}{low}-{high}"
        edge = Edge(road, f"{front}{low}", f"{front}{high}", spots[[low, high]], road, limit or math.nan)
        drawn, against = (edge, reversed_edge(edge)) if a < b else (reversed_edge(edge), edge)
        both = (drawn, against) if said.get("bidirectional") is True else (drawn,)
        tally.keep(*(e for e in both if e.id not in seen), shortest=1e-3)
        seen |= {e.id for e in both}


# YAML whose top has levels, with lanes or a drawing.
TOPS = r"^(levels|building_name|coordinate_system|crowd_sim|doors|graphs):"
READER = Reader("Open-RMF", (".yaml", ".yml"), rf"\A(?![{{<]).*?{TOPS}", _read)
