"""How well the numbers of a model are known: the covariance of a joint fit, trips being its independent
samples."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.search.joint import Joint
from fleetlog.discovery.search.problem import Problem

Floats = NDArray[np.float64]

NORMAL = 1.959964  # Standard errors on either side of which 95 % of a normal variable lies


@dataclass(frozen=True)
class Known:
    """``covariance`` (k, k) of the coefficients of a joint fit; zero for those on a bound."""

    joint: Joint
    covariance: Floats

    def errors(self) -> Floats:
        """Return the standard error of every coefficient, (k,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def intervals(problem: Problem, joint: Joint) -> Known:
    """Return the covariance of a fit (sandwich; Liang and Zeger 1986, doi 10.1093/biomet/73.1.13).

    The meat is the sum over trips of the squares of their scores; the prior's part scatters as the prior
    says.
    """
    assert joint.design is not None and joint.fitted is not None
    design, prior, beta = joint.design, joint.design.prior, joint.fitted.beta
    gram, meat, shift = _products(problem, joint)
    free = (beta > prior.low) & (beta < prior.high)
    bread = np.zeros_like(gram)
    inner = gram + np.diag(prior.precision)
    bread[np.ix_(free, free)] = np.linalg.pinv(inner[np.ix_(free, free)])
    covariance = problem.settings.widening**2 * (bread @ (meat + np.diag(prior.precision)) @ bread)
    # The model may be off by its own error in all windows alike: by so much all numbers move together.
    covariance += np.outer(bread @ shift, bread @ shift)
    # The model's own error differs from place to place, so each place may be off by it alone.
    placed = np.array([a.owner is not None and bool(a.owner.patterns) for a in design.atoms])
    covariance += np.diag(np.where(placed, np.diag(bread) * shift, 0.0) ** 2)
    return Known(joint, covariance)


def _products(problem: Problem, joint: Joint) -> tuple[Floats, Floats, Floats]:
    """The (k, k) products of the coefficients' columns, the squares of the trips' scores, and the (k,) scores
    that the model's own error makes."""
    assert joint.design is not None and problem.noise is not None
    layout = problem.layout(joint.chosen)
    k = len(joint.design.atoms)
    gram, total, clusters, shift = np.zeros((k, k)), np.zeros((k, k)), 0, np.zeros(k)
    for i, unit in problem.training():
        modelled, x = problem.channel.columns(unit, joint.model, layout.sources)
        own = joint.design.columns(x, unit.windows.vehicle)
        weighted = own * (problem.noise.weight(i, unit) * unit.whole)[:, None]
        gram += weighted.T @ own
        shift += weighted.T @ (problem.channel.model_error * np.abs(modelled))
        _, which = np.unique(problem.split.unit(unit.windows), return_inverse=True)
        sums = np.zeros((int(which.max()) + 1, k))
        np.add.at(sums, which, weighted * (unit.recorded - modelled)[:, None])
        total += sums.T @ sums
        clusters += len(sums)
    return gram, total * clusters / max(clusters - 1.0, 1.0), shift
