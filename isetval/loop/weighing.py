"""Making a problem: simulate the prediction at a point, and weigh its difference to what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array

from isetval.core.errors import InputError
from isetval.core.metric import Metric, MetricTable
from isetval.loop.base import Base
from isetval.loop.block_factor import UNWEIGHED, factor, of_columns, scaled
from isetval.loop.gaussian import towards_one, true_scatter
from isetval.loop.given_side import given_rows
from isetval.loop.marginal_columns import marginal_columns
from isetval.loop.prediction import DERIVATIVE_SEEDS, Point, Predictor
from isetval.loop.problem import Problem, Replicas
from isetval.loop.shot_task import Sampled
from isetval.loop.shoulder import filling

Float = NDArray[np.float64]
HOLDS = 1.0  # sigmas of a row: of variances 3 % in flats of 1600 pixels a plane, a third of what weights are known to
# sigmas of a level or a contrast, where variances hold: less than 1 % of the light of such a plane, 14 % of an MTF.  Replicas
# that were moved there have means and error bars that differ from new ones by no more than 16 of them tell
LEVEL_HOLDS = 10.0


def make_problem(
    predictor: Predictor,
    origin: Point,
    *,
    base: Base | None = None,
    seeds: tuple[int, ...] = DERIVATIVE_SEEDS,
    near: Sequence[Problem] = (),
) -> Problem:
    """Simulate the prediction at ``origin`` and weigh it; differences are taken with ``seeds``.

    Replicas of shots that one of the problems ``near`` holds as well are not simulated again.

    Raises
    ------
    InputError
        If no measured row can be compared with a prediction.
    """
    (anchor,) = predictor.derivative_vectors([origin], seeds)
    held: dict[str, Replicas] = {}
    for other in near if base is None else ():
        held = _that_hold(predictor, anchor, seeds, other) | held
    base = base or predictor.base(origin, known={name: _moved(own, anchor[predictor.rows[name]]) for name, own in held.items()})
    made = {name: Replicas(sample, anchor[predictor.rows[name]], seeds) for name, sample in base.samples.items()}
    measured = predictor.table.values
    variance = base.covariance.diagonal()
    usable = (
        ~_empty_counts(predictor.table, measured, base)
        & np.isfinite(measured)
        & np.isfinite(base.mean)
        & np.isfinite(anchor)
        & np.isfinite(variance)
    )
    full = filling(predictor, origin, anchor, np.sqrt(np.maximum(np.nan_to_num(variance), 0.0)), seeds)
    usable &= ~full.partly
    # what is only rounding is no measurement; a plateau without any noise still has a height
    usable &= variance + full.plateau > (1e-9 * np.maximum(1.0, np.abs(np.nan_to_num(base.mean)))) ** 2
    keep = np.flatnonzero(usable)
    if keep.size == 0:
        raise InputError("no metric of the captures has a counterpart in the simulation; check roles, windows and exposure")
    problem = Problem(
        predictor, origin, base, measured, keep, UNWEIGHED, anchor, base.covariance, seeds, replicas=made | held, filling=full
    )
    weigh(problem)
    return problem


def _that_hold(predictor: Predictor, anchor: Float, seeds: tuple[int, ...], near: Problem) -> dict[str, Replicas]:
    """Replicas of shots whose rows stand within `HOLDS` sigmas of where they were simulated: weights and scatter are the same.

    Levels (means, and what is linear in them: gradients, drifts) and contrasts of edges may stand `LEVEL_HOLDS` off: new replicas
    would bring new noise.
    A mean over pixels does not feel their noise: shots in which it is not measured hold only where noise does in all those in
    which it is.  A flat that is a little brighter is no noisier.
    """
    sigma = np.sqrt(near.base.covariance.diagonal())
    of_noise = np.array([not _is_steady(m) for m in predictor.table.metrics], bool)
    limit = sigma * np.where(of_noise, HOLDS, LEVEL_HOLDS)
    unweighed = ~np.isfinite(sigma)  # lost in a replica, as those of a plane that fills up are: they tell nothing of the noise

    def rows_that_hold(name: str) -> NDArray[np.bool_]:
        own, rows = near.replicas[name], predictor.rows[name]
        off = np.abs(anchor[rows] - own.anchor)
        lost = np.isnan(anchor[rows]) & np.isnan(own.anchor) | unweighed[rows] & (off == 0)
        return np.asarray((own.seeds == seeds) & (lost | (off <= limit[rows])))

    known = {shot.name: rows_that_hold(shot.name) for shot in predictor.shots if shot.name in near.replicas}
    tells = of_noise & ~unweighed
    noisy = [bool(np.all(own | ~tells[predictor.rows[n]])) for n, own in known.items() if not predictor.differences[n].one_frame]
    quiet = bool(noisy) and all(noisy)
    return {n: near.replicas[n] for n, own in known.items() if own.all() and (quiet or not predictor.differences[n].one_frame)}


def _is_steady(m: Metric) -> bool:
    """Whether a row is a level, a contrast or a place: it scatters by noise, of which other rows tell, and not by itself."""
    level = m.unit == "DN" and not any(word in m.family for word in ("noise", "std"))
    return level or m.unit == "px" or m.frequency_cy_px is not None


def _moved(replicas: Replicas, anchor: Float) -> Sampled:
    """Replicas as they would be where the vector of differences is ``anchor``."""
    return replace(replicas.sample, values=replicas.sample.values + np.nan_to_num(anchor - replicas.anchor))


def _empty_counts(table: MetricTable, measured: Float, base: Base) -> NDArray[np.bool_]:
    """Rows that count outliers where neither side has any: they hold no information and are not normal."""
    counts = np.array([m.count for m in table.metrics], bool)
    nothing = 2 * np.sqrt(0.375) + 1e-9
    return np.asarray(counts & (measured <= nothing) & (base.values.max(axis=0) <= nothing))


def weigh(problem: Problem) -> None:
    """Set the covariance of measured minus predicted (sampling, simulation, frame-scope light), its factor, what rows hold."""
    keep = problem.keep
    flicker, colors = marginal_columns(problem)
    covariance = problem.base.of_differences() + of_columns(flicker) + of_columns(colors)
    problem.color_variance = np.sum(colors**2, axis=1)
    rounding = _rounding(problem, covariance.diagonal()) + (problem.filling.plateau if problem.filling else 0.0)
    problem.unseen = np.column_stack([flicker, colors, _each_alone(rounding + problem.base.render)])
    covariance = csr_array(covariance + diags_array(rounding))
    rare = _of_rare_counts(problem, np.sqrt(covariance.diagonal()))
    problem.covariance = scaled(covariance, lambda row, column: rare[row] * rare[column])
    problem.factor = factor(problem.covariance, keep)
    problem.numbers = _numbers(problem)


def _numbers(problem: Problem) -> dict[str, float]:
    """What squares of a true model's whitened rows sum to, by family: as replicas and what they do not have scatter.

    At most the number of rows.  A mean square is drawn towards 1 as the ladder's is (`gaussian.towards_one`); rows given with
    error bars and counts of rare things, of which replicas show nothing, hold one number each.
    """
    table, keep, replicas = problem.predictor.table, problem.keep, problem.base.replicas
    if replicas < 2:
        return {}
    unseen = problem.unseen[keep]
    scatter = true_scatter(problem.base.values[:, keep], unseen[:, np.any(unseen, axis=0)])
    shown = np.sum(problem.factor.white(scatter) ** 2, axis=1)
    sure = (given_rows(table) | np.array([m.count for m in table.metrics], bool))[keep]
    shown = np.where(sure, 1.0, shown)
    names = np.array([table.metrics[i].family for i in keep])
    out = {}
    for name in np.unique(names):
        own = shown[names == name]
        out[str(name)] = own.size * min(towards_one(float(np.sum(own)), own.size, replicas), 1.0)
    return out


def _of_rare_counts(problem: Problem, sigma: Float) -> Float:
    """Factors (metrics,) of sigma that make a count's residual what Poisson's law says of it: the root of its deviance.

    The root of a count is normal with a sigma of 1 where some are expected.  One where none was seen in 64 simulated campaigns is
    1.1 of these, but happens in one of a hundred and thirty (expected are half an event in all of them, Jeffreys' prior).
    """
    counts = np.array([m.count for m in problem.predictor.table.metrics], bool)
    expected = (np.sum(_counted(problem.base.values), axis=0) + 0.5) / problem.base.replicas
    found = _counted(problem.measured)
    with np.errstate(invalid="ignore", divide="ignore"):
        deviance = np.sqrt(2 * (found * np.log(found / expected) - (found - expected)))
        share = (problem.measured - problem.base.mean) / deviance / sigma
    return np.where(counts & (found > expected) & (share > 0), np.minimum(np.nan_to_num(share, nan=1.0), 1.0), 1.0)


def _counted(roots: Float) -> Float:
    """Numbers behind ``2 sqrt(n + 3/8)``."""
    return np.asarray(np.maximum((roots / 2) ** 2 - 0.375, 0.0))


def _rounding(problem: Problem, variance: Float) -> Float:
    """What measured rows of resampled pictures scatter beyond simulated ones, whose noise hides the rounding, (metrics,)."""
    table = problem.predictor.table
    resampled = {shot.name for shot in problem.plan.shots if shot.levels_only}
    rows = np.array([m.shot in resampled for m in table.metrics], bool)
    return np.where(rows, np.maximum(table.sigma**2 - variance, 0.0), 0.0)


def _each_alone(variance: Float) -> Float:
    """Columns (metrics, k) of rows that scatter by a ``variance`` (metrics,) of their own."""
    rows = np.flatnonzero(variance)
    columns = np.zeros((variance.size, rows.size))
    columns[rows, np.arange(rows.size)] = np.sqrt(variance[rows])
    return columns
