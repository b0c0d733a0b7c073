"""What is integrated and not fitted, as columns of the covariance: light that flickers, colors of patches that nobody knows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from isetval.core.campaign import Nuisance, Shot
from isetval.core.scene import ChartTarget
from isetval.loop.frame_light import flicker_of
from isetval.loop.prediction import Predictor
from isetval.loop.problem import Problem
from isetval.measure.noise.statistics import tilt_power

Float = NDArray[np.float64]
FLICKER_STEP = 0.01  # of the light: several times the flicker of lamps, well inside the linear range


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


def marginal_columns(problem: Problem) -> tuple[Float, Float]:
    """Columns (metrics, k) per sigma of what is integrated and not fitted: of what flickers, of colors that nobody knows."""
    nothing = np.zeros((len(problem.predictor.table.metrics), 0))
    frames = [n for n in problem.plan.nuisances if n.marginalised and n.scope == "frame"]
    flickers = bool(frames) or any(effect.light_by_frame for effect in problem.nominal.effects)
    flicker = _frame_columns(problem, frames, _light_slope(problem, FLICKER_STEP)) if flickers else []
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
        whole = float(np.hypot(whole, flicker_of(problem.nominal, shot) / np.sqrt(shot.frames)))
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
