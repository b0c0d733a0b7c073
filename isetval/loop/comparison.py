"""Where does a model fail?  Measured against predicted, with the nuisances of the laboratory refitted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.camera.shooting import check_sensor
from isetval.core.campaign import Campaign, Shot
from isetval.core.errors import InputError
from isetval.core.metric import METRIC_FIELDS, MetricTable
from isetval.files.captures import forgiving
from isetval.loop.fit import Fit, far_values, fit, jacobian, nuisance_parameters
from isetval.loop.gaussian import degrees_spent, square
from isetval.loop.ladder import LadderRow
from isetval.loop.prediction import DERIVATIVE_SEEDS, Point, Predictor
from isetval.loop.problem import Problem, make_problem
from isetval.measure.campaign import measure_campaign

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.float64]
Say = Callable[[str], None]
MIN_GATE = 0.05


@dataclass(eq=False)
class Prepared:
    """A campaign measured once, and the problem of predicting it with a model."""

    model: CameraModel
    campaign: Campaign
    table: MetricTable
    problem: Problem
    fits: dict[str, Fit] = field(default_factory=dict)
    problems: dict[str, Problem] = field(default_factory=dict)

    def problem_for(
        self, model: CameraModel, *, seeds: tuple[int, ...] = DERIVATIVE_SEEDS, values: Mapping[str, float] | None = None
    ) -> Problem:
        """The problem of predicting the campaign with ``model``: base and covariance simulated with it.

        ``seeds`` of its differences hold when the problem is made here for the first time; ``values``
        are focus errors so far from zero that predictions must be made there.
        """
        key = model.digest() + (repr(sorted(values.items())) if values else "")
        if key == self.model.digest():
            return self.problem
        if key not in self.problems:
            self.problems[key] = make_problem(self.problem.predictor, Point(model, values or {}), seeds=seeds)
        return self.problems[key]

    def settled(self, model: CameraModel) -> tuple[Problem, Fit]:
        """The problem and its nuisance fit; simulated anew where the focus lies far from zero.

        Noise and bias of an edge depend on focus: weights made at another focus judge wrongly, and may have
        driven the other nuisances away, which start at zero again.
        """
        problem, fitted = self.problem_for(model), self.fit_nuisances(model)
        if values := far_values(fitted):
            problem = self.problem_for(model, values=values)
            fitted = fit(problem, Point(model, values), fitted.free)
        return problem, fitted

    def fit_nuisances(self, model: CameraModel) -> Fit:
        """The fit in which only the campaign's nuisances are free."""
        key = model.digest()
        if key not in self.fits:
            problem = self.problem_for(model)
            self.fits[key] = fit(problem, Point(model), nuisance_parameters(problem.plan, model))
        return self.fits[key]

    def chi2(self, model: CameraModel, *, weights: CameraModel) -> float:
        """chi2 of the campaign under a model with base and weights simulated with another, nuisances refitted.

        Two models are compared with the same weights: their difference is then free of Monte-Carlo noise.
        """
        problem, _ = self.settled(weights)
        return fit(problem, Point(model), nuisance_parameters(problem.plan, model)).chi2

    def close(self) -> None:
        """Stop the workers."""
        self.problem.predictor.close()

    def __enter__(self) -> Prepared:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def prepare(
    model: CameraModel, campaign: Campaign, *, jobs: int = 1, say: Say | None = None, table: MetricTable | None = None
) -> Prepared:
    """Measure a campaign and simulate its plan with ``model``.

    Raises
    ------
    InputError
        If the campaign has no captures, another sensor than the model, or nothing that can be measured.
    """
    say = say or (lambda _: None)
    if campaign.is_plan:
        raise InputError(f"campaign {campaign.name} has no captures; simulate it, or put the files of its shots beside it")
    check_sensor(model, campaign)
    say(f"measuring {len(campaign.shots)} shots of {campaign.name}")
    readable, skipped = forgiving(campaign)
    table = table or measure_campaign(readable, summaries=False)
    campaign, table = _without_broken(campaign, table, skipped)
    predictor = Predictor(campaign, table, jobs=jobs)
    say(f"simulating the plan with {model.name}")
    return Prepared(model, campaign, table, make_problem(predictor, Point(model)))


def _without_broken(campaign: Campaign, table: MetricTable, skipped: Sequence[tuple[str, str]]) -> tuple[Campaign, MetricTable]:
    """The plan of what was measured: broken files are taken out of their shots and listed in the notes."""
    if not skipped:
        return campaign, table
    broken = {file for file, _ in skipped}

    def mended(shot: Shot) -> Shot:
        files = tuple(file for file in shot.files if file not in broken)
        return replace(shot, files=files, frames=max(1, len(files)))

    notes = tuple(f"file {file} left out: {reason}" for file, reason in dict(skipped).items())
    shots = tuple(mended(shot) for shot in campaign.shots)
    return replace(campaign, shots=shots), replace(table, notes=(*table.notes, *notes))


def split_sessions(campaign: Campaign, holdout: Campaign | None) -> tuple[Campaign, Campaign | None]:
    """The captures to learn from and those to confirm on: a second measurement session, unless given."""
    sessions = campaign.sessions
    if holdout is not None or len(sessions) < 2:
        return campaign, holdout
    return campaign.session(sessions[0]), campaign.session(sessions[1])


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


def ladder_rows(prepared: Prepared, models: Sequence[CameraModel], *, role: str) -> list[LadderRow]:
    """Mean-square z and relative error per family and model, own nuisances refitted, same seeds on each rung.

    The mean square is of residuals whitened within the family, divided by the degrees of freedom that
    the nuisances leave, so that a true model stands at 1.
    """
    rows = []
    for model in models:
        problem, fitted = prepared.problem_for(model), prepared.fit_nuisances(model)
        families = np.array([problem.predictor.table.metrics[i].family for i in problem.keep])
        for family in ["all", *dict.fromkeys(families)]:
            mask = np.ones(families.size, bool) if family == "all" else families == family
            square, n = _family_square(problem, fitted, mask)
            relative = _relative_error(problem, fitted, mask)
            rows.append(LadderRow(model.name, str(family), role, n, square, relative))
    return rows


def _family_square(problem: Problem, fitted: Fit, mask: NDArray[np.bool_]) -> tuple[float, int]:
    n = int(mask.sum())
    if mask.all():
        return float(fitted.z @ fitted.z) / max(n - degrees_spent(fitted.jacobian, fitted.free), 1.0), n
    rows = problem.keep[mask]
    return square(fitted.residual[rows], problem.covariance[np.ix_(rows, rows)]) / n, n


def _relative_error(problem: Problem, fitted: Fit, mask: NDArray[np.bool_]) -> float:
    rows = problem.keep[mask]
    measured, residual = problem.measured[rows], fitted.residual[rows]
    size = np.sqrt(np.mean(measured**2))
    return float(np.sqrt(np.mean(residual**2)) / size) if size > 0 else float("nan")


@dataclass(frozen=True, eq=False)
class Comparison:
    """Measured against predicted for one or several models, and how well each family fits.

    ``table`` has one row per metric and model with measured, simulated, sigma and z (z alone, not
    whitened); ``ladder`` the families; ``nuisances`` the fitted unknowns of the laboratory.
    """

    table: pd.DataFrame
    ladder: tuple[LadderRow, ...]
    gate: Mapping[str, Any]
    nuisances: Mapping[str, Mapping[str, tuple[float, float]]]
    models: tuple[CameraModel, ...]
    notes: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)

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
        }


def compare(
    model: CameraModel | Sequence[CameraModel], campaign: Campaign, *, jobs: int = 1, say: Say | None = None
) -> Comparison:
    """Compare one or several models with a measured campaign.

    Parameters
    ----------
    model : CameraModel or sequence of them
        Several models give the ladder; all are predicted with the same seeds and estimators.
    campaign : Campaign
        With captures.
    jobs : int
        Worker processes.
    say : callable, optional
        Told what is being done.

    Raises
    ------
    InputError
        If nothing can be measured or the sensors differ.
    """
    models = (model,) if isinstance(model, CameraModel) else tuple(model)
    names = [m.name for m in models]
    if len(set(names)) != len(names):
        raise InputError(f"two models are called {names[0]!r}; give each its own name in its file")
    with prepare(models[0], campaign, jobs=jobs, say=say) as prepared:
        return comparison_of(prepared, models)


def comparison_of(prepared: Prepared, models: Sequence[CameraModel], *, role: str = "prediction") -> Comparison:
    """The comparison of a campaign that is already measured."""
    import pandas as pd

    frames, nuisances = [], {}
    for model in models:
        fitted = prepared.fit_nuisances(model)
        frames.append(_rows(prepared.problem_for(model), model, fitted))
        nuisances[model.name] = {f.label: fitted.value(f.label) for f in fitted.free}
    return Comparison(
        table=pd.concat(frames, ignore_index=True),
        ladder=tuple(ladder_rows(prepared, models, role=role)),
        gate=repeat_gate(prepared),
        nuisances=nuisances,
        models=tuple(models),
        notes=prepared.table.notes,
        settings={"replicas": prepared.problem.base.replicas, "metrics": int(prepared.problem.keep.size)},
    )


def _rows(problem: Problem, model: CameraModel, fitted: Fit) -> pd.DataFrame:
    import pandas as pd

    keep = problem.keep
    metrics = [problem.predictor.table.metrics[i] for i in keep]
    names = [n for n in METRIC_FIELDS if n not in ("value", "sigma", "summary", "count")]
    frame = pd.DataFrame([[getattr(m, n) for n in names] for m in metrics], columns=names)
    sigma = np.sqrt(np.diag(problem.covariance)[keep])
    frame.insert(0, "model", model.name)
    frame["measured"] = problem.measured[keep]
    frame["simulated"] = fitted.prediction[keep]
    frame["sigma"] = sigma
    frame["z"] = fitted.residual[keep] / sigma
    return frame
