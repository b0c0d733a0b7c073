"""A campaign measured once, and the problem of predicting it with a model: what comparing and diagnosing start from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.camera.shooting import check_sensor
from isetval.core.campaign import Campaign, Shot
from isetval.core.errors import InputError
from isetval.core.given import row_words
from isetval.core.metric import MetricTable
from isetval.loop.derivatives import nuisance_parameters, slopes
from isetval.loop.fit import FAR, Fit, far_values, fit, moved_far, told_here
from isetval.loop.given_side import given_rows
from isetval.loop.nominal import nominal_of, that_hold
from isetval.loop.prediction import DERIVATIVE_SEEDS, REPLICAS, Point, Predictor
from isetval.loop.problem import Problem
from isetval.loop.task_runner import Runner
from isetval.loop.telling import Say, Teller
from isetval.loop.valleys import deepest
from isetval.loop.weighing import make_problem
from isetval.measure.campaign import measure_campaign

Float = NDArray[np.float64]
PLAIN_REPLICAS = 64
"""Of plans of darks and flats, a fifth of a second each: the variance of a family of ten rows is then known to 6 %.  With 16 it
was 11 %, the same in every diagnosis of a plan: fresh captures of the very model stood at 1.29 in one family of 18.  Edges and
charts cost ten times as much; beside them darks alone, of which there are few, have as many: with 16 three of their families
stood at 1.13 to 1.18 in 32 sessions of the laboratory's whole plan."""
MAX_PLACES = 4  # places at which weights are made for one fit: a bound on cost, the second is the last where focus moved
CONTRAST, NEAR_ZERO = "mtf", 3.0  # sigmas of a contrast within which it may be on either side of zero, once in 700 farther off
MIN_GATE = 0.05  # what sigma may be off by, however many repeats there are: 2.5 % of it


@dataclass(eq=False)
class Prepared:
    """A campaign measured once, and the problem of predicting it with a model."""

    model: CameraModel
    campaign: Campaign
    table: MetricTable
    problem: Problem
    fits: dict[str, Fit] = field(default_factory=dict)
    problems: dict[str, Problem] = field(default_factory=dict)
    places: dict[str, tuple[Problem, Fit]] = field(default_factory=dict)

    def problem_for(
        self, model: CameraModel, *, seeds: tuple[int, ...] = DERIVATIVE_SEEDS, values: Mapping[str, float] | None = None
    ) -> Problem:
        """The problem of predicting the campaign with ``model``: base and covariance simulated with it.

        ``seeds`` of its differences hold when the problem is made here for the first time; ``values``
        are focus errors so far from zero that predictions must be made there.
        """
        model = model.sampled_as(self.campaign.sensor)
        key = _key(model, values)
        if key == self.model.digest():
            return self.problem
        if key not in self.problems:
            near = (self.problem, *self.problems.values())
            self.problems[key] = made = make_problem(self.problem.predictor, Point(model, values or {}), seeds=seeds, near=near)
            made.columns.update(self.problem.columns)  # they are taken anew where a fit moves away from where these were
        return self.problems[key]

    def stands_for(self, model: CameraModel, problem: Problem, values: Mapping[str, float]) -> None:
        """Predict with ``model`` in a problem that was made so close to it, and to these focus errors, that its weights hold."""
        model = model.sampled_as(self.campaign.sensor)
        self.problems |= {_key(model, values): problem, _key(model): problem}

    def settled(self, model: CameraModel) -> tuple[Problem, Fit]:
        """The problem and its nuisance fit; simulated anew where focus or levels lie far from where they are stated.

        Noise and bias of an edge depend on focus, those of a mean on its level: weights made elsewhere judge wrongly.  At
        another focus they may have driven the other nuisances away, or led them to where they belong, which chi2 has many
        valleys between: they start at zero again and where they were, and the better end counts.
        """
        model = model.sampled_as(self.campaign.sensor)
        key = model.digest()
        if key not in self.places:
            self.places[key] = self._settled(model)
        return self.places[key]

    def _settled(self, model: CameraModel) -> tuple[Problem, Fit]:
        problem, fitted = self.problem_for(model), self.fit_nuisances(model)
        values: dict[str, float] = {}
        for _ in range(MAX_PLACES):
            if not moved_far(fitted, values):
                break
            values = far_values(fitted)
            problem = self.problem_for(model, values=values)
            focused = any(f.focus and f.label in values for f in fitted.free)
            there, free = Point(model, {**fitted.point.values, **values}), fitted.free
            fitted = fit(problem, Point(model, values) if focused else there, free)
            if focused:
                with suppress(InputError):  # rows that are seen at this focus may be lost with the other nuisances
                    fitted = min(fitted, fit(problem, there, free), key=lambda end: end.cost)
        return problem, told_here(problem, fitted) if values else fitted

    def fit_nuisances(self, model: CameraModel) -> Fit:
        """The fit in which only the campaign's nuisances are free."""
        model = model.sampled_as(self.campaign.sensor)
        key = model.digest()
        if key not in self.fits:
            problem, nominal = self.problem_for(model), self.fits.get(self.model.digest())
            free = nuisance_parameters(problem.plan, model)
            if nominal is not None and _is_astray(nominal):
                nominal = None
            self.fits[key] = (
                fit(problem, deepest(problem, Point(model), free), free)
                if nominal is None
                else fit(problem, Point(model, nominal.point.values), free, pose=nominal.pose)
            )
        return self.fits[key]

    def chi2(self, model: CameraModel, *, weights: CameraModel) -> float:
        """chi2 of the campaign under a model with base and weights simulated with another, nuisances refitted.

        Two models are compared with the same weights: their difference is then free of Monte-Carlo noise.
        """
        model = model.sampled_as(self.campaign.sensor)
        problem, settled = self.settled(weights)
        if model.digest() == weights.sampled_as(self.campaign.sensor).digest():
            return settled.chi2
        free = nuisance_parameters(problem.plan, model)
        if _is_astray(settled):
            return fit(problem, Point(model), free).chi2
        return fit(problem, Point(model, settled.point.values), free, pose=settled.pose).chi2

    def close(self) -> None:
        """Stop the workers."""
        self.problem.predictor.close()

    def __enter__(self) -> Prepared:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def _is_astray(fitted: Fit) -> bool:
    """Whether an unknown stands `FAR` prior sigmas off: what a model lacks may have driven it there, and no other starts there.

    Of a camera whose model is right one of a hundred unknowns does so in one of four sessions.
    """
    return any(
        f.prior is not None and abs(f.weight * (v - f.center)) > FAR for f, v in zip(fitted.free, fitted.values, strict=True)
    )


def _key(model: CameraModel, values: Mapping[str, float] | None = None) -> str:
    return model.digest() + (repr(sorted(values.items())) if values else "")


def prepare(
    model: CameraModel, campaign: Campaign, *, jobs: int = 1, say: Say | None = None, table: MetricTable | None = None
) -> Prepared:
    """Measure a campaign and simulate its plan with ``model``.

    Raises
    ------
    InputError
        If the campaign has no captures, another sensor than the model, or nothing that can be measured.
    """
    say = Teller.of(say)
    if campaign.is_plan:
        raise InputError(f"campaign {campaign.name} has no captures; simulate it, or put the files of its shots beside it")
    model = model.sampled_as(campaign.sensor)
    check_sensor(model, campaign)
    say(f"measuring {len(campaign.shots)} shots of {campaign.name}")
    with closing(Runner(jobs, say.counted)) as runner:  # until the predictor goes on with its workers
        nominal = nominal_of(model, campaign, runner)
        table = table or measure_campaign(
            campaign,
            choices=that_hold(campaign, nominal),
            summaries=False,
            progress=lambda _, done, total: say.counted(done, total),
        )
        campaign = _without_broken(campaign)
        usual = [e.name for e in model.effects]
        predictor = Predictor(campaign, table, usual=usual, rows=nominal.rows, jobs=jobs, progress=say.counted)
        say(f"simulating the plan with {model.name}")
        try:
            problem = make_problem(
                predictor, Point(model), base=predictor.base(Point(model), _replicas(campaign), darks=PLAIN_REPLICAS)
            )
        except BaseException:
            predictor.close()  # what was simulated is kept
            raise
    table = replace(table, notes=(*table.notes, *_without_counterpart(problem), *_filling_up(problem)))
    return Prepared(model, campaign, table, problem)


def _replicas(campaign: Campaign) -> int:
    """Simulated campaigns behind the nominal prediction: more where they are cheap, since all captures of a plan share them."""
    plain = all(shot.role in ("dark", "flat") and shot.given is None for shot in campaign.shots)
    return PLAIN_REPLICAS if plain else REPLICAS


def _without_counterpart(problem: Problem) -> list[str]:
    """A remark on rows of metrics files that the simulation gives no number for."""
    table = problem.predictor.table
    kept = set(problem.keep.tolist())
    lost = [table.metrics[i] for i in np.flatnonzero(given_rows(table)) if i not in kept]
    if not lost:
        return []
    return [
        f"{len(lost)} given rows have no counterpart in the simulation and are left out, the first: {row_words(lost[0])} of shot "
        f"{lost[0].shot} (check its channel, exposure, window and target)"
    ]


def _filling_up(problem: Problem) -> list[str]:
    """A remark on planes that are left out since they are full in a part of the light that the campaign allows for."""
    table = problem.predictor.table
    rows = np.flatnonzero(problem.filling.partly) if problem.filling else ()
    planes = [f"{m.shot} {m.channel}" for m in (table.metrics[i] for i in rows) if m.name == "mean"]
    if not planes:
        return []
    return [
        f"{len(planes)} planes of flats are left out, which fill up within the light's tolerance: {', '.join(planes[:4])}"
        f"{', ...' if len(planes) > 4 else ''} (expose less, or state the light closer)"
    ]


def _without_broken(campaign: Campaign) -> Campaign:
    """The plan of what was measured: files that could not be read are taken out of their shots."""
    broken = {file for file, _ in campaign.captures.skipped}
    if not broken:
        return campaign

    def mended(shot: Shot) -> Shot:
        files = tuple(file for file in shot.files if file not in broken)
        return replace(shot, files=files, frames=max(1, len(files)))

    return replace(campaign, shots=tuple(mended(shot) for shot in campaign.shots))


def split_sessions(campaign: Campaign, holdout: Campaign | None) -> tuple[Campaign, Campaign | None]:
    """The captures to learn from and those to confirm on: a second measurement session, unless given."""
    sessions = campaign.sessions
    if holdout is not None or len(sessions) < 2:
        return campaign, holdout
    return campaign.session(sessions[0]), campaign.session(sessions[1])


def repeat_gate(prepared: Prepared, problem: Problem | None = None, fitted: Fit | None = None) -> dict[str, Any]:
    """Whether repeated set-ups agree within the error bars of ``problem`` at ``fitted`` (default: those of the prepared model).

    z of the difference of a shot and the one it repeats, weighted with the sampling covariance and the
    set-up scope priors of both; the mean square must be 1 within max(0.05, 3 sd), or below what the replicas show of it: the
    ten contrasts of an edge hold five numbers, and are weighted as if they held a little more.

    Returns
    -------
    dict
        ``run`` (False without repeats), ``failed``, ``mean_square_z``, ``n``, ``allowed``.
    """
    problem = problem or prepared.problem
    rows, difference, spread = repeat_differences(prepared, problem, fitted)
    if not rows:
        return {"run": False, "failed": False, "mean_square_z": None, "n": 0, "allowed": None}
    values, vectors = np.linalg.eigh(spread)
    use = values > 1e-9 * values.max()
    z = (vectors.T @ difference)[use] / np.sqrt(values[use])
    square, n = float(np.mean(z**2)), int(use.sum())
    from scipy.stats import chi2, norm

    # 3 standard deviations as a probability: chi2 is skew where the repeats are few
    expected = _expected_square(problem, rows, vectors[:, use], values[use])
    free = max(n * expected, 1.0)
    low, high = expected * float(chi2.ppf(norm.sf(3), free)) / free, float(chi2.ppf(norm.cdf(3), n)) / n
    failed = not min(low, 1 - MIN_GATE) <= square <= max(high, 1 + MIN_GATE)
    allowed = max(high, 1 + MIN_GATE) - 1
    return {"run": True, "failed": failed, "mean_square_z": square, "n": n, "allowed": allowed}


def gate_with(prepared: Prepared, nominal: Mapping[str, Any], problem: Problem, fitted: Fit) -> dict[str, Any]:
    """A gate that failed with the nominal camera's error bars (``nominal``), asked with those of another model.

    A strong effect changes what repeats should differ by: behind a smoothing rows and columns scatter otherwise, behind a bent
    converter two levels of one light are no longer in proportion.  ``nominal_mean_square_z`` keeps what it was.
    """
    if not nominal["failed"] or problem is prepared.problem:
        return dict(nominal)
    first = nominal.get("nominal_mean_square_z", nominal["mean_square_z"])
    return repeat_gate(prepared, problem, fitted) | {"nominal_mean_square_z": first}


def _expected_square(problem: Problem, rows: Sequence[tuple[int, int]], axes: Float, stated: Float) -> float:
    """Mean square of z (``axes`` (pairs, n) of variances ``stated``) where captures scatter as the replicas do; 1 at most."""
    first, second = np.transpose(rows)
    apart = problem.base.values[:, first] - problem.base.values[:, second]
    both = np.concatenate([first, second])
    pick = np.concatenate([axes, -axes])
    sampled = np.sum(pick * (problem.base.covariance[np.ix_(both, both)] @ pick), axis=0)
    shown = np.var(apart @ axes, axis=0, ddof=1)
    return min(1.0, float(np.mean((stated - sampled + shown) / stated)))


def repeat_differences(
    prepared: Prepared, problem: Problem, fitted: Fit | None = None
) -> tuple[list[tuple[int, int]], Float, Float]:
    """Rows of repeated set-ups in pairs, their differences (pairs,), and the covariance (pairs, pairs) that these should have."""
    table = prepared.table
    every = _paired_rows(table, problem, [(s, s.repeat_of) for s in prepared.campaign.shots if s.repeat_of is not None])
    rows = [pair for pair in every if not _is_a_length_near_zero(table, pair)]
    pick = np.zeros((len(rows), len(table.metrics)))
    for i, (a, b) in enumerate(rows):
        pick[i, a], pick[i, b] = 1.0, -1.0
    local = pick[:, problem.keep]
    covariance = problem.covariance[np.ix_(problem.keep, problem.keep)] / problem.base.with_simulation(problem.keep)
    spread = local @ covariance @ local.T + (
        _set_up_part(problem, fitted or prepared.fit_nuisances(prepared.model), local) if rows else 0.0
    )
    return rows, pick @ np.nan_to_num(table.values), spread


def _is_a_length_near_zero(table: MetricTable, pair: tuple[int, int]) -> bool:
    """Whether one of two contrasts stands so near zero that it may be on either side of it.

    An OTF that passes through zero with the frequency has a length that goes down and up: where one of two repeats passes sooner,
    a row falls with its neighbors in one and rises against them in the other, and no covariance holds for both.
    """
    metrics = [table.metrics[i] for i in pair]
    return all(m.family == CONTRAST for m in metrics) and any(abs(m.value) < NEAR_ZERO * m.sigma for m in metrics)


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


def _set_up_part(problem: Problem, fitted: Fit, local: Float) -> Float:
    """Covariance of differences ``local`` (pairs, kept rows) by what every set-up has of its own.

    Differentiated where the nuisances stand: a light's level moves the colors in the proportion that its spectrum gives them.
    With the proportion of the stated spectrum, 4 % off, two set-ups 7 % apart would differ by 7 sigma more than they do.
    """
    free = [f for f in fitted.free if f.is_nuisance and f.scope == "set-up"]
    if not free:
        return np.zeros((len(local), len(local)))
    metrics = problem.predictor.table.metrics
    paired = {metrics[i].shot for i in problem.keep[np.any(local != 0, axis=0)]}
    repeated = replace(problem, predictor=problem.predictor.only(paired))
    raw = np.column_stack(slopes(repeated, fitted.point, free))[problem.keep]
    columns = local @ raw * np.array([f.prior or 0.0 for f in free])
    return np.asarray(columns @ columns.T)
