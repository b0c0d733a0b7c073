"""What the difference between measured and simulated is made of, by family: captures, specimen, simulation, light, model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from isetval.loop.fit import Fit
from isetval.loop.problem import Problem


@dataclass(frozen=True)
class BudgetRow:
    """Shares of the variance of measured minus predicted in a family of metrics; the first four add up to 1.

    ``sampling`` is the noise of the captures (more frames), ``specimen`` what several shots share, such as the fixed pattern of
    the same pixels (more places), ``simulation`` the finite number of simulated campaigns and, in rendered scenes, of rays
    (more replicas), ``light`` the flicker between frames; ``unexplained`` is the mean square of z beyond 1: what no error bar
    explains, in the same unit.
    """

    model: str
    family: str
    n: int
    sampling: float
    specimen: float
    simulation: float
    light: float
    unexplained: float


def error_budget(problem: Problem, fitted: Fit, model: str) -> tuple[BudgetRow, ...]:
    """The budget of every family under one model, nuisances refitted."""
    keep = problem.keep
    metrics = [problem.predictor.table.metrics[i] for i in keep]
    total = np.diag(problem.covariance)[keep]
    captures = np.diag(problem.base.covariance)[keep]
    own = np.array([m.sigma for m in metrics]) ** 2 / np.maximum(problem.predictor.table.sigma[keep] ** 2, 1e-300)
    simulation = captures / problem.base.replicas
    parts = np.stack([own * captures, (1 - own) * captures, simulation, np.maximum(total - captures - simulation, 0)]) / total
    square = fitted.residual[keep] ** 2 / total
    families = np.array([m.family for m in metrics])
    rows = []
    for family in dict.fromkeys(families):
        these = families == family
        sampling, specimen, simulated, light = (float(v) for v in parts[:, these].mean(axis=1))
        left = max(float(square[these].mean()) - 1.0, 0.0)
        rows.append(BudgetRow(model, str(family), int(these.sum()), sampling, specimen, simulated, light, left))
    return tuple(rows)
