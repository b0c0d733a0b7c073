"""What the difference between measured and simulated is made of, by family: noise, renders, repeats, regions, the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.loop.fit import Fit
from isetval.loop.prepared import Prepared
from isetval.loop.problem import Problem
from isetval.loop.region_change import RegionChange
from isetval.loop.repeats import repeat_differences

Float = NDArray[np.float64]


@dataclass(frozen=True)
class BudgetRow:
    """Shares of the variance of measured minus predicted in a family of metrics, and what is beyond that variance.

    The first six add up to 1: ``sampling`` is the noise of the captures (more frames), ``specimen`` what several shots share,
    such as the fixed pattern of the same pixels (more places), ``simulation`` the finite number of simulated campaigns (more
    replicas), ``render`` the finite number of rays in 3-D scenes (more rays), ``color`` colors of patches that nobody knows,
    ``light`` the flicker between frames.

    The others are mean squares of z beyond what that variance explains, in its unit: ``unexplained`` all of it, ``repeat``
    what set-ups made anew show of it (None without repeats), ``misfit`` what is left of it for the model; ``region`` is how
    far z moves when every region is chosen smaller, beyond noise (None where it was not tried; below 0 by chance).
    """

    model: str
    family: str
    n: int
    sampling: float
    specimen: float
    simulation: float
    render: float
    color: float
    light: float
    unexplained: float
    repeat: float | None
    region: float | None
    misfit: float


def error_budget(prepared: Prepared, problem: Problem, fitted: Fit, regions: RegionChange | None) -> tuple[BudgetRow, ...]:
    """The budget of every family under the model of ``problem``, nuisances refitted."""
    keep = problem.keep
    parts = _parts(problem)
    square = fitted.residual[keep] ** 2 / problem.covariance.diagonal()[keep]
    families = np.array([problem.predictor.table.metrics[i].family for i in keep])
    repeats = _repeats(prepared, problem, fitted)
    rows = []
    for family in dict.fromkeys(families):
        these = families == family
        left = max(float(square[these].mean()) - 1.0, 0.0)
        repeat = repeats.get(str(family))
        misfit = max(left - max(repeat or 0.0, 0.0), 0.0)
        shares = {name: float(part[these].mean()) for name, part in parts.items()}
        rows.append(
            BudgetRow(
                problem.nominal.name, str(family), int(these.sum()), **shares, unexplained=left, repeat=repeat,
                region=_moved(regions, these), misfit=misfit,
            )
        )  # fmt: skip
    return tuple(rows)


def _parts(problem: Problem) -> dict[str, Float]:
    """Shares of the variance of each kept row."""
    keep, base = problem.keep, problem.base
    table = problem.predictor.table
    total = problem.covariance.diagonal()[keep]
    render, color = (np.broadcast_to(part, len(table.metrics))[keep] for part in (base.render, problem.color_variance))
    more = 1 / base.number[keep]
    color = np.minimum(color, total)
    # counts of rare events have their own law in place of the simulated
    known = np.maximum((total - color) / (1 + more) - render, 0.0)
    captures = np.clip(base.covariance.diagonal()[keep] - render, 0.0, known)
    sigma = np.array([table.metrics[i].sigma for i in keep])
    own = sigma**2 / np.maximum(table.sigma[keep] ** 2, 1e-300)
    shares = {
        "sampling": own * captures,
        "specimen": (1 - own) * captures,
        "simulation": captures * more,
        "render": render * (1 + more),
        "color": color,
    }
    shares["light"] = np.maximum(total - sum(shares.values()), 0.0)
    return {name: part / total for name, part in shares.items()}


def _repeats(prepared: Prepared, problem: Problem, fitted: Fit) -> Mapping[str, float]:
    """Mean square of z between repeated set-ups beyond 1, by family."""
    rows, difference, spread = repeat_differences(prepared, problem, fitted)
    squares: dict[str, list[float]] = {}
    for (row, _), d, variance in zip(rows, difference, np.diag(spread), strict=True):
        squares.setdefault(prepared.table.metrics[row].family, []).append(d**2 / variance)
    return {family: float(np.mean(own)) - 1.0 for family, own in squares.items()}


def _moved(regions: RegionChange | None, these: NDArray[np.bool_]) -> float | None:
    if regions is None:
        return None
    known = these & np.isfinite(regions.change) & np.isfinite(regions.noise)
    return float(np.mean(regions.change[known] ** 2 - regions.noise[known])) if known.any() else None
