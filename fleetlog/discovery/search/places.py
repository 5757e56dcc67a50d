"""Where on the roads: the stretches over which a field stands out, found in the sums, one after the other."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.hypotheses.hypothesis import Hypothesis, Pattern, planes
from fleetlog.discovery.hypotheses.stretches import Stretches
from fleetlog.discovery.search.design import make_design
from fleetlog.discovery.search.joint import Joint
from fleetlog.discovery.search.problem import Problem
from fleetlog.discovery.search.sums import Sums

Floats = NDArray[np.float64]

MOST_PATTERNS = 6


@dataclass
class _Left:
    """What the residual says of every cell once the model in place is allowed for: (C,) moments and (C,
    C) products."""

    moment: Floats
    product: Floats

    def take(self, pattern: Floats) -> None:
        """Allow for one pattern."""
        along = self.product @ pattern
        size = float(pattern @ along)
        self.moment = self.moment - along * float(pattern @ self.moment) / size
        self.product = self.product - np.outer(along, along) / size


def pattern_hypotheses(problem: Problem, sums: Sums, joint: Joint, h: Hypothesis) -> list[Hypothesis]:
    """Return simple shapes of a field hypothesis: an even slope of the site, one stretch of road, two,
    and so on."""
    cells = problem.channel.cells(h.physics)
    assert cells is not None and h.physics is not None
    out = []
    even = planes(h.physics, cells)
    if even:
        out.append(Hypothesis(h.term, patterns=even))
    if isinstance(cells, Stretches):
        found = _stretches(problem, sums, joint, h, cells)
        out += [Hypothesis(h.term, patterns=tuple(found[: i + 1])) for i in range(len(found))]
    return out


def _stretches(problem: Problem, sums: Sums, joint: Joint, h: Hypothesis, cells: Stretches) -> list[Pattern]:
    assert problem.noise is not None and h.physics is not None
    left = _residual(problem, sums, joint, h, cells)
    evident = 2.0 * problem.noise.design * (problem.settings.parameter + 5.0)
    passes = problem.channel.passes(h.physics)
    share = passes / max(float(passes.sum()), 1.0)
    material = max(problem.settings.material, problem.channel.model_error) ** 2 * sums.energy
    found: list[Pattern] = []
    while len(found) < MOST_PATTERNS:
        best, first, last = max(
            (_best(left, first, last) for first, last in cells.roads()), key=lambda b: b[0]
        )
        if best < max(evident, material * float(share[first:last].sum())):
            break
        pattern = np.zeros(len(cells))
        pattern[first:last] = 1.0
        found.append(Pattern(pattern.tobytes(), cells.label(first, last)))
        left.take(pattern)
    return found


def _residual(problem: Problem, sums: Sums, joint: Joint, h: Hypothesis, cells: Stretches) -> _Left:
    """Moments and products of the cells themselves: the columns are in the basis of the prior."""
    assert h.physics is not None and problem.noise is not None
    design = make_design(problem.channel, sums.layout, joint.model, joint.chosen)
    columns = np.array(sums.layout.at(h.sources[0]))
    total = sums.fold.sum(axis=0)
    p = sums.layout.width
    fleet = [i for i, a in enumerate(design.atoms) if a.vehicle is None]
    basis = design._basis(fleet, p)
    prior = design.prior
    inner = basis.T @ (basis.T @ total[:p, :p]).T + np.diag(prior.precision[fleet] + 1e-9)
    cross = basis.T @ total[:p, columns]
    solved = np.linalg.solve(inner, np.column_stack([cross, basis.T @ total[:p, p]]))
    product = total[np.ix_(columns, columns)] - cross.T @ solved[:, :-1]
    moment = total[columns, p] - cross.T @ solved[:, -1]
    back = np.linalg.inv(cells.root(h.physics.odd))
    return _Left(back.T @ moment, back.T @ product @ back)


def _best(left: _Left, first: int, last: int) -> tuple[float, int, int]:
    """The run of cells of one road whose common value explains most: twice the gain in likelihood, and
    the run."""
    n = last - first
    u = np.concatenate([[0.0], np.cumsum(left.moment[first:last])])
    d = np.zeros((n + 1, n + 1))
    d[1:, 1:] = np.cumsum(np.cumsum(left.product[first:last, first:last], axis=0), axis=1)
    i, j = np.triu_indices(n + 1, 1)
    size = d[j, j] - d[i, j] - d[j, i] + d[i, i]
    own = np.trace(left.product) / len(left.product)
    gain = np.where(size > 1e-3 * own, (u[j] - u[i]) ** 2 / np.maximum(size, 1e-12), 0.0)
    # Of runs that say the same the shortest: cells that nothing touches belong to none.
    k = int(np.argmax(gain - 1e-6 * gain.max() * (j - i)))
    return float(gain[k]), first + int(i[k]), first + int(j[k])
