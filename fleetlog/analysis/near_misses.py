"""Near misses between trucks: time to collision and post-encroachment time.

A truck is a capsule, ``length`` by ``width``: two discs at its ends stand for it on a collision course.

- *Time to collision* (Hayward 1972): how long until two trucks touch if both go on as they do.
- *Post-encroachment time* (Allen, Shin and Cooper 1978): how long after the tail of one truck has left a
  spot of the floor the nose of another one comes to it on a crossing way.

Both need clocks that agree among the trucks."""

from itertools import product
from typing import Annotated, Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from fleetlog.analysis.apart import settled
from fleetlog.analysis.utilisation import stamps
from fleetlog.core.arguments import Between
from fleetlog.core.arrays import Array, Floats, Ints, Mask
from fleetlog.core.result import Marks, Result
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.words import count
from fleetlog.store import Dataset
from fleetlog.store.dataset import ALONE
from fleetlog.store.events import read_table

STEP = 0.25  # Of the common time grid [s]
LONGEST_GAP = 2.5  # Between rows farther apart nobody knows where a truck was to a second [s]
SAME = 5.0  # Two moments of one pair within this are one near miss [s]
MOVING = 0.5  # A truck that is slower does not cross another's way [m/s]
IN_BAY = 0.5  # A truck that stands nearer to the middle of a bay is in it [m]
CHUNK = int(600.0 / STEP)  # Steps that are compared at once
COLUMNS = ("x", "y", "heading", "speed")
TABLE = ("start", "vehicle_a", "vehicle_b", "ttc_s", "pet_s", "kind", "closing_speed", "x", "y")
WORST = 12
RAW = ("start", "a", "b", "ttc_s", "pet_s", "angle", "closing_speed", "x", "y")


def near_misses(
    dataset: Dataset, *, ttc: Annotated[float, Between(0.0, 60.0)] = 1.0,
    pet: Annotated[float, Between(0.0, 60.0)] = 1.0, closing: Annotated[float, Between(0.0, 60.0)] = 1.0,
    length: Annotated[float, Between(0.1, 30.0)] = 2.5, width: Annotated[float, Between(0.1, 10.0)] = 1.2,
) -> Result:  # fmt: skip
    """Find pairs of trucks that came close to a collision.

    The result has table ``near_misses`` in order of time (s, m/s, m; NaN: an indicator does not apply).

    Parameters
    ----------
    ttc : times to collision below this count [s].
    pet : post-encroachment times below this count [s].
    closing : minimum speed at which two trucks approach one another [m/s].
    length : length of a truck [m].
    width : width of a truck [m]."""
    found, judged = [pd.DataFrame(columns=list(RAW), dtype=float)], False
    bays = read_table(dataset, "bays")
    for date in () if dataset.alone else dataset.dates:
        placed = (_on_the_road(dataset.read(v, date, COLUMNS), bays) for v in dataset.vehicles)
        rows = [_gridded(t).assign(vehicle=k) for k, t in enumerate(placed) if len(t) > 1]
        if not any(map(len, rows)):
            continue
        fleet = pd.concat(rows, ignore_index=True)
        judged |= fleet["vehicle"].nunique() > 1
        for first in range(fleet["step"].min(), fleet["step"].max() + 1, CHUNK):
            part = fleet[fleet["step"].between(first, first + CHUNK + round(pet / STEP), "left")]
            found += [_collisions(part, ttc, closing, length, width), _crossings(part, pet, length)]
    table = _events(pd.concat(found), dataset.vehicles)
    kinds = {str(k): int(n) for k, n in table["kind"].value_counts().sort_index().items()}
    summary = {
        "ttc_s": ttc, "pet_s": pet, "closing_m_s": closing, "vehicles": len(dataset.vehicles),
        "near_misses": len(table) if judged else None, "kinds": kinds,
    }  # fmt: skip
    said = [f"Near misses are unknown: {ALONE}."] if dataset.alone else _lines(summary, table)
    # The closest ones, each with its lower indicator.
    seconds = table[["ttc_s", "pet_s"]].set_axis(["TTC", "PET"], axis=1)
    worst = seconds.min(axis=1).nsmallest(WORST)
    which = seconds.loc[worst.index].fillna(np.inf).idxmin(axis=1)
    labels = tuple(f"{name} {s:.1f} s" for name, s in zip(which, worst, strict=True))
    at = table.loc[worst.index, ["x", "y"]].to_numpy(float)
    every = table[["x", "y"]].to_numpy(float)
    marks = [Marks("near miss", every, ("",) * len(every), np.full(len(every), 0.4))]
    name = f"the {len(at)} closest, with TTC or PET" if len(at) < len(every) else "with TTC or PET"
    marks.append(Marks(name, at, labels, np.full(len(at), 1.0), "critical"))
    result = Result("near_misses", summary, {}, {"near_misses": table}, [*marks], said)
    return settled(result, dataset, "Near misses", "near_misses", limit=LONGEST_GAP)


def _lines(s: dict[str, Any], table: pd.DataFrame) -> list[str]:
    if s["vehicles"] < 2:
        return ["Near misses are between trucks: one alone has none."]
    if s["near_misses"] is None:
        return [f"Near misses are unknown: they need two trucks with rows every {LONGEST_GAP:g} s or less."]
    limits = f"{s['ttc_s']:g} s, or crossing within {s['pet_s']:g} s of one another (PET)"
    rule = f"time to collision (TTC) under {limits}"
    if not len(table):
        return [f"No near miss between two trucks ({rule})."]
    pairs = table.groupby(["vehicle_a", "vehicle_b"]).size().sort_values(ascending=False, kind="stable")
    (a, b), top = pairs.index[0], int(pairs.iloc[0])
    few = f"no pair has more than {top} ({a} and {b})"
    told = few if 5 * top < len(table) else f"{top:,} of them between {a} and {b}"
    most = f"; {told}" if top > 1 else ""
    return [f"{count(len(table), 'near miss', 'near misses')} between two trucks ({rule}){most}."]


def _on_the_road(t: Trajectory, bays: pd.DataFrame | None) -> Trajectory:
    """The rows whose place is known, and is no bay of a simulation in which the truck stands: its bays lie
    beside the road, also where those drawn after a recording are on it."""
    known: Mask = np.isfinite(t.floats("x")) & np.isfinite(t.floats("y"))
    stands = t.floats("speed") <= MOVING
    for x, y in [] if bays is None else bays[["x", "y"]].to_numpy(float):
        known &= ~(stands & (np.hypot(t.floats("x") - x, t.floats("y") - y) < IN_BAY))
    return t[known]


def _gridded(t: Trajectory) -> pd.DataFrame:
    """Rows by ``step`` (``STEP`` seconds since 1970), places and directions as complex numbers: ``at`` [m],
    ``ahead`` (of length 1; 0 of a truck whose heading was never known: it is a disc), ``speed`` [m/s]."""
    x, y, heading, speed = (t.floats(c) for c in COLUMNS)
    size, known = round(STEP * 1e6), np.isfinite(heading)
    step = np.arange(-(-t.time[0] // size), t.time[-1] // size + 1)
    after = np.maximum(np.searchsorted(t.time, step * size), 1)
    step = step[t.time[after] - t.time[after - 1] <= LONGEST_GAP * 1e6]
    at, speed = (np.interp(step * size, t.time, v) for v in (x + 1j * y, np.nan_to_num(speed)))
    since, turned = (t.time[known], np.exp(1j * heading[known])) if known.any() else (t.time, 0j * x)
    ahead = np.interp(step * size, since, turned)
    return pd.DataFrame(dict(step=step, at=at, ahead=ahead / np.maximum(abs(ahead), 1e-9), speed=speed))


def _collisions(f: pd.DataFrame, most: float, closing: float, length: float, width: float) -> pd.DataFrame:
    """Moments (``RAW``) in which two trucks are on a collision course."""
    at, ahead, speed, step = (f[c].to_numpy() for c in ("at", "ahead", "speed", "step"))
    reach = most * 2.0 * float(speed.max(initial=0.0)) + length
    # Steps lie farther apart than the reach, so that neighbours are of one step.
    tree = cKDTree(np.column_stack([at.real, at.imag, (step - step[:1]) * 2.0 * (reach + 1.0)]))
    pairs = tree.query_pairs(reach, output_type="ndarray")
    a, b = np.sort(pairs[np.maximum(*speed[pairs].T) > MOVING], axis=1).T
    gap, relative = at[b] - at[a], ahead[b] * speed[b] - ahead[a] * speed[a]
    nose = 0.5 * (length - width)
    ends = product((-1.0, 1.0), repeat=2)
    times = [time_to_contact(gap + nose * (j * ahead[b] - i * ahead[a]), relative, width) for i, j in ends]
    soon, rate = np.min(times, axis=0), -(gap.conj() * relative).real / np.maximum(abs(gap), 1e-9)
    k = np.flatnonzero((soon >= 0.0) & (soon < most) & (rate >= closing))
    a, b = a[k], b[k]
    moments = _moments(f, a, b, step[a] * STEP, 0.5 * (at[a] + at[b]))
    return moments.assign(ttc_s=soon[k], closing_speed=rate[k])


def time_to_contact(gap: Array, velocity: Array, distance: float) -> Floats:
    """(N,) seconds until points with a ``gap`` and relative ``velocity``, both complex, are ``distance`` [m]
    apart; inf where they never are, -1 where they are closer already."""
    a, b, c = abs(velocity) ** 2, (gap.conj() * velocity).real, abs(gap) ** 2 - distance**2
    root = b * b - a * c
    meets = (root >= 0.0) & (b < 0.0)
    when = np.where(meets, (-b - np.sqrt(np.maximum(root, 0.0))) / np.maximum(a, 1e-12), np.inf)
    return np.asarray(np.where(c < 0.0, -1.0, when))


def _crossings(f: pd.DataFrame, most: float, length: float) -> pd.DataFrame:
    """Moments (``RAW``) in which the nose of a truck comes to where another one's tail has just been, on a
    crossing way.  Both go straight from step to step: where two ways cross, both times are exact."""
    at, ahead, step, v = (f[c].to_numpy() for c in ("at", "ahead", "step", "vehicle"))
    begin = np.flatnonzero((np.diff(v) == 0) & (np.diff(step) == 1) & (f["speed"].to_numpy()[:-1] > MOVING))
    starts = at[begin] + np.array([[-0.5], [0.5]]) * length * ahead[begin]  # of tails and of noses
    ways = at[begin + 1] + np.array([[-0.5], [0.5]]) * length * ahead[begin + 1] - starts
    # Ways that cross have their middles within the longest one; so much time is as long as ``most``.
    reach = float(abs(ways).max(initial=0.0)) + 1e-9
    when, middles = (step[begin] - step[:1]) * (reach / (most / STEP + 1.0)), starts + 0.5 * ways
    tails, noses = (cKDTree(np.column_stack([m.real, m.imag, when])) for m in middles)
    pairs = tails.sparse_distance_matrix(noses, reach, p=np.inf, output_type="ndarray")
    tail, nose = pairs["i"], pairs["j"]
    a, b, there, here = begin[tail], begin[nose], ways[0, tail], ways[1, nose]
    gap, across = starts[1, nose] - starts[0, tail], (there.conj() * here).imag
    # The shares of both ways before the crossing; ways along one another have none.
    left, came = ((gap.conj() * way).imag / np.where(across, across, np.nan) for way in (here, there))
    wait = (step[b] + came - step[a] - left) * STEP
    # Directions less than 30 degrees apart, or nearly opposite, are of one lane or of two.
    keep = (v[a] != v[b]) & (abs((ahead[a].conj() * ahead[b]).imag) > 0.5) & (wait >= 0.0) & (wait < most)
    k = np.flatnonzero(keep & (np.maximum(abs(left - 0.5), abs(came - 0.5)) < 0.5 + 1e-9))
    time, spot = (step[b] + came) * STEP, starts[1, nose] + came * here
    return _moments(f, a[k], b[k], time[k], spot[k]).assign(pet_s=wait[k])


def _moments(f: pd.DataFrame, a: Ints, b: Ints, time: Floats, spot: Array) -> pd.DataFrame:
    """Moments (``RAW``) of the rows ``a`` and ``b``, without an indicator."""
    v, ahead, speed = (f[c].to_numpy() for c in ("vehicle", "ahead", "speed"))
    one, two = np.sort([v[a], v[b]], axis=0)
    angle, closing = abs(np.angle(ahead[a].conj() * ahead[b])), abs(ahead[b] * speed[b] - ahead[a] * speed[a])
    values = (time, one, two, np.nan, np.nan, angle, closing, spot.real, spot.imag)
    return pd.DataFrame(dict(zip(RAW, values, strict=True)))


def _events(raw: pd.DataFrame, names: list[str]) -> pd.DataFrame:
    """One row a near miss: moments of one pair close together are one, with the lowest of each indicator."""
    raw = raw.sort_values(["a", "b", "start"], ignore_index=True)
    new = (raw[["a", "b"]].diff().abs().sum(axis=1) > 0.0) | (raw["start"].diff() > SAME)
    worst = raw[["ttc_s", "pet_s"]].min(axis=1).groupby(new.cumsum()).idxmin().astype(int)
    lowest = raw.groupby(new.cumsum())[["start", "ttc_s", "pet_s"]].min()
    out = raw.loc[worst].reset_index(drop=True).assign(**lowest.reset_index(drop=True))
    out["start"] = stamps((out["start"] * 1e6).round().to_numpy(np.int64))
    for end in ("a", "b"):
        out[f"vehicle_{end}"] = [names[int(k)] for k in out[end]]
    kinds = np.array(["behind", "crossing", "head-on"], dtype=object)
    out["kind"] = kinds[np.digitize(out["angle"], np.radians([30.0, 150.0]))]
    return out[[*TABLE]].sort_values(["start", "vehicle_a", "vehicle_b"], ignore_index=True)
