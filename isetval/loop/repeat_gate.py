"""Whether set-ups that the laboratory made twice agree within their error bars: before anything is concluded."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.campaign import Shot
from isetval.core.metric import MetricTable
from isetval.loop.fit import jacobian, nuisance_parameters
from isetval.loop.prediction import Point
from isetval.loop.prepared import Prepared
from isetval.loop.problem import Problem

Float = NDArray[np.float64]
MIN_GATE = 0.05  # what sigma may be off by, however many repeats there are: 2.5 % of it


def repeat_gate(prepared: Prepared) -> dict[str, Any]:
    """Whether repeated set-ups agree within their error bars.

    z of the difference of a shot and the one it repeats, weighted with the sampling covariance and the
    set-up scope priors of both; the mean square must be 1 within max(0.05, 3 sd).

    Returns
    -------
    dict
        ``run`` (False without repeats), ``failed``, ``mean_square_z``, ``n``, ``allowed``.
    """
    problem, table = prepared.problem, prepared.table
    pairs = [(s, s.repeat_of) for s in prepared.campaign.shots if s.repeat_of is not None]
    rows = _paired_rows(table, problem, pairs)
    if not rows:
        return {"run": False, "failed": False, "mean_square_z": None, "n": 0, "allowed": None}
    pick = np.zeros((len(rows), len(table.metrics)))
    for i, (a, b) in enumerate(rows):
        pick[i, a], pick[i, b] = 1.0, -1.0
    local = pick[:, problem.keep]
    covariance = problem.covariance[np.ix_(problem.keep, problem.keep)] / (1 + 1 / problem.base.replicas)
    spread = local @ covariance @ local.T + _set_up_part(problem, prepared.model, local)
    difference = pick @ np.nan_to_num(table.values)
    values, vectors = np.linalg.eigh(spread)
    use = values > 1e-9 * values.max()
    z = (vectors.T @ difference)[use] / np.sqrt(values[use])
    square, n = float(np.mean(z**2)), int(use.sum())
    from scipy.stats import chi2, norm

    # 3 standard deviations as a probability: chi2 is skew where the repeats are few
    low, high = (float(chi2.ppf(q, n)) / n for q in (norm.sf(3), norm.cdf(3)))
    failed = not min(low, 1 - MIN_GATE) <= square <= max(high, 1 + MIN_GATE)
    allowed = max(high, 1 + MIN_GATE) - 1
    return {"run": True, "failed": failed, "mean_square_z": square, "n": n, "allowed": allowed}


def _paired_rows(table: MetricTable, problem: Problem, pairs: Sequence[tuple[Shot, str | None]]) -> list[tuple[int, int]]:
    kept = set(problem.keep.tolist())
    place = {m.key(): i for i, m in enumerate(table.metrics)}
    rows = []
    for shot, other in pairs:
        for i, m in enumerate(table.metrics):
            if m.shot != shot.name:
                continue
            key = m.key()
            twin = place.get((key[0], key[1], other, *key[3:]))
            if twin is not None and i in kept and twin in kept:
                rows.append((i, twin))
    return rows


def _set_up_part(problem: Problem, model: CameraModel, local: Float) -> Float:
    free = [f for f in nuisance_parameters(problem.plan, model) if f.scope == "set-up"]
    if not free:
        return np.zeros((len(local), len(local)))
    from scipy.linalg import solve_triangular

    raw = solve_triangular(problem.whiten, jacobian(problem, Point(model), free), lower=True)
    columns = local @ raw * np.array([f.prior or 0.0 for f in free])
    return np.asarray(columns @ columns.T)
