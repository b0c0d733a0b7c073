"""The error ladder: how well models predict each metric family, on captures that they were fitted to and on others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.metric import Metric
from isetval.loop.fit import Fit
from isetval.loop.gaussian import degrees_spent, square, whitener
from isetval.loop.prepared import Prepared
from isetval.loop.problem import Problem

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
CALIBRATION, PREDICTION = "calibration", "prediction"


@dataclass(frozen=True)
class LadderRow:
    """How well a model predicts a metric family.

    ``role`` is *calibration* where an effect of one of the compared models was fitted to these captures, else
    *prediction*; the two never share a row.  ``mean_square_z`` is 1 for a true model; ``rms_relative_error`` is the rms
    residual over the rms measured value; ``captures`` names campaign and sessions.
    """

    model: str
    family: str
    role: str
    n: int
    mean_square_z: float
    rms_relative_error: float
    captures: str = ""


def captures_of(campaign: str, session: str) -> str:
    """The entry of ``fitted_to`` that names one measurement session of a campaign; the campaign alone names all of them."""
    return f"{campaign}/{session}"


def fitted_to(models: Sequence[CameraModel], campaign: str, metrics: Sequence[Metric]) -> Mask:
    """Which rows (metrics,) an effect of one of the models was fitted to."""
    stated = {entry for model in models for effect in model.effects for entry in effect.fitted_to}
    return np.array([bool(stated & {campaign, captures_of(campaign, m.measurement_session)}) for m in metrics], bool)


def ladder_rows(prepared: Prepared, models: Sequence[CameraModel]) -> list[LadderRow]:
    """Mean-square z and relative error per family and model, own nuisances refitted, same seeds on each rung.

    The mean square is of residuals whitened within the family, divided by the degrees of freedom that
    the nuisances leave, so that a true model stands at 1.  Rows that one of the models was fitted to are
    counted apart from the others, for all models alike: every rung of a ladder holds the same captures.
    """
    rows = []
    sessions = np.array([m.measurement_session for m in prepared.table.metrics])
    for model in models:
        problem, fit = prepared.problem_for(model), prepared.fit_nuisances(model)
        metrics = [problem.predictor.table.metrics[i] for i in problem.keep]
        families = np.array([m.family for m in metrics])
        inside = fitted_to(models, prepared.campaign.name, metrics)
        for role, these in ((CALIBRATION, inside), (PREDICTION, ~inside)):
            captures = " + ".join(captures_of(prepared.campaign.name, s) for s in dict.fromkeys(sessions[problem.keep][these]))
            for family in ["all", *dict.fromkeys(families[these])] if these.any() else []:
                mask = these if family == "all" else these & (families == family)
                mean_square, n = _mean_square(problem, fit, mask, whole=family == "all")
                rows.append(
                    LadderRow(model.name, str(family), role, n, mean_square, _relative_error(problem, fit, mask), captures)
                )
    return rows


def _mean_square(problem: Problem, fit: Fit, mask: Mask, *, whole: bool) -> tuple[float, int]:
    """Mean square of whitened residuals, and their number; over all families the nuisances' degrees of freedom are taken off."""
    n = int(mask.sum())
    if mask.all():
        return float(fit.z @ fit.z) / max(n - degrees_spent(fit.jacobian, fit.free), 1.0), n
    rows = problem.keep[mask]
    covariance = problem.covariance[np.ix_(rows, rows)]
    total = square(fit.residual[rows], covariance)
    if not whole:
        return total / n, n
    spent = degrees_spent(whitener(covariance) @ _raw(problem, fit.jacobian)[mask], fit.free)
    return total / max(n - spent, 1.0), n


def _raw(problem: Problem, whitened: Float) -> Float:
    """Columns (kept rows, k) before they were whitened."""
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(problem.whiten, whitened, lower=True))


def _relative_error(problem: Problem, fit: Fit, mask: Mask) -> float:
    rows = problem.keep[mask]
    measured, residual = problem.measured[rows], fit.residual[rows]
    size = np.sqrt(np.mean(measured**2))
    return float(np.sqrt(np.mean(residual**2)) / size) if size > 0 else float("nan")
