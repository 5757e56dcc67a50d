"""Map matching: which directed edge every row was on.

A hidden Markov model (Newson and Krumm, 2009, doi:10.1145/1653771.1653818) chooses the route, a
fixed-interval smoother on the route places the rows:

1. rows become *groups*: a step of motion long against its noise, or a whole standstill;
2. every group gets *candidates*: the directed edges near its mean position;
3. emission: lateral distance, direction of motion, axis of the log's heading; transition: |network distance -
    travelled
   distance|, where turns and one-way roads are the network's; beside them one state "off the roads";
4. Viterbi chooses, forward-backward weighs;
5. the chosen candidates become routes, and the rows of each are smoothed along it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.roads.candidates import Prepared, prepare
from fleetlog.roads.grouping import Groups, Track, group_track, white_noise

Floats = NDArray[np.float64]

REASONS: tuple[str, ...] = (
    "",
    "no road within reach",
    "no connected path",
    "against a one-way road",
    "standing off the road",
    "no position",
    "gap",
    "position out of line",
)
"""Why a row has no edge (``Match.reason``),
and why a chain starts anew (``Match.restart``: no connected path, gap).
"""
NO_ROAD, NO_PATH, ONE_WAY, STANDING, NO_POSITION, GAP, OUT_OF_LINE = range(1, 8)

CHANCE_PERSISTENCE = 0.12
"""Correlation of successive groups that independent noise shows too, as the match bends towards it."""
LEAST_WEIGHT = 0.35
"""Of the evidence of a group, however persistent the errors are:
at a junction it is new evidence all the same.
"""
BLOCK, AHEAD = 1000, 60
"""Groups that are decided together, and how far beyond them the model looks."""


@dataclass(frozen=True)
class MatchParameters:
    """Parameters of the model; NaN is estimated from the data.

    ``sigma`` [m] is the spread of a group's lateral distance, ``noise`` [m] that of a single position,
    ``beta`` [m] the mean of |network distance - travelled distance| of a step, ``persistence`` the
    correlation of the lateral distances of successive groups (tempers the evidence).  ``reach`` [m]: roads
    farther away are not considered.  ``gap`` [s]: a longer silence breaks the chain.  ``turn`` is the cost of
    a turn in mid edge, ``acceleration`` [m2/s3] the density of the white acceleration along the route,
    ``speed_noise`` [m/s] the spread of the log's speed.
    """

    sigma: float = float("nan")
    noise: float = float("nan")
    beta: float = float("nan")
    persistence: float = float("nan")
    reach: float = float("nan")
    gap: float = float("nan")
    turn: float = 7.0
    acceleration: float = 0.3
    speed_noise: float = 0.3


@dataclass(frozen=True)
class Match:
    """Rows on the roads; all arrays are (N,).

    Attributes
    ----------
    edge : int32 index of the directed edge, -1 off the roads.
    offset : m along the edge;  lateral : m left (+) or right (-) of it; NaN off the roads.
    confidence : probability that the edge is right; off the roads, that no road is.
    reason : uint8 index into ``REASONS`` of why a row has no edge; 0 where it has one.
    restart : uint8, where a chain starts anew at a row: ``REASONS`` of why (gap, no connected path), else 0.
    standing : bool, rows of a standstill; they share one place.
    parameters : as used.
    """

    edge: NDArray[np.int32]
    offset: Floats
    lateral: Floats
    confidence: Floats
    reason: NDArray[np.uint8]
    restart: NDArray[np.uint8]
    standing: NDArray[np.bool_]
    parameters: MatchParameters

    def __len__(self) -> int:
        return len(self.edge)


def match(trajectory: Trajectory, network: Network, parameters: MatchParameters | None = None) -> Match:
    """Match ``trajectory`` (columns x, y; speed and heading where known) to ``network``.

    Parameters that are not given are estimated from the trajectory.  Every row gets an edge or a reason.
    """
    prepared = prepare(network)
    track, rows, outliers = Track.of(trajectory)
    wanted = parameters or MatchParameters()
    if not len(track):
        return _nothing(len(trajectory), wanted)
    used = _estimated(track, prepared, wanted)
    track = track.with_gap(used.gap)
    groups = group_track(track, used.noise, used.sigma)
    found = _spread(_match_groups(track, groups, prepared, used), rows, len(trajectory))
    found.reason[outliers] = OUT_OF_LINE
    return found


def estimate_parameters(
    trajectory: Trajectory, network: Network, parameters: MatchParameters | None = None
) -> MatchParameters:
    """``parameters`` with everything that is NaN estimated from the trajectory:
    robust, iterated match and residual.
    """
    track, _, _ = Track.of(trajectory)
    wanted = parameters or MatchParameters()
    return _estimated(track, prepare(network), wanted) if len(track) else wanted


SAMPLE_GROUPS = 2000
"""Groups from which parameters are estimated, in up to eight runs spread over the track."""


def _estimated(track: Track, prepared: Prepared, wanted: MatchParameters) -> MatchParameters:
    fixed = {k: v for k, v in vars(wanted).items() if not np.isnan(v)}
    gap = fixed.get("gap", track.usual_gap())
    noise = fixed.get("noise", white_noise(track.with_gap(gap)))
    guess = replace(wanted, gap=gap, noise=noise)
    sample = track.with_gap(gap).sample(SAMPLE_GROUPS, noise)
    sigma = fixed.get("sigma", _first_sigma(sample, prepared, noise))
    guess = replace(
        guess, sigma=sigma, beta=fixed.get("beta", sigma + 0.2), persistence=fixed.get("persistence", 0.0)
    )
    if {"sigma", "noise", "beta", "persistence"} <= fixed.keys():
        return _with_reach(guess, wanted)
    for _ in range(3):
        guess = _with_reach(guess, wanted)
        groups = group_track(sample, guess.noise, guess.sigma)
        before = guess.sigma
        guess = replace(guess, **{**_residual_estimates(sample, groups, prepared, guess), **fixed})
        if abs(guess.sigma - before) < 0.05 * before:
            break
    return _with_reach(guess, wanted)


def _with_reach(p: MatchParameters, wanted: MatchParameters) -> MatchParameters:
    return p if not np.isnan(wanted.reach) else replace(p, reach=float(np.clip(6.0 * p.sigma, 5.0, 120.0)))


def _first_sigma(track: Track, prepared: Prepared, noise: float) -> float:
    """From the distance to the nearest road, which is too small among dense roads;
    the iteration mends it [m].
    """
    groups = group_track(track, noise, max(noise, 1.0))
    ptr, _, value = prepared.candidates(groups.x, groups.y, 60.0, 0.0)
    some = np.diff(ptr) > 0
    if not some.any():
        return max(noise, 5.0)
    return float(np.clip(1.4826 * np.median(np.abs(value[1, ptr[:-1][some]])), max(0.3, 0.5 * noise), 20.0))


def _residual_estimates(
    track: Track, groups: Groups, prepared: Prepared, p: MatchParameters
) -> dict[str, float]:
    """sigma, noise, beta and persistence from the residuals of a match with ``p``."""
    chain = _decode(groups, prepared, p)
    on = chain.chosen >= 0
    if on.sum() < 8:
        return {}
    row = chain.chosen[on]
    lateral = chain.value[1, row]
    moving = ~groups.still[on]
    use = lateral[moving] if moving.sum() >= 8 else lateral
    sigma = float(np.clip(1.4826 * np.median(np.abs(use)), 0.1, 30.0))
    pair = np.flatnonzero(chain.linked & ~groups.still)
    pair = pair[(chain.chosen[pair - 1] >= 0) & ~groups.still[pair - 1]]
    same = pair[chain.edge[chain.chosen[pair]] == chain.edge[chain.chosen[pair - 1]]]
    out = {"sigma": sigma}
    if len(same) >= 8:
        step = chain.value[0, chain.chosen[same]] - chain.value[0, chain.chosen[same - 1]]
        out["beta"] = float(
            np.clip(np.mean(np.minimum(np.abs(step - groups.moved[same - 1]), 8.0 * p.beta)), 0.2, 30.0)
        )
        left = np.full(len(groups), np.nan)
        left[on] = lateral
        a, b = np.clip(left[same], -3 * sigma, 3 * sigma), np.clip(left[same - 1], -3 * sigma, 3 * sigma)
        out["persistence"] = float(np.clip(np.mean(a * b) / max(np.mean(a * a), 1e-9), 0.0, 0.95))
    if groups.is_single(0.5):
        # single positions: their lateral spread is the noise, or more than the noise
        out["noise"] = max(min(p.noise, sigma), 0.02)
    return out


@dataclass(frozen=True)
class Chain:
    """A decoded sequence of groups; ``chosen`` (G,) rows of the candidates ``edge`` (C,)
    and ``value`` (4, C), -1 off.
    """

    ptr: NDArray[np.int64]
    edge: NDArray[np.int32]
    value: Floats
    chosen: NDArray[np.int64]
    posterior: Floats
    off_posterior: Floats
    linked: NDArray[np.bool_]
    back: float


def _decode(groups: Groups, prepared: Prepared, p: MatchParameters) -> Chain:
    from fleetlog.roads.matchkernels.kernels.costs import emission_costs
    from fleetlog.roads.matchkernels.kernels.decoding import decode

    ptr, edge, value = prepared.candidates(groups.x, groups.y, p.reach, max(4.5 * p.sigma, 1.5))
    weight = max((1.0 - p.persistence) / (1.0 + p.persistence), LEAST_WEIGHT)
    spread = float(np.hypot(p.sigma, 0.1))
    direction, sharpness = groups.direction(p.sigma)
    emission = emission_costs(
        ptr, edge, value, direction, sharpness, groups.axis, prepared.reverse, spread, weight
    )
    back = 3.0 * p.sigma + 0.3
    # off the roads costs as much as a road at the edge of what is believable for this noise, and never less
    # than 5 sigma
    off = 3.0 * max(5.0, min(p.reach, 4.0) / spread) - 4.5
    prepared.store, chosen, posterior, off_posterior, linked = decode(
        prepared.store, ptr, edge, value, emission, prepared.rank, groups.chain, groups.moved, groups.still,
        p.beta, back, p.turn, off, BLOCK, AHEAD, prepared.reverse, prepared.next_first, prepared.next_edges,
        prepared.length,
    )  # fmt: skip
    return Chain(ptr, edge, value, chosen, posterior, off_posterior, linked, back)


def _match_groups(track: Track, groups: Groups, prepared: Prepared, p: MatchParameters) -> Match:
    from fleetlog.roads.matchkernels.kernels.placing import place_points, route_posterior
    from fleetlog.roads.matchkernels.kernels.routes import build_routes

    chain = _decode(groups, prepared, p)
    p_edge, p_value, firsts, spans, of, piece, place = build_routes(
        prepared.store, chain.chosen, chain.linked, chain.edge, chain.value, groups.moved, prepared.reverse,
        prepared.length, chain.back,
    )  # fmt: skip
    near = route_posterior(chain.chosen, chain.ptr, chain.edge, chain.posterior, piece, of, firsts, p_edge)
    n = len(track)
    edge = np.full(n, -1, np.int32)
    offset, lateral = np.full(n, np.nan), np.full(n, np.nan)
    confidence = np.repeat(chain.off_posterior, np.diff(groups.first))
    lasting = p.sigma**2 * max(p.persistence - CHANCE_PERSISTENCE, 0.0) / (1.0 - CHANCE_PERSISTENCE)
    place_points(
        track.t, track.x, track.y, track.speed, groups.first, groups.t, spans, firsts, piece, place,
        groups.still, p_edge, p_value, prepared.px, prepared.py, prepared.first, prepared.dist, near,
        max(p.noise, 0.02) ** 2, lasting, p.speed_noise**2, p.acceleration, edge, offset, lateral, confidence,
    )  # fmt: skip
    reason = np.repeat(_reasons(groups, chain, prepared, p), np.diff(groups.first)).astype(np.uint8)
    restart = np.zeros(n, np.uint8)
    new_stretch = groups.first[:-1][spans[0]] if spans.shape[1] else np.zeros(0, np.int64)
    restart[new_stretch] = NO_PATH
    restart[np.flatnonzero(np.diff(track.chain)) + 1] = GAP
    restart[0] = 0
    standing = np.repeat(groups.still, np.diff(groups.first))
    return Match(edge, offset, lateral, confidence, reason, restart, standing, p)


def _reasons(groups: Groups, chain: Chain, prepared: Prepared, p: MatchParameters) -> NDArray[np.uint8]:
    """(G,) why a group is off the roads, 0 where it is on one."""
    reason = np.zeros(len(groups), np.uint8)
    for g in np.flatnonzero(chain.chosen < 0):
        rows = slice(chain.ptr[g], chain.ptr[g + 1])
        near = np.abs(chain.value[1, rows]) < max(3.0 * p.sigma, 1.0)
        if not len(near):
            reason[g] = NO_ROAD
        elif groups.still[g]:
            reason[g] = STANDING
        elif near.any() and (prepared.reverse[chain.edge[rows][near]] < 0).all():
            reason[g] = ONE_WAY if _against(groups, chain, int(g), rows, near, p) else NO_PATH
        else:
            reason[g] = NO_PATH if near.any() else NO_ROAD
    return reason


def _against(
    groups: Groups, chain: Chain, g: int, rows: slice, near: NDArray[np.bool_], p: MatchParameters
) -> bool:
    direction, sharpness = groups.direction(p.sigma)
    along = direction[0, g] * chain.value[2, rows][near] + direction[1, g] * chain.value[3, rows][near]
    return bool(sharpness[g] > 0.0 and (along < -0.5).any())


def _nothing(n: int, parameters: MatchParameters) -> Match:
    nan = np.full(n, np.nan)
    reason = np.full(n, NO_POSITION, np.uint8)
    none = np.zeros(n, np.uint8)
    return Match(
        np.full(n, -1, np.int32), nan, nan.copy(), np.ones(n), reason, none, np.zeros(n, bool), parameters
    )


def _spread(found: Match, rows: NDArray[np.int64], n: int) -> Match:
    """The match of the rows with a position as one of all ``n`` rows."""
    if len(rows) == n:
        return found
    out = _nothing(n, found.parameters)
    for name in ("edge", "offset", "lateral", "confidence", "reason", "restart", "standing"):
        getattr(out, name)[rows] = getattr(found, name)
    return out
