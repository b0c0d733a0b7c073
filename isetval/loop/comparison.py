"""Where does a model fail?  Measured against predicted, with the nuisances of the laboratory refitted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign
from isetval.core.errors import InputError
from isetval.core.metric import METRIC_FIELDS, Metric
from isetval.core.shown import Drawn
from isetval.loop.block_factor import Factor, factor
from isetval.loop.error_budget import BudgetRow, error_budget
from isetval.loop.fit import Fit
from isetval.loop.gaussian import degrees_spent, expected_mean_square
from isetval.loop.given_side import given_rows
from isetval.loop.prepared import Prepared, prepare
from isetval.loop.problem import Problem
from isetval.loop.region_change import region_change
from isetval.loop.repeats import Session, gate_with, repeat_gate
from isetval.loop.telling import Progress, Say, Teller

if TYPE_CHECKING:
    import pandas as pd

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
    the nuisances leave it, so that a true model stands at 1.  Rows that one of the models was fitted to are
    counted apart from the others, for all models alike: every rung of a ladder holds the same captures.
    """
    rows = []
    sessions = np.array([m.measurement_session for m in prepared.table.metrics])
    for model in models:
        problem, fit = prepared.settled(model)
        raw = problem.raw(fit.jacobian)
        metrics = [problem.predictor.table.metrics[i] for i in problem.keep]
        families = np.array([m.family for m in metrics])
        inside = fitted_to(models, prepared.campaign.name, metrics)
        for role, these in ((CALIBRATION, inside), (PREDICTION, ~inside)):
            captures = " + ".join(captures_of(prepared.campaign.name, s) for s in dict.fromkeys(sessions[problem.keep][these]))
            for family in ["all", *dict.fromkeys(families[these])] if these.any() else []:
                mask = these if family == "all" else these & (families == family)
                mean_square, n = _mean_square(problem, fit, raw, mask)
                rows.append(
                    LadderRow(model.name, str(family), role, n, mean_square, _relative_error(problem, fit, mask), captures)
                )
    return rows


def _mean_square(problem: Problem, fit: Fit, raw: Float, mask: Mask) -> tuple[float, int]:
    """Mean square of whitened residuals over that of a true model, and their number.

    ``raw`` (kept rows, k) is the fit's Jacobian before whitening.  What the fitted unknowns take from these rows is taken off:
    residuals r = y - J x of y ~ N(0, C + J P J') have the covariance C - J H^-1 J' with H = J' C^-1 J + P^-1.
    """
    n = int(mask.sum())
    rows = problem.keep[mask]
    root = problem.factor if mask.all() else factor(problem.covariance, rows)
    true = _true_mean_square(problem, rows, root)
    total = float(np.sum(root.white(fit.residual[rows]) ** 2))
    return total / max(n - degrees_spent(root.white(raw[mask]), fit.jacobian, fit.free), 1.0) / true, n


def _true_mean_square(problem: Problem, rows: NDArray[np.intp], root: Factor) -> float:
    """What a true model shows: as replicas and what they do not have scatter; 1 for rows given with error bars and for counts.

    Rare things that no replica has seen scatter by nothing: single events of 1.2 sigmas would be told as a mean square of 20.
    """
    rare = np.array([m.count for m in problem.predictor.table.metrics], bool)
    own = ~(given_rows(problem.predictor.table) | rare)[rows]
    if not own.any():
        return 1.0
    unseen = problem.unseen[rows[own]]
    unseen = unseen[:, np.any(unseen, axis=0)]
    root = root if own.all() else factor(problem.covariance, rows[own])
    expected = expected_mean_square(problem.simulated(rows[own]), root, unseen)
    return float(np.average([expected, 1.0], weights=[own.sum(), (~own).sum()]))


def _relative_error(problem: Problem, fit: Fit, mask: Mask) -> float:
    rows = problem.keep[mask]
    measured, residual = problem.measured[rows], fit.residual[rows]
    size = np.sqrt(np.mean(measured**2))
    return float(np.sqrt(np.mean(residual**2)) / size) if size > 0 else float("nan")


NOT_SHOWN = ("value", "sigma", "summary", "count")


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Drawn):
    """Measured against predicted for one or several models, and how well each family fits.

    ``table`` has one row per metric and model with measured, simulated, sigma and z (z alone, not
    whitened) and its ``basis``: *calibration* where an effect of that model was fitted to these captures, else
    *prediction*; ``ladder`` the families; ``nuisances`` the fitted unknowns of the laboratory; ``budget`` what the
    differences are made of.
    """

    table: pd.DataFrame
    ladder: tuple[LadderRow, ...]
    gate: Mapping[str, Any]
    nuisances: Mapping[str, Mapping[str, tuple[float, float]]]
    models: tuple[CameraModel, ...]
    notes: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    budget: tuple[BudgetRow, ...] = ()

    def headline(self) -> str:
        """Mean-square z of every model, and where the first fails most."""
        whole = ", ".join(f"{row.model} {row.mean_square_z:.3f}" for row in self.ladder if row.family == "all")
        worst = self.worst[:1]
        at = f"; worst of {worst[0].model}: {worst[0].family} {worst[0].mean_square_z:.3f}" if worst else ""
        return f"mean-square z of {len(self.table) // max(len(self.models), 1)} metrics: {whole}{at}"

    def to_frame(self) -> pd.DataFrame:
        """The table: one row a metric and model with measured, simulated, sigma, unit and z."""
        return self.table

    @property
    def worst(self) -> list[LadderRow]:
        """Families of the first model, worst first."""
        own = [row for row in self.ladder if row.model == self.models[0].name and row.family != "all"]
        return sorted(own, key=lambda row: (row.mean_square_z - 1) * np.sqrt(row.n), reverse=True)

    def to_json(self) -> dict[str, Any]:
        """Everything as plain numbers and words."""
        import json

        return {
            "models": [m.name for m in self.models],
            "gate": dict(self.gate),
            "ladder": [vars(row) for row in self.ladder],
            "nuisances": {m: {k: list(v) for k, v in values.items()} for m, values in self.nuisances.items()},
            "table": json.loads(self.table.to_json(orient="records")),
            "notes": list(self.notes),
            "settings": dict(self.settings),
            "budget": [vars(row) for row in self.budget],
        }


def compare(
    model: CameraModel | Sequence[CameraModel],
    campaign: Campaign,
    *,
    regions: bool = False,
    jobs: int = 1,
    say: Say | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Compare one or several models with a measured campaign.

    Parameters
    ----------
    model : CameraModel or sequence of them
        Several models give the ladder; all are predicted with the same seeds and estimators.
    campaign : Campaign
        With captures.
    regions : bool
        Measure and simulate on smaller regions too, for the error budget: how far the result hangs on their choice.
    jobs : int
        Worker processes.
    say : callable, optional
        Told what is being done.
    progress : callable, optional
        ``progress(what is being done, done, total)``, called as shots are measured and simulated.

    Raises
    ------
    InputError
        If nothing can be measured or the sensors differ.
    """
    models = (model,) if isinstance(model, CameraModel) else tuple(model)
    twice = [name for name, count in Counter(m.name for m in models).items() if count > 1]
    if twice:
        raise InputError(f"two models are called {twice[0]!r}; give each its own name in its file")
    teller = Teller.of(say, progress)
    with prepare(models[0], campaign, jobs=jobs, say=teller) as prepared:
        return comparison_of(prepared, models, regions=regions, say=teller)


def comparison_of(
    prepared: Prepared, models: Sequence[CameraModel], *, regions: bool = False, say: Say | None = None
) -> Comparison:
    """The comparison of a campaign that is already measured; ``regions`` as in `compare`."""
    import pandas as pd

    frames, nuisances = [], {}
    budget: list[BudgetRow] = []
    teller = Teller.of(say)
    notes = list(prepared.table.notes)
    gate = repeat_gate(Session(prepared))
    for model in models:
        problem, fitted = prepared.settled(model)
        gate = gate_with(gate, Session(prepared, problem, fitted))
        if not fitted.converged:
            notes.append(f"{model.name}: the fit of the laboratory's unknowns did not settle; its errors are upper bounds")
        frames.append(_rows(prepared, problem, model, fitted))
        nuisances[model.name] = {f.label: fitted.value(f.label) for f in fitted.free}
        moved = region_change(problem, fitted, prepared.campaign, teller) if regions else None
        budget += error_budget(prepared, problem, fitted, moved)
    return Comparison(
        table=pd.concat(frames, ignore_index=True),
        ladder=tuple(ladder_rows(prepared, models)),
        gate=gate,
        nuisances=nuisances,
        models=tuple(models),
        notes=tuple(notes),
        budget=tuple(budget),
        settings={"replicas": prepared.problem.base.replicas, "metrics": int(prepared.problem.keep.size)},
    )


def _rows(prepared: Prepared, problem: Problem, model: CameraModel, fitted: Fit) -> pd.DataFrame:
    import pandas as pd

    keep = problem.keep
    metrics = [problem.predictor.table.metrics[i] for i in keep]
    names = [n for n in METRIC_FIELDS if n not in NOT_SHOWN]
    frame = pd.DataFrame([[getattr(m, n) for n in names] for m in metrics], columns=names)
    sigma = np.sqrt(problem.covariance.diagonal()[keep])
    frame.insert(0, "model", model.name)
    frame["measured"] = problem.measured[keep]
    frame["simulated"] = fitted.prediction[keep]
    frame["sigma"] = sigma
    frame["z"] = fitted.residual[keep] / sigma
    frame["basis"] = np.where(fitted_to([model], prepared.campaign.name, metrics), CALIBRATION, PREDICTION)
    return frame
