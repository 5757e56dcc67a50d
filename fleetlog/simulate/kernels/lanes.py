"""Lanes and pieces of road: how fast on them, who is in line there, how far ahead one must know."""

import numpy as np

from fleetlog.simulate.kernels.inner import inner
from fleetlog.simulate.state import Fleet, Limits, Mode, Roads


@inner
def safe(v: float, room: float, u: float, brake: float, dt: float) -> float:
    """Speed that still stops behind one ``room`` m ahead who brakes from ``u`` (Krauss 1998)."""
    q = 0.25 * brake * brake * dt * dt + 2.0 * brake * (room - 0.5 * v * dt) + u * u
    return -0.5 * brake * dt + np.sqrt(q) if q > 0.0 else 0.0


@inner
def cap_at(r: Roads, piece: int, s: float, row: int) -> float:
    """Speed cap on a piece; its square is linear between samples."""
    x = min(max(s, 0.0), r.length[piece]) / r.spacing[piece]
    low = r.first[piece]
    i = min(int(x), r.first[piece + 1] - low - 2)
    a, b = r.cap[row, low + i], r.cap[row, low + i + 1]
    return np.sqrt(a * a + (x - i) * (b * b - a * a))


@inner
def is_safe_lane(r: Roads, piece: int) -> bool:
    """Whether a truck may wait on this piece."""
    return piece < len(r.clear) and r.capacity[piece] > 0


@inner
def push(f: Fleet, v: int, piece: int) -> None:
    """Join the end of a piece's queue."""
    f.ahead[v] = f.tail[piece]
    f.behind[v] = -1
    if f.tail[piece] >= 0:
        f.behind[f.tail[piece]] = v
    f.tail[piece] = v


@inner
def drop(f: Fleet, v: int, piece: int) -> None:
    """Leave a piece's queue."""
    a, b = f.ahead[v], f.behind[v]
    if a >= 0:
        f.behind[a] = b
    if b >= 0:
        f.ahead[b] = a
    if f.tail[piece] == v:
        f.tail[piece] = a
    f.ahead[v] = -1
    f.behind[v] = -1


@inner
def insert(f: Fleet, v: int, piece: int) -> None:
    """Join a piece's queue at one's own offset."""
    b, a = -1, f.tail[piece]
    while a >= 0 and f.s[a] < f.s[v]:
        b, a = a, f.ahead[a]
    f.ahead[v], f.behind[v] = a, b
    if a >= 0:
        f.behind[a] = v
    if b >= 0:
        f.ahead[b] = v
    else:
        f.tail[piece] = v


@inner
def front(r: Roads, f: Fleet, v: int, x: Limits) -> float:
    """How far along its lane a truck reaches [m]."""
    reach = 0.5 * x.length
    if f.mode[v] == Mode.LEAVING or f.mode[v] == Mode.ENTERING:
        reach = max(reach, r.door_ahead[f.door[v]])
    return f.s[v] + reach
