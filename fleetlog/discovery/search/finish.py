"""What the search has found, what of it may count, and its last form: the needless dropped, shapes set."""

from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from fleetlog.discovery.hypotheses.cells import LARGE, Stretches
from fleetlog.discovery.hypotheses.hypothesis import Chosen, Hypothesis
from fleetlog.discovery.model import FLEET, Model, Scope, field_values
from fleetlog.discovery.recording.turns import REACH
from fleetlog.discovery.search.beside import pattern_hypotheses, screen
from fleetlog.discovery.search.joint import SHARES, Joint, Size, refit, scored, size_of, tuned, verified
from fleetlog.discovery.search.problem import Problem
from fleetlog.discovery.search.ridge import Sums
from fleetlog.discovery.search.scopes import ended

OWN = 0.5  # Share of what speaks for places that must be their own, beside a curve or junctions
FEW = 3  # Curves that are tried in the place of several others
BY_CHANCE = 0.05  # Share of a field, by its squares, that may be implausible: one value in twenty is, of 95 %


@dataclass(frozen=True)
class Rival:
    """What was considered in place of a finding: by how much less speaks for it, in natural logarithms."""

    hypothesis: Hypothesis
    behind: float
    share: float  # Share of the finding's gain on unseen trips that it reaches


@dataclass
class Search:
    """What the search came to: the ``joint`` model, the ``base`` without findings, and rivals of each."""

    base: Joint
    joint: Joint
    rivals: dict[Hypothesis, list[Rival]] = field(default_factory=dict)
    best_untold: Hypothesis | None = None
    near: Chosen = ()  # What gained no less than a share of the best in the last step
    slight: tuple[Hypothesis, float] | None = None  # What was not added as it moves no more than this share


def on_bound(problem: Problem, joint: Joint, h: Hypothesis | None = None) -> bool:
    """Whether a hypothesis, by default the last, needs an implausible number."""
    h = h or joint.chosen[-1]
    pairs = zip(joint.design.atoms, joint.fitted.beta, strict=True)
    if any(a.owner == h and not ((a.ends or a.low < b) and b < a.high) for a, b in pairs):
        return True
    if not (h.patterns or h.field) or h.term is None or h.physics is None:
        return False
    first, deviation = h.physics.parameters[0], joint.model.fields[h.term]
    value, weight = field_values(first, deviation), problem.channel.passes(h.physics) * deviation**2
    return bool(weight[(value <= first.low) | (value >= first.high)].sum() > BY_CHANCE * weight.sum())


def is_flat(problem: Problem, sums: Sums, joint: Joint) -> bool:
    """Whether the values of a curve say no more than that they are not zero: it follows nothing."""
    own = joint.chosen[-1]
    if own.curve is None or own.curve.harmonics or own.curve.width < 2:
        return False
    mine = np.array([a.owner == own for a in joint.design.atoms])
    gram = joint.design.normal(sums).gram.sum(axis=0)[np.ix_(mine, mine)]
    value = joint.fitted.beta[mine]
    differs = value - gram.sum(axis=0) @ value / max(float(gram.sum()), 1e-300)
    told = float(differs @ gram @ differs) / (2.0 * problem.noise.design)
    return bool(told < problem.settings.evidence + value.size / 2.0)  # Noise alone says half of one for each


def at_junctions(problem: Problem, now: Joint, joint: Joint) -> bool:
    """Whether a field stands out mostly beside junctions, as no pattern may, and the rest does not count:
    there it is not told from how they are crossed, nor from where within them another effect begins."""
    h, term = joint.chosen[-1], joint.chosen[-1].physics
    cells = problem.channel.cells(term) if term is not None and h.field and not h.waits else None
    if term is None or not isinstance(cells, Stretches):
        return False
    passes = problem.channel.passes(term)
    deviation = np.where(passes > 0, joint.model.fields[term.name], 0.0)
    large = np.abs(deviation) >= LARGE * np.abs(deviation).max(initial=0.0)
    weight = passes * deviation**2 * large
    kept = weight[cells.inner(large, np.sign(deviation), REACH)].sum() / max(float(weight.sum()), 1e-12)
    rest = size_of(problem, now, joint).verified * np.sqrt(kept) if kept < OWN else np.inf
    return bool(rest < problem.channel.place_error)


def counts(problem: Problem, h: Hypothesis, size: Size, material: float) -> bool:
    """Whether an effect is material, and beyond the model's own error by what unseen trips confirm of it."""
    if h.placed:
        return size.verified >= problem.channel.place_error
    own = problem.channel.error_of(h.scope)
    if not h.knobs:
        return size.share >= max(material, own) and size.verified >= own
    # Tolerances may say most of a number, so that unseen trips confirm a small part of a large effect; of a
    # false number they confirm a small part of a small one.  An error that is alike in all trucks and hours
    # takes nothing away between them.
    between = not h.scope.whole and not any(h.scope.covers(v) for v in problem.channel.unsteady)
    return size.share >= material and (between or size.share * size.verified >= own**2)


def pruned(problem: Problem, found: Search) -> Search:
    """Drop what is not needed beside the rest, or is implausible beside it: one number of two, or all."""
    while len(found.joint.chosen) > 1 or any(_singles(h) for h in found.joint.chosen):
        shorter = {h: _shorter(problem, found, h) for h in found.joint.chosen}
        best = min(shorter.values(), key=lambda j: j.score)
        bound = [j for h, j in shorter.items() if on_bound(problem, found.joint, h)]
        if best.score - found.joint.score > problem.settings.evidence and not bound:
            break
        # What is implausible may be so only beside another, which then is the one to go.
        plausible = [j for j in shorter.values() if not any(on_bound(problem, j, h) for h in j.chosen)]
        found.joint = min((plausible if bound else []) or bound or [best], key=lambda j: j.score)
    return found


def _singles(h: Hypothesis) -> list[Hypothesis]:
    """The single numbers of a pair that may stand alone."""
    alone = len(h.knobs) > 1 and h.physics is not None and not h.physics.vector
    return [replace(h, knobs=(k,)) for k in h.knobs] if alone else []


def _shorter(problem: Problem, found: Search, h: Hypothesis) -> Joint:
    """The best fit without a hypothesis, or with one number of it alone that is plausible."""
    tried = [_without(problem, found.joint, h)] if len(found.joint.chosen) > 1 else []
    for part in _singles(h):
        found.rivals[part.kind] = found.rivals.get(h.kind, [])
        model = found.joint.model.without({*h.knobs} - {*part.knobs}, set())
        left = refit(problem, model, [part if c is h else c for c in found.joint.chosen], 2)
        tried += [left] if not tried or not on_bound(problem, left, part) else []
    return min(tried, key=lambda j: j.score)


def _without(problem: Problem, joint: Joint, dropped: Hypothesis) -> Joint:
    """The fit without one hypothesis; of the others those with shapes are scanned anew, and set. A threshold
    that was set beside it may be another alone."""
    left = refit(problem, joint.without(dropped), [c for c in joint.chosen if c is not dropped], steps=2)
    for h in [h for h in left.chosen if h.setting]:
        if forms := _forms(problem, h):
            model = left.without(h)
            chosen = formed(problem, problem.sums(model, [*left.chosen, *forms]), model, left.chosen, h)
            left = min(left, refit(problem, model, chosen, steps=2), key=lambda j: j.score)
        left, _ = _set(problem, left, next(c for c in left.chosen if (c.term, c.knobs) == (h.term, h.knobs)))
    return left


def shaped(problem: Problem, found: Search) -> Search:
    """Set shapes between the values that were scanned, in halved steps, as long as that predicts better, and
    give even slopes of stretches the shape of a field where that does. Simple shapes go first where a name is
    looked for; but roads begin to climb gradually: an even slope in their place is too short and steep."""
    for h in found.joint.chosen:
        if h not in found.joint.chosen:  # A field has taken its place.
            continue
        joint, own = _set(problem, found.joint, h)
        if h.patterns and h.physics is not None and h.physics.odd:
            whole = replace(h, patterns=(), field=True)
            joint, own = _swapped(problem, joint, h, whole, problem.settings.evidence)
        if own.scope.timed and not own.scope.drift:
            joint, own = _swapped(problem, joint, own, ended(problem, joint, own), 0.0)
        found.joint = joint
        if own != h:
            found.rivals[own.kind] = found.rivals.pop(h.kind, [])
    return found


def _set(problem: Problem, joint: Joint, own: Hypothesis) -> tuple[Joint, Hypothesis]:
    """The fit with the shape parameters of a hypothesis between the values that were scanned."""
    for near in (n for share in (0.5, 0.25, 0.125) for n in own.nearby(share)):
        joint, own = _swapped(problem, joint, own, near, 0.0)
    return joint, own


def _swapped(
    problem: Problem, joint: Joint, own: Hypothesis, other: Hypothesis, least: float
) -> tuple[Joint, Hypothesis]:
    """Put one hypothesis in the place of another if that predicts better; and return the one that stands."""
    chosen, model = [other if c is own else c for c in joint.chosen], joint.without(own)
    if other.field:  # For all stretches of its term, about the model as it is, at the variance that fits best
        chosen = [c for c in chosen if c is other or c.term != other.term]
        model, sums = joint.model, problem.sums(joint.model, chosen)
        chosen = list(tuned(problem, sums, model, chosen).chosen)
    tried = refit(problem, model, chosen, 2)
    if joint.score - tried.score <= least:
        return joint, own
    return tried, next(c for c in chosen if c.kind == other.kind)


def formed(problem: Problem, sums: Sums, model: Model, chosen: Chosen, h: Hypothesis) -> Chosen:
    """The same with one of them in the shape that fits best when all others give way to it."""
    forms = _forms(problem, h)
    if len(forms) < 2:
        return chosen
    if not sums.layout.holds(problem.layout([*chosen, *forms])):
        sums = problem.sums(model, [*chosen, *forms])
    fits = (scored(problem, sums, model, [f if c is h else c for c in chosen]) for f in forms)
    return min(fits, key=lambda j: j.score).chosen


def _forms(problem: Problem, h: Hypothesis) -> list[Hypothesis]:
    """The shapes of a hypothesis that are scanned."""
    return [f for f in problem.rest if f.setting and (f.term, f.knobs) == (h.term, h.knobs)]


def one_for_several(problem: Problem, found: Search) -> Joint | None:
    """Return the fit with a free curve in the place of several others (of all numbers, or of all that is of a
    part of the time) that predicts better than they do: they may outline what none of them is."""
    now = found.joint
    for several in ([h for h in now.chosen if h.scope.timed], [h for h in now.chosen if h.knobs]):
        if len(several) < 2:
            continue
        kept = [h for h in now.chosen if h not in several]
        knobs = {k for h in several for k in (*h.knobs, *h.shapes)}
        fields = {h.term for h in several if h.placed and h.term} - {h.term for h in kept}
        left = refit(problem, now.model.without(knobs, fields), kept)
        curves = [h for h in problem.rest if h.curve is not None]
        sums = problem.sums(left.model, [*kept, *curves])
        tried = []
        for s in screen(problem, sums, left, curves)[:FEW]:
            joint = refit(problem, left.model, [*kept, s.hypothesis], 1, sums)
            tried.append(replace(joint, score=max(joint.score, left.score - s.gain)))
        evidence, likely = problem.settings.evidence, min((j.score for j in tried), default=np.inf)
        near = [j for j in tried if j.score - likely < evidence and now.score - j.score > evidence]
        if best := min(near, key=lambda j: len(j.chosen[-1].depends_on), default=None):
            found.rivals[best.chosen[-1].kind] = considered(problem, left, best, tried)
            return best
    return None


def numbers_of(problem: Problem, scope: Scope) -> list[Hypothesis]:
    """Return the numbers of the truck file, of some trucks or all."""
    file = problem.channel.adjustable()
    return [h.of(scope) for h in problem.rest if len(h.knobs) == 1 and h.knobs[0] in file]


def two_for_one(problem: Problem, found: Search, *, fields: bool = False) -> Joint | None:
    """Return the fit with two in the place of one that outlines both, or beside all as they hide one another:
    two numbers of the truck file, which predict better; or, of a field of all roads, one and simple shapes,
    if it says no more than the model's own error may exchange for them."""
    now, taken = found.joint, {k for h in found.joint.chosen for k in h.knobs}
    others = [h for h in numbers_of(problem, FLEET) if h.knobs[0] not in taken]
    single = [h for h in now.chosen if h.knobs and h.scope.whole]
    for h in [c for c in now.chosen if c.field and c.term and not c.waits] if fields else [None, *single]:
        rest = [c for c in now.chosen if c is not h]
        left = refit(problem, now.without(h), rest) if h else now
        sums = problem.sums(left.model, [*rest, *others, *((h,) if h and fields else ())])
        pairs = [] if fields else list(combinations(others, 2))
        for number, whole in ((n, h) for n in others if h and fields):
            alone = scored(problem, sums, left.model, [*rest, number])
            pairs += [(number, s) for s in pattern_hypotheses(problem, sums, alone, whole)]
        if not (tried := [scored(problem, sums, left.model, [*rest, *two], SHARES[:1]) for two in pairs]):
            continue
        joint = refit(problem, left.model, min(tried, key=lambda j: j.score).chosen, 2)
        both, plausible = joint.chosen[-2:], not any(on_bound(problem, joint, c) for c in joint.chosen)
        likelier = plausible and not fields and now.score - joint.score > problem.settings.evidence
        confirmed = likelier and all(_confirmed(problem, joint, c) for c in both)
        if plausible and (verified(joint, now) < problem.channel.model_error if fields else confirmed):
            found.rivals |= {c.kind: found.rivals.get(h.kind, []) if h else [] for c in both}
            return joint
    return None


def _confirmed(problem: Problem, joint: Joint, h: Hypothesis) -> bool:
    """Whether unseen trips confirm a number beside the others of a fit by more than the model's own error: of
    two that hide one another each may be large, and say little."""
    last = replace(joint, chosen=(*(c for c in joint.chosen if c is not h), h))
    size, own = size_of(problem, _without(problem, joint, h), last), problem.channel.error_of(h.scope)
    return size.share >= problem.settings.material and size.verified >= own


def considered(problem: Problem, now: Joint, joint: Joint, ranked: list[Joint]) -> list[Rival]:
    """Return what was considered in the place of the last hypothesis of a fit, and is not the same."""
    out = []
    gained, own = float((now.losses - joint.losses).sum()), joint.chosen[-1]
    for other in ranked:
        h = other.chosen[-1]
        # A free curve that only repeats a name is no rival to it; one that repeats another curve is.
        same = (h.term, h.scope) == (own.term, own.scope) and (h.term or h.depends_on == own.depends_on)
        repeats = own.term and h.term is None and verified(joint, other) < problem.channel.error_of(own.scope)
        if same or repeats:
            continue
        share = float((now.losses - other.losses).sum()) / max(gained, 1e-12)
        out.append(Rival(h, other.score - joint.score, share))
    return out
