"""Open-RMF: navigation graphs (``nav_graphs/0.yaml``) and the ``building.yaml`` of its traffic editor.

A navigation graph is in metres.  A building is in metres too, in degrees (wgs84), or drawn in pixels, y down:
then the measurements of its reference level give the scale, and fiducials lay the other levels over that one.
Where a reference system is named, the map has its place on earth.  A lane is two-way where it says so.
Several levels are kept in one network, their nodes and places named ``LEVEL/...``.  Chargers, parking spots,
dispensers (pick) and ingestors (drop) become places.  Source: github.com/open-rmf/rmf_traffic_editor."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats
from fleetlog.core.files import SETTINGS, read_whole
from fleetlog.core.network import Edge, reversed_edge
from fleetlog.core.schema import Wrong
from fleetlog.core.site import Inverse, PlaceKind, crs, geographic
from fleetlog.errors import SiteError
from fleetlog.roads.formats.base import WORDS, MapOptions, Reader, RoadMap, Tally, at, number

Level = dict[str, Any]
MARKS: dict[str, PlaceKind] = WORDS["kinds"]["open-rmf"]


def _read(path: Path, options: MapOptions) -> RoadMap:
    top, tally = _document(path), Tally()
    levels: dict[str, Level] = {str(k): v for k, v in top["levels"].items()}
    drawn = any(len(row) > 3 for level in levels.values() for row in _rows(level, "vertices", 2))
    system = top.get("coordinate_system", "reference_image" if drawn else "cartesian_meters")
    if system not in ("reference_image", "cartesian_meters", "wgs84"):
        do = "save it in the traffic editor as wgs84 or cartesian_meters"
        raise SiteError(f"coordinates of the system {system!r} are not read", do=do)
    pixels = system == "reference_image"
    lie = _overlaid(levels, top) if pixels else dict.fromkeys(levels, (1.0 + 0j, 0j))
    for name, level in ((k, v) for k, v in levels.items() if v.get("lanes")):
        front = f"{name}/" if len(levels) > 1 else ""
        with at(f"level {name}"):
            rows, (factor, shift) = _rows(level, "vertices", 2), lie[name]
            plane = factor * _plane(rows, pixels) + shift
        spots = np.column_stack([plane.real, plane.imag, np.zeros(len(rows))])
        # a millimetre, in degrees or metres
        _add_lanes(level, spots, front, tally, 1e-8 if system == "wgs84" else 1e-3)
        for k, row in enumerate(rows):
            said = {"name": row[3], **_options(row)} if len(row) > 3 else _options(row)
            if kind := next((kind for mark, kind in MARKS.items() if said.get(mark)), None):
                tally.stop(f"{front}{said.get('name') or k}", kind, spots[k])
    earth = _earth(top, tally.edges) if system == "cartesian_meters" else None
    return tally.road_map(
        "Open-RMF", f"no lane in it: {len(levels)} levels", "export it with its lanes",
        geographic=system == "wgs84", geographic_of=earth, has_elevation=False,
    )  # fmt: skip


def _document(path: Path) -> dict[str, Any]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        data = YAML(typ="safe", pure=True).load(read_whole(path, SETTINGS, SiteError))
    except (YAMLError, ValueError, RecursionError, TypeError, KeyError) as error:
        text = " ".join(str(error).split())[:120]
        raise SiteError(f"not readable as YAML: {text}", do="correct the file") from None
    levels = data.get("levels") if isinstance(data, dict) else None
    if not levels or not isinstance(levels, dict) or not all(isinstance(v, dict) for v in levels.values()):
        raise SiteError("has no levels", do="give a navigation graph or a building of Open-RMF")
    return dict(data)


def _earth(top: dict[str, Any], edges: list[Edge]) -> Inverse | None:
    """Where on earth metres lie: a navigation graph says ``crs_name`` and ``offset``, a building
    ``generate_crs``. Of some tools the offset is in the coordinates: they are nearer to it than to zero."""
    name = top.get("crs_name") or _options([top.get("parameters")]).get("generate_crs")
    if not name or not edges:
        return None
    offset = complex(_plane(_rows({"offset": [top.get("offset", [0.0, 0.0])]}, "offset", 2), False)[0])
    try:
        crs(name)
    except Wrong as error:
        raise SiteError(str(error), place="crs_name", do="correct the file") from None
    first = complex(*edges[0].points[0, :2])
    left = 0j if abs(first - offset) < abs(first) else offset
    return lambda x, y: geographic(name, x + left.real, y + left.imag)


def _overlaid(levels: dict[str, Level], top: dict[str, Any]) -> dict[str, tuple[complex, complex]]:
    """How the pixels of each level with lanes lie in metres, as factor and shift of complex numbers."""
    if (base := str(top.get("reference_level_name", next(iter(levels))))) not in levels:
        raise SiteError(f"there is no level {base!r}", place="reference_level_name", do="correct the file")
    marks: dict[str, dict[str, complex]] = {}
    for name, level in levels.items():
        with at(f"level {name}"):
            rows = _rows(level, "fiducials", 3)
            marks[name] = dict(zip((str(row[2]) for row in rows), _plane(rows, True), strict=True))
    with at(f"level {base}"):
        rows, spots = _rows(levels[base], "measurements", 3), _plane(_rows(levels[base], "vertices", 2), True)
        pixels = [abs(complex(np.diff(spots[[_index(v, len(spots)) for v in row[:2]]])[0])) for row in rows]
        long = [number(_options(row).get("distance")) for row in rows]
        scale = np.mean([m / p for m, p in zip(long, pixels, strict=True) if p > 0.0] or [0.0])  # m a pixel
        if not scale > 0.0:
            raise SiteError("has no measurement, so its scale is unknown", do="measure a line of it")
        out = {base: (complex(scale), 0j)}
    for name in (name for name, level in levels.items() if level.get("lanes") and name != base):
        both = sorted(marks[name].keys() & marks[base].keys())
        mine, there = (np.array([marks[level][mark] for mark in both]) for level in (name, base))
        if len(np.unique(mine)) < 2 or len(np.unique(there)) < 2:
            what = f"has no two fiducials in common with level {base}, so how it lies over it is unknown"
            raise SiteError(what, place=f"level {name}", do="mark the same two spots on both")
        around, metres = mine - mine.mean(), there * out[base][0]  # the similarity that fits best
        factor = np.vdot(around, metres) / np.vdot(around, around)
        out[name] = complex(factor), complex(metres.mean() - factor * mine.mean())
    return out


def _plane(rows: list[list[Any]], pixels: bool) -> NDArray[np.complex128]:
    """(n,) x + i y of rows; of pixels y runs down."""
    spots = np.array([complex(number(row[0]), number(row[1])) for row in rows])
    return spots.conjugate() if pixels else spots


def _rows(level: Level, key: str, least: int) -> list[list[Any]]:
    rows = level.get(key) or []
    if not isinstance(rows, list) or not all(isinstance(r, list) and len(r) >= least for r in rows):
        raise SiteError(f"{key} is not a list of lists", place=key, do="export it again")
    return rows


def _options(row: list[Any]) -> dict[str, Any]:
    """The values of a row's last entry; the traffic editor writes each with the number of its type."""
    last = row[-1] if isinstance(row[-1], dict) else {}
    return {str(k): v[1] if isinstance(v, list) and len(v) == 2 else v for k, v in last.items()}


def _index(value: Any, count: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < count:
        raise SiteError(f"there is no vertex {value!r}", do="correct the file")
    return value


def _add_lanes(level: Level, spots: Floats, front: str, tally: Tally, shortest: float) -> None:
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
        # buildings say the one, navigation graphs the other
        two_way = any(said.get(key) is True for key in ("bidirectional", "is_bidirectional"))
        both = (drawn, against) if two_way else (drawn,)
        tally.keep(*(e for e in both if e.id not in seen), shortest=shortest)
        seen |= {e.id for e in both}


# YAML whose top has levels, with lanes or a drawing.
TOPS = r"^(levels|building_name|coordinate_system|crowd_sim|doors|graphs):"
READER = Reader("Open-RMF", (".yaml", ".yml"), rf"\A(?![{{<]).*?{TOPS}", _read)
