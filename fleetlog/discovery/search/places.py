"""Where on the roads: the stretches over which a field stands out, found in the sums, one after the other."""

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.discovery.hypotheses.cells import Stretches
from fleetlog.discovery.hypotheses.hypothesis import Hypothesis, Pattern
from fleetlog.discovery.recording.turns import REACH
from fleetlog.discovery.search.beside import beside
from fleetlog.discovery.search.design import of_hypothesis
from fleetlog.discovery.search.joint import Joint
from fleetlog.discovery.search.problem import Problem
from fleetlog.discovery.search.ridge import Sums

MOST_PATTERNS = 6


def pattern_hypotheses(problem: Problem, sums: Sums, joint: Joint, h: Hypothesis) -> list[Hypothesis]:
    """Return simple shapes of a field: an even slope of the site, one stretch of road, two, and so on."""
    cells = problem.channel.cells(h.physics)
    out = []
    if cells.odd:
        even = tuple(Pattern(d.tobytes(), "whole site") for d in cells.directions())
        out.append(Hypothesis(h.term, patterns=even))
    if isinstance(cells, Stretches):
        found = _stretches(problem, sums, joint, h, cells)
        out += [Hypothesis(h.term, patterns=tuple(found[: i + 1])) for i in range(len(found))]
    return out


def _stretches(problem: Problem, sums: Sums, joint: Joint, h: Hypothesis, cells: Stretches) -> list[Pattern]:
    assert h.physics is not None
    moment, product = _by_cell(problem, sums, joint, h)
    evident = 2.0 * problem.noise.design * (problem.settings.parameter + 5.0)
    passes = problem.channel.passes(h.physics)
    share = passes / max(float(passes.sum()), 1.0)
    material = max(problem.settings.material, problem.channel.model_error) ** 2 * sums.energy
    plausible = h.physics.parameters[0].plausible
    # What is near a junction alone is not told from how the junction is crossed; but waits are often there.
    near = 0.0 if h.physics.acts == "wait" else REACH
    found: list[Pattern] = []
    while len(found) < MOST_PATTERNS:
        best, first, last = max(
            (_best(moment, product, plausible, near, cells, *road) for road in cells.roads()),
            key=lambda b: b[0],
        )
        if best < max(evident, material * float(share[first:last].sum())):
            break
        pattern = np.zeros(len(cells))
        pattern[first:last] = 1.0
        found.append(Pattern(pattern.tobytes(), cells.label(first, last)))
        # The next is what this one leaves.
        along = product @ pattern
        size = float(pattern @ along)
        moment = moment - along * float(pattern @ moment) / size
        product = product - np.outer(along, along) / size
    return found


def _by_cell(problem: Problem, sums: Sums, joint: Joint, h: Hypothesis) -> tuple[Floats, Floats]:
    """(C,) moments and (C, C) products of the cells beside the model: columns are in the prior's basis."""
    own = of_hypothesis(problem.channel, sums.layout, joint.model, h)
    left = next(model.left(columns) for model, columns in beside(joint, sums, [own]))
    back = problem.channel.cells(h.physics).inverse
    return back.T @ left.moment, back.T @ left.product @ back


def _best(
    moment: Floats, product: Floats, plausible: tuple[float, float], near: float, cells: Stretches,
    first: int, last: int,
) -> tuple[float, int, int]:  # fmt: skip
    """The run of cells of a road whose common value, a plausible one, explains most: twice the gain in
    likelihood, its ends.  A part of the road that is no longer than ``near`` [m] and at its end is none."""
    n = last - first
    u = np.concatenate([[0.0], np.cumsum(moment[first:last])])
    d = np.zeros((n + 1, n + 1))
    d[1:, 1:] = np.cumsum(np.cumsum(product[first:last, first:last], axis=0), axis=1)
    i, j = np.triu_indices(n + 1, 1)
    size = d[j, j] - d[i, j] - d[j, i] + d[i, i]
    own = np.trace(product) / len(product)
    along = u[j] - u[i]
    value = np.clip(along / np.maximum(size, 1e-12), *plausible)
    brief = (cells.end[first + j - 1] - cells.start[first + i] < near) & ((i == 0) != (j == n))
    told = (size > 1e-3 * own) & ~brief
    gain = np.where(told, value * (2.0 * along - value * size), 0.0)
    # Of runs that say the same the shortest: cells that nothing touches belong to none.
    k = int(np.argmax(gain - 1e-6 * gain.max() * (j - i)))
    return float(gain[k]), first + int(i[k]), first + int(j[k])
