"""How a log's own frame lies in the site's: the rotation and shift that put its tracks on the roads.

Every rotation is tried, with every shift at once by correlation of what was driven with the roads, direction
by direction; the best are fitted to the centre lines by least squares.  An ambiguous frame is refused."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, rfft2
from scipy.ndimage import gaussian_filter, gaussian_filter1d
from scipy.spatial import cKDTree
from scipy.stats import t as student

from fleetlog.core.arrays import Floats
from fleetlog.core.network import Network
from fleetlog.core.site import MapFrame
from fleetlog.core.words import percent
from fleetlog.errors import DataError

LONGEST = 1e6  # A track that is longer by its rows leaps about [m]: its places lie farther apart
SECTORS = 8  # Directions that are told apart by the correlation
TURN = np.radians(1.5)  # Step of the rotations that are tried
MOST_CELLS = 512  # Cells of a side of the correlation; the cell is at least :data:`CELL` [m]
CELL = 1.0
TRIED = 12  # Best places of the correlation that are fitted
POINTS = 4000  # Places of the log that are fitted
WIDE, NARROW = 6.0, 1.5  # Reach of a road at the start and at the end of a fit [m]
STRAIGHT = np.cos(np.radians(25.0))
APART, TURNED = 1.0, np.radians(1.0)  # Fits farther apart than this [m, rad] are different
LEAST = 0.5  # Less of the log than this on the roads is no fit
MARGIN = 0.04  # The best fit has this much more of the log on the roads than any other
SURE = (0.2, float(np.radians(0.2)))
"""A fit is known where 99 in 100 like it are within this of the truth, everywhere in the log [m, rad]."""
BLOCK = 60.0  # Metres of track whose errors may be one: those of satellite positions last for tens of seconds
NUDGE = 0.25  # Step of the numerical derivative of a fit's score [m]


class Alignment(NamedTuple):
    """A fitted frame, which takes the log into the site; its figures, JSON-ready; and one sentence."""

    frame: MapFrame
    summary: dict[str, Any]
    line: str


class _Roads:
    """Stations a metre apart of directed roads: (n, 2) place, normal; (n,) heading, if both ways share it."""

    def __init__(self, network: Network) -> None:
        edge, offset = network.stations()
        self.place, self.heading = network.position(edge, offset)[:, :2], network.heading(edge, offset)
        self.normal = np.stack([-np.sin(self.heading), np.cos(self.heading)], axis=1)
        self.both, self.tree = network.reverse[edge] >= 0, cKDTree(self.place)


class _Log(NamedTuple):
    """Places of a log ``step`` metres apart along its tracks, the direction of travel, and their middle."""

    place: Floats
    heading: Floats
    centre: Floats
    step: int


class _Fit(NamedTuple):
    """A pose of the log, and how it fits. ``pose`` (4,) is the place of the log's centre [m], its rotation
    [rad], and how far to the right of the line trucks keep on roads whose directions share one [m]."""

    pose: Floats
    on_roads: float
    residual: float


def align(tracks: list[tuple[Floats, Floats]], network: Network, name: str = "log") -> Alignment:
    """Fit the frame of a log, called ``name``, to the roads of a site.

    ``tracks`` are x, y [m] of each vehicle in the log's frame, in order of time; NaN where unknown.  Of the
    figures, ``residual_m`` is the median distance from the lines of the roads, ``on_roads`` the share of the
    log within reach of one, ``runner_up`` that of the next best fit; ``shift_sd_m`` is the standard deviation
    of the log's worst place.  :class:`~fleetlog.errors.DataError` where nothing fits, or several places."""
    place, heading = _places(tracks, float(np.hypot(*np.ptp(network.points[:, :2], axis=0))))
    if len(place) < 50:
        raise DataError("cannot be aligned: it holds less than 50 m of driving", do="give a longer log")
    roads, step = _Roads(network), max(len(place) // POINTS, 1)
    log = _Log(place[::step], heading[::step], place[::step].mean(axis=0), step)
    fits = [_fitted(log, roads, *start) for start in _starts(place, heading, roads)]
    fits.sort(key=lambda f: -f.on_roads)
    best = fits[0]
    gaps = ((f.on_roads, best.pose - f.pose) for f in fits[1:])
    runner_up = next((on for on, gap in gaps if _apart(gap[:2], gap[2], APART, TURNED)), 0.0)
    shift_sd, rotation_sd, times = _deviations(log, roads, best)
    _check(best, runner_up, times * shift_sd, times * rotation_sd)
    x, y = (best.pose[:2] - _turned(log.centre[None], best.pose[2])[0]).tolist()
    frame = MapFrame(name, (x, y), _wrapped(best.pose[2]))
    summary = {
        "name": name, "shift": [x, y], "rotation": frame.rotation,
        "residual_m": best.residual, "on_roads": best.on_roads, "runner_up": runner_up,
        "shift_sd_m": shift_sd, "rotation_sd_rad": rotation_sd,
    }  # fmt: skip
    pose = f"rotation {np.degrees(frame.rotation):.2f} deg, shift ({x:.2f}, {y:.2f}) m"
    fit = f"median residual {best.residual:.2f} m, {percent(best.on_roads)} on roads"
    return Alignment(frame, summary, f"aligned: {pose}; {fit} (next best {percent(runner_up)})")


def _check(best: _Fit, runner_up: float, shift: float, rotation: float) -> None:
    what = None
    if best.on_roads < LEAST:
        what = f"no frame puts more than {percent(best.on_roads)} of the log on the roads"
    elif runner_up > best.on_roads - MARGIN:
        shares = f"{percent(best.on_roads)} and {percent(runner_up)} of the log on roads"
        what = f"two frames fit about as well ({shares})"
    elif not (shift <= SURE[0] and rotation <= SURE[1]):
        what = "the log leaves the shift open"
        if np.isfinite(shift):
            what += f" by {shift:.2f} m or the rotation by {np.degrees(rotation):.2f} deg"
    if what is not None:
        do = "give a log that drives more of the roads, or state [[map_frame]] in the site or the profile"
        raise DataError(f"cannot be aligned: {what}", do=do)


def _places(tracks: list[tuple[Floats, Floats]], across: float) -> tuple[Floats, Floats]:
    """Places about a metre apart along the smoothed tracks, and the direction of travel at each. What is
    farther from the median place than the roads reach ``across`` [m] is no place on them."""
    places, headings = [np.zeros((0, 2))], [np.zeros(0)]
    pooled = [np.concatenate([t[i] for t in tracks]) for i in (0, 1)]
    middle = [float(np.median(v[np.isfinite(v)])) if np.isfinite(v).any() else 0.0 for v in pooled]
    for x, y in tracks:
        known = np.hypot(x - middle[0], y - middle[1]) <= across + WIDE
        track = np.column_stack([x[known], y[known]])
        if len(track) < 5:
            continue
        steps = np.hypot(*np.diff(gaussian_filter1d(track, 3.0, axis=0), axis=0).T)
        way = np.concatenate([[0.0], np.cumsum(steps)])
        at = np.arange(0.0, way[-1], max(1.0, way[-1] / LONGEST))
        if len(at) < 5:
            continue
        even = np.column_stack([np.interp(at, way, v) for v in track.T])
        ahead = np.gradient(gaussian_filter1d(even, 2.0, axis=0), axis=0)
        places.append(even)
        headings.append(np.arctan2(ahead[:, 1], ahead[:, 0]))
    return np.concatenate(places), np.concatenate(headings)


def _starts(place: Floats, heading: Floats, roads: _Roads) -> list[tuple[float, Floats]]:
    """Rotations and shifts that put most of the log near roads of its direction, the best that lead apart."""
    low, high = roads.place.min(axis=0), roads.place.max(axis=0)
    middle = place.mean(axis=0)
    reach = float(np.hypot(*(place - middle).T).max())
    span = float((high - low).max()) + 2.0 * reach + 20.0
    cell = max(CELL, span / MOST_CELLS)
    side = 1 << int(np.ceil(np.log2(span / cell)))
    origin = low - reach - 10.0
    there = _spectra(roads.place - origin, roads.heading, cell, side, 1.5)
    found: list[tuple[float, float, Floats]] = []
    for rotation in np.arange(0.0, 2.0 * np.pi, TURN):
        turned = _turned(place - middle, rotation)
        driven = _spectra(turned % (side * cell), heading + rotation, cell, side, 0.0)
        score = irfft2((there * driven.conj()).sum(axis=0), (side, side))
        for _ in range(3):
            peak = np.unravel_index(int(np.argmax(score)), score.shape)
            shift = np.array([peak[1], peak[0]], float) * cell + origin
            found.append((float(score[peak]), float(rotation), shift - _turned(middle[None], rotation)[0]))
            near = np.arange(-int(4.0 / cell) - 1, int(4.0 / cell) + 2)
            score[np.ix_((near + peak[0]) % side, (near + peak[1]) % side)] = -np.inf
    kept: list[tuple[float, Floats]] = []
    for _, rotation, shift in sorted(found, key=lambda f: -f[0]):
        at = _turned(middle[None], rotation)[0] + shift
        gaps = ((at - _turned(middle[None], r)[0] - s, rotation - r) for r, s in kept)
        if all(_apart(gap, turn, 4.0, 3.0 * TURN) for gap, turn in gaps):
            kept.append((rotation, shift))
        if len(kept) == TRIED:
            break
    return kept


def _turned(points: Floats, rotation: float) -> Floats:
    c, s = np.cos(rotation), np.sin(rotation)
    return np.asarray(points @ np.array([[c, s], [-s, c]]))


def _spectra(place: Floats, heading: Floats, cell: float, side: int, blur: float) -> NDArray[np.complex128]:
    """Fourier transforms of where is road (or driven), by direction; every square counts once."""
    x, y = ((place / cell).astype(np.int64) % side).T
    picture = np.zeros((SECTORS, side, side), np.float32)
    picture[np.round(heading / (2.0 * np.pi) * SECTORS).astype(np.int64) % SECTORS, y, x] = 1.0
    if blur:
        picture = np.maximum.reduce([np.roll(picture, beside, axis=0) for beside in (-1, 0, 1)])
        picture = np.minimum(gaussian_filter(picture, (0.0, blur, blur), mode="wrap") * 3.0, 1.0)
    return np.asarray(rfft2(picture))


def _fitted(log: _Log, roads: _Roads, rotation: float, shift: Floats) -> _Fit:
    """Least squares of the distances from the roads, ever closer."""
    pose = np.array([*(_turned(log.centre[None], rotation)[0] + shift), rotation, 0.0])
    left, weight = np.zeros(len(log.place)), np.zeros(len(log.place))
    for reach in (*np.geomspace(WIDE, NARROW, 8), *[NARROW] * 8):
        left, weight, design = _linear(log, roads, pose, reach)
        if (weight > 0.0).sum() < 30:
            break
        matrix = design.T @ (design * weight[:, None]) + np.diag([1e-9, 1e-9, 1e-9, 1.0])
        pose = pose + np.linalg.solve(matrix, -design.T @ (weight * left))
    good = weight > 0.0
    residual = float(np.median(np.abs(left[good]))) if good.any() else float("inf")
    return _Fit(pose, float(good.mean()), residual)


def _linear(log: _Log, roads: _Roads, pose: Floats, reach: float) -> tuple[Floats, Floats, Floats]:
    """(n,) distance left of the best line [m], weight, 0 beyond reach, and (n, 4) derivatives by the pose."""
    arm = _turned(log.place - log.centre, pose[2])
    at, heading, side = pose[:2] + arm, log.heading + pose[2], pose[3]
    far, near = roads.tree.query(at, k=12, distance_upper_bound=reach + abs(side) + 1.0)
    known = np.isfinite(far)
    near = np.where(known, near, 0)
    alike = known & (np.cos(roads.heading[near] - heading[:, None]) > STRAIGHT)
    normal, both = roads.normal[near], roads.both[near]
    gap = at[:, None, :] - roads.place[near]
    left = (gap * normal).sum(axis=2) + side * both
    ahead = gap[:, :, 0] * normal[:, :, 1] - gap[:, :, 1] * normal[:, :, 0]
    cost = np.where(alike & (np.abs(ahead) < 1.0), np.abs(left), np.inf)
    pick = np.arange(len(at)), np.argmin(cost, axis=1)
    good, left, normal = cost[pick] < reach, left[pick], normal[pick]
    lever = normal[:, 1] * arm[:, 0] - normal[:, 0] * arm[:, 1]
    weight = np.where(good, (1.0 - (left / (2.0 * reach)) ** 2).clip(0.0) ** 2, 0.0)
    return left, weight, np.column_stack([normal, lever, both[pick].astype(float)])


def _deviations(log: _Log, roads: _Roads, fit: _Fit) -> tuple[float, float, float]:
    """Standard deviations of the worst place [m] and the rotation [rad]; how many hold 99 in 100 fits.

    The sandwich of an M-estimator (Huber, 1967), its score summed over blocks of track, so that errors that
    last count as one (Liang and Zeger, 1986, doi:10.1093/biomet/73.1.13).  The score's derivative is
    numerical, for it must know that places come into reach of a line and leave it."""

    def score(pose: Floats) -> Floats:
        left, weight, design = _linear(log, roads, pose, NARROW)
        return np.asarray(design * (weight * left)[:, None])

    size = max(float(np.hypot(*(log.place - log.centre).T).mean()), 1.0)
    steps = np.diag([NUDGE, NUDGE, NUDGE / size, NUDGE])
    change = [score(fit.pose + h).sum(axis=0) - score(fit.pose - h).sum(axis=0) for h in steps]
    bread = np.column_stack(change) / (2.0 * np.diag(steps)) + np.diag([0.0, 0.0, 0.0, 1.0])
    blocks = np.add.reduceat(score(fit.pose), np.arange(0, len(log.place), max(int(BLOCK / log.step), 1)))
    count = int(np.abs(blocks).any(axis=1).sum())
    if count < 6 or np.linalg.cond(bread) > 1e12:
        return np.inf, np.inf, 1.0
    inverse = np.linalg.inv(bread)
    c = inverse @ (blocks.T @ blocks) @ inverse.T * count / (count - 4.0)
    x, y = _turned(log.place - log.centre, _wrapped(fit.pose[2])).T
    square = c[0, 0] + c[1, 1] + 2.0 * (x * c[1, 2] - y * c[0, 2]) + (x * x + y * y) * c[2, 2]
    return float(np.sqrt(square.max())), float(np.sqrt(c[2, 2])), float(student.ppf(0.995, count - 4.0))


def _apart(gap: Floats, turn: float, most: float, most_turn: float) -> bool:
    """Whether a shift or a rotation is more than so much."""
    return bool(np.hypot(*gap) > most or abs(_wrapped(turn)) > most_turn)


def _wrapped(angle: float) -> float:
    return float(np.remainder(angle + np.pi, 2 * np.pi) - np.pi)
