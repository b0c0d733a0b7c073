"""A measured campaign, what a nominal model predicts for it, and the weights of the difference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign, Nuisance, Shot
from isetval.core.errors import InputError
from isetval.core.metric import MetricTable
from isetval.core.scene import ChartTarget
from isetval.loop.block_factor import UNWEIGHED, Factor, factor, gram
from isetval.loop.family_scales import Families
from isetval.loop.gaussian import TOWARDS_ONE
from isetval.loop.given_side import given_rows
from isetval.loop.prediction import DERIVATIVE_SEEDS, Base, Point, Predictor
from isetval.loop.shot_task import Sampled
from isetval.loop.shoulder import Filling, filling
from isetval.measure.noise.statistics import tilt_power

Float = NDArray[np.float64]
HOLDS = 1.0  # sigmas of a row: of variances 3 % in flats of 1600 pixels a plane, a third of what weights are known to
SEEN = 3.0  # standard errors of a mean of replicas: what lies within may be chance
FLICKER_STEP = 0.01  # of the light: several times the flicker of lamps, well inside the linear range


@dataclass(frozen=True, eq=False)
class Column:
    """Raw derivatives (metrics,) by a nuisance, and the values of the nuisances where they were taken."""

    slope: Float
    taken_at: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Replicas:
    """Replicas of one shot, and the vector of differences (rows of the shot,) with ``seeds`` where they were simulated."""

    sample: Sampled
    anchor: Float
    seeds: tuple[int, ...]


@dataclass(eq=False)
class Problem:
    """A measured campaign, what a model predicts for it at ``origin``, and the weights of the difference.

    ``noise_bias`` and ``color_variance`` are parts of the covariance's diagonal, (metrics,): what is the prediction's and not the
    captures', and what colors of patches that nobody knows make.  ``unseen`` (metrics, k) are columns of what captures
    scatter by and replicas do not: light that flickers, colors, rounding, noise of renders.  ``numbers`` are what squares of a
    true model's whitened rows sum to, by family.
    ``steps`` are shortened finite steps of nuisances, by label; ``filling`` says which levels are full
    (`isetval.loop.shoulder`).
    """

    predictor: Predictor
    origin: Point
    base: Base
    measured: Float
    keep: NDArray[np.intp]
    factor: Factor
    anchor: Float
    covariance: Float
    seeds: tuple[int, ...] = DERIVATIVE_SEEDS
    columns: dict[str, Column] = field(default_factory=dict)
    replicas: Mapping[str, Replicas] = field(default_factory=dict)
    steps: dict[str, float] = field(default_factory=dict)
    noise_bias: Float | float = 0.0
    color_variance: Float | float = 0.0
    unseen: Float = field(default_factory=lambda: np.zeros((0, 0)))
    filling: Filling | None = None
    numbers: Mapping[str, float] = field(default_factory=dict)

    @property
    def nominal(self) -> CameraModel:
        """The model of the origin."""
        return self.origin.model

    @property
    def plan(self) -> Campaign:
        """The plan behind the measured campaign."""
        return self.predictor.plan

    @property
    def families(self) -> Families:
        """Families of the kept rows, as the whitening leaves them: it is triangular."""
        return Families.of([self.predictor.table.metrics[i].family for i in self.keep], self.numbers)

    def predict(self, points: Sequence[Point]) -> list[Float]:
        """Predictions (metrics,): the base plus differences with common random numbers."""
        vectors = self.predictor.derivative_vectors(points, self.seeds)
        # a row that cannot be measured at a point (a plane that saturates there) keeps the prediction of the origin
        return [self.base.mean + np.nan_to_num(vector - self.anchor) for vector in vectors]

    def with_draws(self, seeds: tuple[int, ...]) -> Problem:
        """The same with differences taken over more draws; what is known of its derivatives is shared."""
        if len(seeds) <= len(self.seeds):
            return self
        (anchor,) = self.predictor.derivative_vectors([self.origin], seeds)
        return replace(self, seeds=seeds, anchor=anchor)

    def whitened(self, vector: Float) -> Float:
        """L^-1 of the kept rows of ``vector``, (metrics,) or (metrics, k)."""
        return self.factor.white(vector[self.keep])

    def whitened_each(self, columns: Sequence[Float]) -> list[Float]:
        """`whitened` of several (metrics, k), in one pass."""
        if not columns:
            return []
        ends = np.cumsum([part.shape[1] for part in columns])[:-1]
        return np.split(self.whitened(np.hstack(columns)), ends, axis=1)

    def raw(self, white: Float) -> Float:
        """L times a whitened vector (kept rows,): the kept rows that `whitened` makes it from."""
        return self.factor.raw(white)


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
    variance = np.diag(base.covariance)
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

    A mean over pixels does not feel their noise: shots in which it is not measured hold only where all those do in which it is.
    """
    sigma = np.sqrt(np.diag(near.base.covariance))

    def holds(name: str) -> bool:
        own, rows = near.replicas[name], predictor.rows[name]
        off = np.abs(anchor[rows] - own.anchor)
        lost = np.isnan(anchor[rows]) & np.isnan(own.anchor)
        return own.seeds == seeds and bool(np.all(lost | (off <= HOLDS * sigma[rows])))

    known = {shot.name: holds(shot.name) for shot in predictor.shots if shot.name in near.replicas}
    of_noise = [here for name, here in known.items() if not predictor.differences[name].one_frame]
    quiet = bool(of_noise) and all(of_noise)
    return {n: near.replicas[n] for n, here in known.items() if here and (quiet or not predictor.differences[n].one_frame)}


def _moved(replicas: Replicas, anchor: Float) -> Sampled:
    """Replicas as they would be where the vector of differences is ``anchor``."""
    return replace(replicas.sample, values=replicas.sample.values + np.nan_to_num(anchor - replicas.anchor))


def _empty_counts(table: MetricTable, measured: Float, base: Base) -> NDArray[np.bool_]:
    """Rows that count outliers where neither side has any: they hold no information and are not normal."""
    counts = np.array([m.count for m in table.metrics], bool)
    nothing = 2 * np.sqrt(0.375) + 1e-9
    return np.asarray(counts & (measured <= nothing) & (base.values.max(axis=0) <= nothing))


def weigh(problem: Problem) -> None:
    """Set the covariance of measured minus predicted (sampling, simulation, frame-scope light) and its L^-1."""
    keep = problem.keep
    covariance = problem.base.covariance * (1 + 1 / problem.base.replicas)
    flicker, colors = _marginal_columns(problem)
    covariance += gram(flicker) + gram(colors)
    problem.color_variance = np.sum(colors**2, axis=1)
    problem.noise_bias = _bias_of_noise(problem)
    rounding = _rounding(problem, np.diag(covariance)) + (problem.filling.plateau if problem.filling else 0.0)
    problem.unseen = np.column_stack([flicker, colors, _each_alone(rounding + problem.base.render)])
    covariance[np.diag_indices_from(covariance)] += rounding + problem.noise_bias
    rare = _of_rare_counts(problem, np.sqrt(np.diag(covariance)))
    covariance *= rare[:, None] * rare
    problem.covariance = covariance
    problem.factor = factor(covariance[np.ix_(keep, keep)])
    problem.numbers = _numbers(problem)


def _numbers(problem: Problem) -> dict[str, float]:
    """What squares of a true model's whitened rows sum to, by family: as replicas and what they do not have scatter.

    At most the number of rows.  A mean square is drawn towards 1 by `TOWARDS_ONE` numbers, as the ladder's is; rows given with
    error bars and counts of rare things, of which replicas show nothing, hold one number each.
    """
    table, keep, replicas = problem.predictor.table, problem.keep, problem.base.replicas
    if replicas < 2:
        return {}
    scatter = np.sqrt((1 + 1 / replicas) / (replicas - 1)) * (problem.base.values - problem.base.mean).T[keep]
    unseen = problem.unseen[keep]
    shown = np.sum(problem.factor.white(np.hstack([scatter, unseen[:, np.any(unseen, axis=0)]])) ** 2, axis=1)
    sure = (given_rows(table) | np.array([m.count for m in table.metrics], bool))[keep]
    shown = np.where(sure, 1.0, shown)
    names = np.array([table.metrics[i].family for i in keep])
    out = {}
    for name in np.unique(names):
        rows = int(np.sum(names == name))
        numbers = rows * (replicas - 1)
        mean_square = (float(np.sum(shown[names == name])) * (replicas - 1) + TOWARDS_ONE) / (numbers + TOWARDS_ONE)
        out[str(name)] = rows * min(mean_square, 1.0)
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
        factor = (problem.measured - problem.base.mean) / deviance / sigma
    return np.where(counts & (found > expected) & (factor > 0), np.minimum(np.nan_to_num(factor, nan=1.0), 1.0), 1.0)


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


def _bias_of_noise(problem: Problem) -> Float:
    """Squares of what noise adds to rows whose differences are taken without noise, (metrics,), where it is seen.

    A contrast near zero is a length: noise turns and lengthens it, so that edges with and without noise differ by another amount.
    The bias is known at the origin; elsewhere it is another, by about as much as it is large.  Without it the true camera at
    22 um of defocus stood at a mean-square z of 29 to 41 (``tests/loop/test_noise_bias.py``).
    """
    base = problem.base
    bias = np.where(problem.predictor.noise_free, np.nan_to_num(base.mean - problem.anchor), 0.0)
    spread = np.diag(base.covariance) / base.replicas
    return np.where(bias**2 > SEEN**2 * spread, bias**2, 0.0)


def _light_slope(problem: Problem, step: float) -> Float:
    """Derivative of the metrics (metrics,) by the light's relative level, of rows that saturate in more light by less."""
    slope = _light_difference(problem, step)
    lost = ~np.isfinite(slope)
    return np.where(lost, np.nan_to_num(_light_difference(problem, -step)), slope) if lost.any() else slope


def _light_difference(problem: Problem, step: float) -> Float:
    """Finite difference by a step of the light's relative level (metrics,), nan where a row cannot be measured there."""
    plan, predictor = problem.plan, problem.predictor
    moved = replace(plan, shots=tuple(replace(s, light_level=s.light_level * (1 + step)) for s in plan.shots))
    (vector,) = predictor.of_plan(moved).derivative_vectors([problem.origin], problem.seeds)
    return np.asarray((vector - problem.anchor) / step)


def _marginal_columns(problem: Problem) -> tuple[Float, Float]:
    """Columns (metrics, k) per sigma of what is integrated and not fitted: of what flickers, of colors that nobody knows."""
    nothing = np.zeros((len(problem.predictor.table.metrics), 0))
    frames = [n for n in problem.plan.nuisances if n.marginalised and n.scope == "frame"]
    flicker = _frame_columns(problem, frames, _light_slope(problem, FLICKER_STEP)) if frames else []
    colors = _color_columns(problem, [n for n in problem.plan.nuisances if n.parameter == "patch_color"])
    return np.column_stack([nothing, *flicker]), np.column_stack([nothing, *colors])


def _color_columns(problem: Problem, priors: Sequence[Nuisance]) -> list[Float]:
    """Columns of what each channel sees of each patch in each light: it acts as that light on the rows of both.

    A factor of rows is exact however far off it is; spectra of patches and filters bend, and are as many unknowns for a fit.
    Temporal noise at a level is that of the patches of about this level: it goes as far as one color that is off moves it, of
    which a step as long as the prior is wide tells more than rounding does.
    """
    if not priors:
        return []
    shots = {shot.name: shot for shot in problem.predictor.shots}
    slope = _light_slope(problem, max(prior.sigma for prior in priors))
    columns: dict[tuple[int, str | None, str, str], Float] = {}
    for i, m in enumerate(problem.predictor.table.metrics):
        seen = m.patch or (m.region if m.name == "uniform_patch_noise" else "")
        for k, prior in enumerate(priors):
            if seen and (shot := shots.get(m.shot)) is not None and prior.applies_to(shot):
                column = columns.setdefault((k, shot.light, seen, m.channel), np.zeros_like(slope))
                column[i] = prior.sigma * slope[i]
    return list(columns.values())


def _frame_columns(problem: Problem, priors: Sequence[Nuisance], slope: Float) -> list[Float]:
    """Columns of what changes from frame to frame: light that flickers, as a whole and patch by patch of a chart.

    Of each shot's mean, sigma / sqrt(frames), and of the rise over it.
    """
    predictor = problem.predictor
    out = []
    for shot in predictor.shots:
        whole, patchwise = (_of_frame(priors, parameter, shot) for parameter in ("light_level", "patch_reflectance"))
        column = np.zeros_like(slope)
        column[predictor.rows[shot.name]] = slope[predictor.rows[shot.name]]
        if whole:
            out += [whole * column, _rises(predictor, shot, whole * slope)]
        if patchwise:  # a reflectance acts as the light on the rows of its patch
            patches = np.array([m.patch for m in predictor.table.metrics])
            names = [p.name for p in shot.target.patches] if isinstance(shot.target, ChartTarget) else []
            out += [np.where(patches == name, patchwise * column, 0.0) for name in names]
    return out


def _of_frame(priors: Sequence[Nuisance], parameter: str, shot: Shot) -> float:
    """Standard deviation of a shot's mean by what changes from frame to frame."""
    return float(np.sqrt(sum(n.sigma**2 for n in priors if n.parameter == parameter and n.applies_to(shot)) / shot.frames))


def _rises(predictor: Predictor, shot: Shot, of_mean: Float) -> Float:
    """What a flicker that gives the means of a shot ``of_mean`` (metrics,) gives the rises of its frames: independent of it."""
    metrics = predictor.table.metrics
    rows = predictor.rows[shot.name]
    means = {metrics[i].channel: of_mean[i] for i in rows if metrics[i].name == "mean"}
    column = np.zeros_like(of_mean)
    for i in rows:
        if metrics[i].name == "frame_drift":
            column[i] = means.get(metrics[i].channel, 0.0) * np.sqrt(shot.frames / tilt_power(shot.frames))
    return column
