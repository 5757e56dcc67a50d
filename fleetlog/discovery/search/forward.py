"""The search: add what predicts best, try its rivals, drop what is not needed, until nothing is left."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from fleetlog.discovery.hypotheses.hypothesis import Chosen, Hypothesis
from fleetlog.discovery.model import FLEET, Model, Scope
from fleetlog.discovery.search import finish
from fleetlog.discovery.search.beside import Screened, gained, pattern_hypotheses, screen
from fleetlog.discovery.search.design import CERTAIN
from fleetlog.discovery.search.finish import OWN, Search, considered, formed, on_bound, pruned, shaped
from fleetlog.discovery.search.joint import Joint, Size, refit, scored, size_of, tightened, tuned, verified
from fleetlog.discovery.search.problem import Problem
from fleetlog.discovery.search.ridge import Sums
from fleetlog.discovery.search.scopes import narrowed, scoped, stood_out, trips_agree


def search(problem: Problem, nominal: Model) -> Search:
    """Explain a channel."""
    base = refit(problem, nominal, [])
    found = Search(base, base)
    while len(found.joint.chosen) < problem.settings.most_findings:
        now, better = _step(problem, found, problem.rest)
        if better is None:
            if now.chosen != found.joint.chosen:
                found.joint = refit(problem, found.joint.model, now.chosen)
            if (one := finish.one_for_several(problem, found) or finish.two_for_one(problem, found)) is None:
                break
            found.joint = one
            continue
        if problem.learn_anew(better.model, better.chosen, float(better.losses.sum())):
            # Rivals that noise seemed to hide are told apart now: what predicts best is kept.
            found.joint = refit(problem, found.joint.model, found.joint.chosen)
            both = [j for j in (better, _step(problem, found, found.near)[1]) if j is not None]
            better = min((refit(problem, j.model, j.chosen) for j in both), key=lambda j: j.score)
        found.joint = better
    found.joint = finish.two_for_one(problem, found, fields=True) or found.joint
    return shaped(problem, pruned(problem, found))


def _step(problem: Problem, found: Search, rest: Chosen) -> tuple[Joint, Joint | None]:
    """Return the model as it fits best, and with the best of some added, None where none is worth it."""
    found.slight = None
    sums = problem.sums(found.joint.model, list(dict.fromkeys([*rest, *found.joint.chosen])))
    now = tuned(problem, sums, found.joint.model, found.joint.chosen)
    screened = screen(problem, sums, now, _candidates(problem, sums, now, rest))
    screened = sorted([*screened, *scoped(problem, now, screened)], key=lambda s: -s.gain)
    near = {s.hypothesis.alike for s in screened if s.gain > NUMBERS * screened[0].gain}
    found.near = tuple(h for h in rest if h.alike in near)
    if found.best_untold is None and screened:
        found.best_untold = screened[0].hypothesis
    worth = [s for s in screened if _significant(problem, now, s)]
    better = _best(problem, sums, now, found, screened, worth)
    # What gains most may be spread thinly over the site, and not count; waits gain less, at few places.
    waits = [s for s in worth if s.hypothesis.waits]
    better = better or (_best(problem, sums, now, found, screened, waits) if waits else None)
    # Free values of places may be what a field of a part of the time says.
    if better is None or (better.chosen[-1].term is None and better.chosen[-1].places):
        timed = _at_times(problem, now, found)
        better = min((j for j in (better, timed) if j is not None), key=lambda j: j.score, default=None)
    return now, better


def _at_times(problem: Problem, now: Joint, found: Search) -> Joint | None:
    """Return the model with the best field of a part of the time; over all of it, trips disagree on it.
    Where nobody passes the place at other times, the time is not told: nothing speaks for it."""
    if not (fields := stood_out(problem, now)):
        return None
    sums = problem.sums(now.model, [*now.chosen, *fields])
    now = scored(problem, sums, now.model, now.chosen)
    shapes = [p for h in fields for p in pattern_hypotheses(problem, sums, now, h)]
    screened = screen(problem, sums, now, [*fields, *shapes])
    worth = [s for s in screened if _significant(problem, now, s)]
    if (better := _best(problem, sums, now, found, screened, worth)) is None:
        return None
    always = refit(problem, now.model, [*better.chosen[:-1], better.chosen[-1].of(FLEET)], 2)
    if always.score - better.score > problem.settings.evidence and trips_agree(problem, always, better):
        return better
    found.rivals[always.chosen[-1].kind] = found.rivals[better.chosen[-1].kind]
    return always if now.score - always.score > problem.settings.evidence else None


def _best(
    problem: Problem, sums: Sums, now: Joint, found: Search, screened: list[Screened], worth: list[Screened]
) -> Joint | None:
    """Return the model with the best of some hypotheses added, None where none of them counts."""
    best = max((s.gain for s in worth), default=np.inf)
    near = [s for s in worth if s.gain > (NUMBERS if s.hypothesis.knobs else OTHERS) * best]
    # What is not evident, but so near to the best that evidence does not part them: rivals, and no more.
    told = {s.hypothesis for s in worth}
    close = [s for s in screened if s.gain > best - problem.settings.evidence and s.hypothesis not in told]
    rivals = [_whole(s.hypothesis, now.chosen)[0] for s in close]
    beside = dict(_whole(s.hypothesis, s.beside or now.chosen) for s in (*near, *close))
    taken = {k for h in now.chosen for k in h.knobs}

    def more(several: list[Hypothesis]) -> dict[Hypothesis, Chosen]:
        return {h: now.chosen for h in several if h not in beside and h.knobs[0] not in taken}

    # A number of trucks on edges gains what the edges cost, if no more. Of travel times drivers differ more.
    apart = problem.channel.bends and (not worth or now.fitted.penalty > NUMBERS * best)
    beside |= more(_on_edge(problem, now, apart))
    tried = _exact(problem, sums, now, beside)
    said = [j for j in tried if j.chosen[-1].knobs]
    whose = min(said, key=lambda j: j.score).chosen[-1].scope if said else FLEET
    if whose.vehicles and not whose.timed:  # What is said of some trucks may be any number of theirs
        tried += _exact(problem, sums, now, more(finish.numbers_of(problem, whose)))
    slow = {s.hypothesis.kind: s for s in screened if s.hypothesis.slow}
    tried = [_no_better_than(problem, sums, now, j, tried, slow) for j in tried]
    ranked = sorted(tried, key=lambda j: j.score)
    slight: list[tuple[Joint, Size]] = []
    counting = _counting(problem, sums, now, ranked, rivals, slight)
    first = next(counting, None)
    small = [(j.chosen[-1], size) for j, size in slight]
    # Unseen trips confirm little of a number that the tolerances of others, all together, say as well.
    large = {h for h, s in small if h.knobs and h.scope.whole and s.share >= problem.settings.material}
    noted = [(h, s.share) for h, s in small if h in large or finish.counts(problem, h, s, 0.0)]
    found.slight = max(noted, key=lambda one: one[1], default=found.slight)
    if first is not None and first.chosen[-1].term is None:
        # What the names say of places goes first: free time by place takes up all of it, and what no name
        # says.  Elsewhere one goes first of two that the model's own error may exchange for the curve.
        most, own = MOST if first.chosen[-1].places else HALF, problem.channel.model_error
        reach = now.score - most * (now.score - first.score)
        name = next((j for j in counting if j.chosen[-1].term and j.score < reach), None)
        if name is not None and (first.chosen[-1].places or verified(_of_two(problem, name), first) < own):
            first = name
        elif numbers := [j for j in ranked if j.chosen[-1].knobs and _repeats(problem, sums, now, first, j)]:
            first = numbers[0]  # Both count or neither, and the curve does
    if first is not None:
        first, ranked = _timed(problem, now, first, ranked)
        found.rivals[first.chosen[-1].kind] = considered(problem, now, first, ranked)
    return first


def _whole(h: Hypothesis, chosen: Chosen) -> tuple[Hypothesis, Chosen]:
    """A hypothesis, and those beside it: a term's field takes the place of its shapes, and is told once."""
    own = [c for c in chosen if h.placed and h.term and c.term == h.term]
    shapes = [p for c in own for p in c.patterns if h.patterns]
    return replace(h, patterns=(*shapes, *h.patterns)), tuple(c for c in chosen if c not in own)


def _of_two(problem: Problem, name: Joint) -> Joint:
    """A model with the number beside it that predicts best."""
    sums = problem.sums(name.model, [*problem.rest, *name.chosen])
    numbers = tuple(h for h in problem.rest if h.knobs)
    screened = screen(problem, sums, name, _candidates(problem, sums, name, numbers))
    tried = [*(s.hypothesis for s in screened[:SECOND]), *_on_edge(problem, name)]
    more = _exact(problem, sums, name, dict.fromkeys(tried, name.chosen))
    return min([name, *more], key=lambda j: j.score)


def _counting(
    problem: Problem, sums: Sums, now: Joint, ranked: list[Joint], rivals: list[Hypothesis],
    slight: list[tuple[Joint, Size]],
) -> Iterator[Joint]:  # fmt: skip
    """Yield what may be added to the model, in the order in which it may; ``rivals`` may not. What does not
    count goes to ``slight``."""
    worth = [j for j in ranked if j.chosen[-1] not in rivals]
    own, least = problem.channel.model_error, problem.settings.material
    curves = [o for o in ranked if o.chosen[-1].curve]
    sizes = {o.chosen[-1]: size_of(problem, now, o) for o in curves if verified(now, o) >= own}
    told = {h for h, size in sizes.items() if finish.counts(problem, h, size, least)}
    untold = [o for o in curves if o.chosen[-1] not in told]
    for joint in _by_simplicity(problem, worth):
        if now.score - joint.score < problem.settings.evidence or on_bound(problem, joint):
            continue
        # Nor are simpler shapes told of a field that stands out beside junctions, and says far more.
        alike = [o for o in worth if o.chosen[-1].term == joint.chosen[-1].term and o.score <= joint.score]
        more = [o for o in alike if o is joint or now.score - joint.score < MOST * (now.score - o.score)]
        if finish.is_flat(problem, sums, joint) or any(finish.at_junctions(problem, now, o) for o in more):
            continue
        # Nor is a number of a part, where the same number says it better of all.
        h = joint.chosen[-1]
        of_all = [o for o in worth if h.knobs and o.chosen[-1].knobs == tuple(k.fleet for k in h.knobs)]
        if not h.scope.whole and any(o.score < joint.score for o in of_all):
            continue
        if any(_follows(problem, sums, now, joint, o) for o in ranked):
            continue
        # A number that repeats a curve which says twice as much, and is too slight to be told, is so as well,
        # but where it changes more than the model's own error does: of the curve tolerances say a part.
        size = sizes.get(h) or size_of(problem, now, joint)
        small = bool(h.knobs) and size.share < problem.channel.place_error
        twice = [o for o in untold if small and now.score - joint.score < HALF * (now.score - o.score)]
        if any(_repeats(problem, sums, now, joint, o) for o in twice):
            continue
        if not finish.counts(problem, h, size, least):
            slight.append((joint, size))
            continue
        # What is too slight as a name says it is no more as free values by place, which say it less well.
        named = [o for o, _ in slight if o.chosen[-1].placed]
        if not (joint.chosen[-1].places and any(o.score < joint.score for o in named)):
            yield joint


def _follows(problem: Problem, sums: Sums, now: Joint, joint: Joint, other: Joint) -> bool:
    """Whether a hypothesis mostly repeats what another says at least as well: places a curve over a recorded
    state, as a few numbers are simpler than one for every road; and a number, be it of a part, one of all
    that is far likelier."""
    h, o = joint.chosen[-1], other.chosen[-1]
    # An even slope of the site is two numbers, where a curve over the heading is eight.
    at_places = h.placed and o.curve is not None and not 0 < len(h.patterns) < o.curve.width
    numbers = h.knobs and o.knobs and o.scope.whole and not {k.fleet for k in h.knobs} & {*o.knobs}
    margin = problem.settings.evidence * (1.0 if at_places else -1.0)
    return bool(at_places or numbers) and _repeats(problem, sums, now, joint, other, margin)


def _repeats(
    problem: Problem, sums: Sums, now: Joint, joint: Joint, other: Joint, margin: float = 0.0
) -> bool:
    """Whether a hypothesis mostly repeats another, plausible one that is no worse by more than a margin."""
    if other.score >= joint.score + margin or on_bound(problem, other):
        return False
    both = refit(problem, now.model, [*other.chosen, joint.chosen[-1]], 1, sums)
    return other.score - both.score < OWN * (now.score - joint.score)


def _timed(problem: Problem, now: Joint, joint: Joint, ranked: list[Joint]) -> tuple[Joint, list[Joint]]:
    """The new field limited to a part of the time, where that is more likely; its rivals then are, too."""
    if (timed := _in_its_time(problem, now, joint)) is None:
        return joint, ranked
    others = [_in_its_time(problem, now, j) or j for j in ranked if j is not joint]
    ranked = sorted([timed, *others], key=lambda j: j.score)
    likely = [j for j in ranked if j.chosen[-1].when.timed and not on_bound(problem, j)]
    return next(iter(_by_simplicity(problem, likely)), timed), ranked


def _in_its_time(problem: Problem, now: Joint, joint: Joint) -> Joint | None:
    timed = joint
    # Twice: a field of all the time is too even, and what it says of other places blurs where its time ends.
    for _ in range(2):
        if (h := narrowed(problem, now, timed)) is None or h.when == timed.chosen[-1].when:
            break
        timed = refit(problem, now.model, [*joint.chosen[:-1], h], 2)
    evident = joint.score - timed.score > problem.settings.evidence
    return timed if evident and trips_agree(problem, joint, timed) else None


NOTHING = 0.01  # Share of the largest gain of a fold up to which a fold has nothing to say
SEVERAL = 7  # Folds that speak for it, each a little, that are as good as a few that are evident
MOST = 0.7  # Share of what speaks for free time by place that a name must reach to go before it
HALF = 0.5  # The same of a curve, of the one of two names that says more
EDGE = 0.5 * CERTAIN**2  # What a number on the edge of its tolerance costs [nat]
SECOND = 3  # Numbers that are tried beside a name
NUMBERS, OTHERS = 0.1, 0.3  # Of the best gain, to be fitted exactly: a number's linear gain may be too small


def _no_better_than(
    problem: Problem, sums: Sums, now: Joint, joint: Joint, tried: list[Joint],
    slow: dict[Hypothesis, Screened],
) -> Joint:  # fmt: skip
    """A slow number gains less by what stretches of hours that it has not seen say less for it than trips.
    One of a part, and a curve, gain no more than on those stretches, and numbers of the same time gain less
    by as much: how loosely the model holds what they change is no difference between them."""
    h = joint.chosen[-1]
    if h.kind in slow and h.knobs and h.scope.whole:
        less = max(s.gain for s in gained(problem, sums, now, [h])) - slow[h.kind].gain
    else:
        same = [j for j in tried if h.knobs and h.scope.timed and j.chosen[-1].scope == h.scope] or [joint]
        alike = [(now.score - j.score, slow[k].gain) for j in same if (k := j.chosen[-1].kind) in slow]
        less = max(seen for seen, _ in alike) - max(unseen for _, unseen in alike) if alike else 0.0
    if less <= 0.0:  # Hours that say more than trips make no loss smaller.
        return joint
    return replace(joint, score=joint.score + less, losses=joint.losses + less / len(joint.losses))


def _candidates(problem: Problem, sums: Sums, now: Joint, rest: Chosen) -> list[Hypothesis]:
    """Those of hypotheses that may be added to the model, places in simple shapes among them."""
    knobs = {k for h in now.chosen for k in h.knobs}
    taken = {h.kind for h in now.chosen}
    times = {h.term: h.when for h in now.chosen if h.when.timed}
    joints = [now, *(scored(problem, sums, now.model, chosen) for chosen in tightened(now.chosen)[1:])]
    out = []
    for h in (replace(h, when=times.get(h.term, h.when)) for h in rest):
        if h not in taken and not set(h.knobs) & knobs:
            out.append(h)
            if h.field and h.term:
                out += [p for joint in joints for p in pattern_hypotheses(problem, sums, joint, h)]
    return list(dict.fromkeys(out))


def _significant(problem: Problem, now: Joint, s: Screened) -> bool:
    """Whether what speaks for a hypothesis is beyond chance, and beyond the model's own error."""
    # Folds without a passage of the place say nothing; others may differ, where each is evident by itself.
    settings, known = problem.settings, np.abs(s.by_fold)
    told = s.by_fold[known > NOTHING * known.max()]
    spread = told.std(ddof=1) / np.sqrt(len(told)) if len(told) > 2 else np.inf
    # Half of what chance says is against it: that none of seven is happens less than once in a hundred times.
    each = len(told) > 1 and told.min() > (settings.evidence if len(told) < SEVERAL else 0.0)
    if s.gain < settings.evidence or not (each or told.mean() > settings.consistency * spread):
        return False
    size, h = np.sqrt(max(float(s.by_fold.sum()), 0.0) / max(now.energy, 1e-12)), s.hypothesis
    in_part = h.placed or not h.scope.whole  # It may touch some places, trucks, or hours only
    return size > 0.5 * problem.channel.model_error or h.term is not None or in_part


def _on_edge(problem: Problem, now: Joint, apart: bool = False) -> list[Hypothesis]:
    """Numbers of the truck file that stand on the edge of their tolerance: they may lie beyond it; and those
    of trucks ``apart``, half of them at most, that stand on the same edge of what trucks differ by."""
    fitted = [(a, b) for a, b in zip(now.design.atoms, now.fitted.beta, strict=True) if a.owner is None]
    # What caps a speed and does nothing is on no edge.
    on = [(a.knob, b >= a.high) for a, b in fitted if a.knob and not a.low < b < a.high]
    edges = {k: high for k, high in on if high or not k.definition.caps}
    out, half = [], (len(problem.channel.fleet.vehicles) + 1) // 2
    for h in finish.numbers_of(problem, FLEET):
        out += [h] if h.knobs[0] in edges else []
        own = [(on, k.scope.vehicles) for k, on in edges.items() if k.fleet == h.knobs[0]]
        sides = (tuple(sorted(chain(*(v for on, v in own if on == high)))) for high in (False, True))
        out += [h.of(Scope(who)) for who in sides if apart and 0 < len(who) <= half]
    return out


def _exact(problem: Problem, sums: Sums, now: Joint, worth: dict[Hypothesis, Chosen]) -> list[Joint]:
    """The best few, each beside its model, fitted exactly: of every term the best form."""
    short: list[Joint] = []
    seen: dict[object, int] = {}
    for h, beside in worth.items():
        part = "timed" if h.scope.timed else "truck" if h.scope.one is not None else "kind"
        kind = "fleet" if h.scope.whole else part
        key = (h.term, kind, len(h.knobs)) if h.term else "free"
        several = h.term is None or (h.physics is not None and h.physics.field)
        most = 3 if several else 2 if kind in ("timed", "kind") else 1
        if seen.get(key, 0) < most and (key in seen or len(seen) < problem.settings.shortlist or h.knobs):
            seen[key] = seen.get(key, 0) + 1
            chosen = formed(problem, sums, now.model, (*beside, h), h)
            short.append(refit(problem, now.model, chosen, 2 if h.term else 1, sums))
    return short


def _by_simplicity(problem: Problem, ranked: list[Joint]) -> list[Joint]:
    """The candidates in the order in which they may be taken: the simplest of those that the model's own
    error may exchange. That error is alike in all trucks and hours, so between a part of them and all of them
    evidence decides."""
    part = min((j.score for j in ranked if not j.chosen[-1].scope.whole), default=np.inf)

    def order(j: Joint) -> tuple[int, float]:
        """Numbers before places before fields before free curves; last what is not equal to the best. What
        the truck model has is wrong rather than something left out where both say the same, beside what the
        number of the truck file costs on the edge of its tolerance."""
        h = j.chosen[-1]
        behind = h.scope.whole and j.score - part > problem.settings.evidence
        last = behind or verified(j, ranked[0]) >= problem.channel.model_error
        of_numbers = bool(h.scope.vehicles) + h.scope.timed
        kind = of_numbers if h.knobs else 3 if h.patterns else 4 if h.field and h.term else 5
        return 6 if last else kind, j.score - EDGE * bool(h.knobs and h.physics and h.physics.nominal)

    return sorted(ranked, key=order)
