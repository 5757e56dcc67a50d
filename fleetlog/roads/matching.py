"""Map matching: which directed edge every row was on.

A hidden Markov model (Newson and Krumm, 2009, doi:10.1145/1653771.1653818) chooses, a smoother places:

1. rows become *groups*: a step of motion long against its noise, or a whole standstill;
2. every group gets *candidates*: the directed edges near its mean position;
3. emission: lateral distance, direction of motion, axis of the log's heading; transition: |network distance -
   travelled distance|, turns and one-way roads being the network's; beside them one state "off the roads";
4. Viterbi chooses, forward-backward weighs;
5. the chosen candidates become routes, and the rows of each are smoothed along it."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Index, Mask
from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.roads import grouping
from fleetlog.roads.candidates import Prepared, prepare
from fleetlog.roads.kernels.decoding import decode, emission
from fleetlog.roads.kernels.records import Candidates, Choice, Groups, Routes, Rows, Track
from fleetlog.roads.kernels.routes import build_routes, place_points, route_posterior

REASONS: tuple[str, ...] = (
    "", "no road within reach", "no connected path", "against a one-way road", "standing off the road",
    "no position", "gap", "position out of line",
)  # fmt: skip
"""Why a row has no edge (``Match.reason``), and why a chain starts anew (``Match.restart``)."""
NO_ROAD, NO_PATH, ONE_WAY, STANDING, NO_POSITION, GAP, OUT_OF_LINE = range(1, 8)
SAMPLE_GROUPS = 2000  # groups from which parameters are estimated, in up to eight runs spread over the track
CHANCE_PERSISTENCE = 0.12  # that independent noise shows too, as the match bends towards it
LEAST_WEIGHT = 0.35  # of a group's evidence, however persistent the errors: at a junction it is new


@dataclass(frozen=True)
class MatchParameters:
    """Parameters of the model; NaN is estimated from the data."""

    sigma: float = math.nan  # spread of a group's lateral distance [m]
    noise: float = math.nan  # that of a single position [m]
    beta: float = math.nan  # mean of |network distance - travelled distance| of a step [m]
    persistence: float = math.nan  # correlation of successive lateral distances; tempers the evidence
    reach: float = math.nan  # roads farther away are not considered [m]
    gap: float = math.nan  # a longer silence breaks the chain [s]
    turn: float = 7.0  # cost of a turn in mid edge
    acceleration: float = 0.3  # density of the white acceleration along the route [m2/s3]
    speed_noise: float = 0.3  # spread of the log's speed [m/s]


@dataclass(frozen=True)
class Match:
    """Rows on the roads; all arrays are (N,)."""

    edge: Index  # index of the directed edge, -1 off the roads
    offset: Floats  # along the edge [m], NaN off the roads
    lateral: Floats  # left (+) or right (-) of it [m], NaN off the roads
    confidence: Floats  # probability that the edge is right; off the roads, that no road is
    reason: NDArray[np.uint8]  # index into REASONS of why a row has no edge; 0 where it has one
    restart: NDArray[np.uint8]  # of why a chain starts anew at a row (gap, no connected path), else 0
    standing: Mask  # rows of a standstill; they share one place
    parameters: MatchParameters  # as used

    def __len__(self) -> int:
        return len(self.edge)


def match(trajectory: Trajectory, network: Network, parameters: MatchParameters | None = None) -> Match:
    """Match ``trajectory`` (columns x, y; speed and heading where known) to ``network``. Parameters that are
    not given are estimated from the trajectory. Every row gets an edge or a reason."""
    prepared = prepare(network)
    track, rows, outliers = grouping.track_of(trajectory)
    wanted = parameters or MatchParameters()
    if not len(rows):
        return _nothing(len(trajectory), wanted)
    used = _estimated(track, prepared, wanted)
    track = grouping.with_gap(track, used.gap)
    groups = grouping.group_track(track, used.noise, used.sigma)
    found, known = _nothing(len(trajectory), used), _match_groups(track, groups, prepared, used)
    for name in ("edge", "offset", "lateral", "confidence", "reason", "restart", "standing"):
        getattr(found, name)[rows] = getattr(known, name)
    found.reason[outliers] = OUT_OF_LINE
    return found


def estimate_parameters(trajectory: Trajectory, network: Network) -> MatchParameters:
    """Everything that is NaN by default, estimated from the trajectory by match and residual."""
    track, _, _ = grouping.track_of(trajectory)
    wanted = MatchParameters()
    return _estimated(track, prepare(network), wanted) if len(track.t) else wanted


def _estimated(track: Track, prepared: Prepared, wanted: MatchParameters) -> MatchParameters:
    fixed = {k: v for k, v in vars(wanted).items() if not np.isnan(v)}
    gap = fixed.get("gap", max(30.0, 10.0 * track.interval))  # longer where the log is sparser
    noise = fixed.get("noise", grouping.white_noise(grouping.with_gap(track, gap)))
    guess = replace(wanted, gap=gap, noise=noise)
    some = grouping.sample(grouping.with_gap(track, gap), SAMPLE_GROUPS, noise)
    sigma = fixed.get("sigma", _first_sigma(some, prepared, noise))
    guess = replace(guess, **{"sigma": sigma, "beta": sigma + 0.2, "persistence": 0.0, **fixed})
    for _ in range(0 if {"sigma", "noise", "beta", "persistence"} <= fixed.keys() else 3):
        guess = _with_reach(guess, wanted)
        groups = grouping.group_track(some, guess.noise, guess.sigma)
        before = guess.sigma
        guess = replace(guess, **{**_from_residuals(groups, prepared, guess), **fixed})
        if abs(guess.sigma - before) < 0.05 * before:
            break
    return _with_reach(guess, wanted)


def _with_reach(p: MatchParameters, wanted: MatchParameters) -> MatchParameters:
    return p if not np.isnan(wanted.reach) else replace(p, reach=float(np.clip(6.0 * p.sigma, 5.0, 120.0)))


def _first_sigma(track: Track, prepared: Prepared, noise: float) -> float:
    """From the distance to the nearest road [m], too small among dense roads: the iteration mends it."""
    groups = grouping.group_track(track, noise, max(noise, 1.0))
    near = prepared.candidates(groups.x, groups.y, 60.0, 0.0)
    if not (some := np.diff(near.ptr) > 0).any():
        return max(noise, 5.0)
    usual = np.median(np.abs(near.lateral[near.ptr[:-1][some]]))
    return float(np.clip(1.4826 * usual, max(0.3, 0.5 * noise), 20.0))


def _from_residuals(groups: Groups, prepared: Prepared, p: MatchParameters) -> dict[str, float]:
    """sigma, noise, beta and persistence from the residuals of a match with ``p``."""
    near, choice, _ = _decode(groups, prepared, p)
    on = choice.chosen >= 0
    if on.sum() < 8:
        return {}
    edge, along, lateral = (c[choice.chosen] for c in (near.edge, near.offset, near.lateral))
    moving = on & ~groups.still
    use = lateral[moving if moving.sum() >= 8 else on]
    sigma = float(np.clip(1.4826 * np.median(np.abs(use)), 0.1, 30.0))
    out = {"sigma": sigma}
    pair = np.flatnonzero(choice.linked & ~groups.still)
    pair = pair[on[pair] & on[pair - 1] & ~groups.still[pair - 1]]
    if len(same := pair[edge[pair] == edge[pair - 1]]) >= 8:
        off = np.abs(along[same] - along[same - 1] - groups.moved[same - 1])
        out["beta"] = float(np.clip(np.mean(np.minimum(off, 8.0 * p.beta)), 0.2, 30.0))
        a, b = (np.clip(lateral[k], -3 * sigma, 3 * sigma) for k in (same, same - 1))
        out["persistence"] = float(np.clip(np.mean(a * b) / max(np.mean(a * a), 1e-9), 0.0, 0.95))
    if (np.diff(groups.first)[~groups.still] == 1).sum() >= 0.5 * (~groups.still).sum() > 0:
        # single positions: their lateral spread is the noise, or more than the noise
        out["noise"] = max(min(p.noise, sigma), 0.02)
    return out


def _decode(groups: Groups, prepared: Prepared, p: MatchParameters) -> tuple[Candidates, Choice, float]:
    """The candidates of groups, what is chosen, and how far noise may move a truck against its edge [m]."""
    near = prepared.candidates(groups.x, groups.y, p.reach, max(4.5 * p.sigma, 1.5))
    weight = max((1.0 - p.persistence) / (1.0 + p.persistence), LEAST_WEIGHT)
    spread = float(np.hypot(p.sigma, 0.1))
    own, roads = np.empty(len(near.edge) + len(groups.t)), prepared.roads
    # off the roads costs as much as a road at the edge of what is believable, and never less than 5 sigma
    off = float(np.exp(4.5 - 3.0 * max(5.0, min(p.reach, 4.0) / spread)))
    ahead = grouping.direction_of(groups, p.sigma)
    emission(near, *ahead, groups.axis, roads.reverse, spread, weight, off, own)
    back = 3.0 * p.sigma + 0.3
    prepared.reach(near, groups, p.beta)
    return near, decode(roads, prepared.store, near, own, groups, p.beta, back, p.turn), back


def _match_groups(track: Track, groups: Groups, prepared: Prepared, p: MatchParameters) -> Match:
    (near, choice, back), size = _decode(groups, prepared, p), np.diff(groups.first)
    routes = build_routes(prepared.store, prepared.roads, near, choice, groups.moved, back)
    found = _nothing(len(track.t), p)
    found.confidence[:] = np.repeat(choice.posterior[near.ptr[1:] + np.arange(len(size))], size)
    lasting = p.sigma**2 * max(p.persistence - CHANCE_PERSISTENCE, 0.0) / (1.0 - CHANCE_PERSISTENCE)
    found.standing[:] = np.repeat(groups.still, size)
    rows = _rows(track, groups, routes, found.standing, route_posterior(choice, near, routes), p)
    begins, ends = groups.first[routes.spans[0]], groups.first[routes.spans[1] + 1]
    placed = found.edge, found.offset, found.lateral, found.confidence
    place_points(rows, begins, ends, routes, prepared.lines, p.acceleration, lasting, placed)
    found.reason[:] = np.repeat(_reasons(groups, near, choice, prepared, p), size)
    found.restart[begins] = NO_PATH
    found.restart[np.flatnonzero(np.diff(track.chain)) + 1] = GAP
    found.restart[0] = 0
    return found


def _rows(track: Track, groups: Groups, routes: Routes, rest: Mask, near: Floats, p: MatchParameters) -> Rows:
    """The rows, the path coordinate interpolated between the centres of groups, extrapolated at both ends."""
    group = np.repeat(np.arange(len(groups.t)), np.diff(groups.first))
    first, last = np.append(routes.spans, [[0], [0]], axis=1)[:, routes.of]  # the last: off the roads
    on = np.clip(group - (track.t <= groups.t[group]), first[group], np.maximum(last - 1, first)[group])
    slope = np.diff(routes.centre) / np.maximum(np.diff(groups.t), 1e-9)
    centre, slope = routes.centre[group], np.append(slope, 0.0)[on]
    where = routes.centre[on] + slope * (track.t - groups.t[on])
    noise = max(p.noise, 0.02) ** 2
    position_var = np.where(rest, noise / np.diff(groups.first)[group], noise)
    speed = np.where(rest, 0.0, track.speed), np.where(rest, 1e-6, p.speed_noise**2)
    where = np.where(rest | (first == last)[group], centre, where)
    known = *track[:3], speed[0], rest, centre, near[group], position_var, speed[1], where
    return Rows._make([*known, *np.empty((2, len(group))), np.empty((5, len(group)))])


def _reasons(
    groups: Groups, near: Candidates, choice: Choice, prepared: Prepared, p: MatchParameters
) -> NDArray[np.uint8]:
    """(G,) why a group is off the roads, 0 where it is on one."""
    reason = np.zeros(len(groups.t), np.uint8)
    direction, sharpness = grouping.direction_of(groups, p.sigma)
    for g in np.flatnonzero(choice.chosen < 0):
        rows = slice(near.ptr[g], near.ptr[g + 1])
        close = np.abs(near.lateral[rows]) < max(3.0 * p.sigma, 1.0)
        edges, tangent = near.edge[rows][close], np.array([near.ux[rows], near.uy[rows]])[:, close]
        if groups.still[g] and len(close):
            reason[g] = STANDING
        elif not close.any():
            reason[g] = NO_ROAD
        else:
            against = sharpness[g] > 0.0 and (direction[:, g] @ tangent < -0.5).any()
            reason[g] = ONE_WAY if against and (prepared.roads.reverse[edges] < 0).all() else NO_PATH
    return reason


def _nothing(n: int, parameters: MatchParameters) -> Match:
    nan, none = np.full(n, np.nan), np.zeros(n, np.uint8)
    edge, reason = np.full(n, -1, np.int32), np.full(n, NO_POSITION, np.uint8)
    return Match(edge, nan, nan.copy(), np.ones(n), reason, none, np.zeros(n, bool), parameters)
