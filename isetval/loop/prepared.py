"""A campaign measured once, and the problem of predicting it with a model: what comparing and diagnosing start from."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.camera.shooting import check_plan
from isetval.core.cache import content_hash
from isetval.core.campaign import Campaign, Shot
from isetval.core.effect import Effect
from isetval.core.errors import InputError
from isetval.core.given import row_words
from isetval.core.metric import MetricTable
from isetval.loop.best_focus import off_best_focus
from isetval.loop.derivatives import nuisance_parameters
from isetval.loop.fit import FAR, Fit, far_values, fit, moved_far, told_here
from isetval.loop.given_side import given_rows
from isetval.loop.nominal import Nominal, nominal_of
from isetval.loop.other_focus import best_of_places, other_places
from isetval.loop.prediction import DERIVATIVE_SEEDS, REPLICAS, Point, Predictor
from isetval.loop.problem import Problem
from isetval.loop.task_runner import Runner
from isetval.loop.telling import Say, Teller
from isetval.loop.valleys import deepest
from isetval.loop.weighing import make_problem
from isetval.measure.campaign import measure_campaign
from isetval.measure.kept_shots import KeptShots

Float = NDArray[np.float64]
PLAIN_REPLICAS = 64
"""Of plans of darks and flats, a fifth of a second each: the variance of a family of ten rows is then known to 6 %.  With 16 it
was 11 %, the same in every diagnosis of a plan: fresh captures of the very model stood at 1.29 in one family of 18.  Edges and
charts cost ten times as much."""
DARK_REPLICAS = 128
"""Of darks, which are few and cheap beside all else: a variance of ten rows is known to sqrt(2 / (127 * 10)) = 4 %."""
MAX_PLACES = 4  # places at which weights are made for one fit: a bound on cost, the second is the last where focus moved


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
            made.take_over(self.problem)
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
            if nominal is None:
                self.fits[key] = fit(problem, deepest(problem, off_best_focus(problem, Point(model), free), free), free)
            else:
                others = other_places(problem, nominal, self._added(model))
                self.fits[key] = best_of_places(problem, Point(model, nominal.point.values), free, others, nominal.pose)
        return self.fits[key]

    def _added(self, model: CameraModel) -> list[Effect]:
        """The effects of a model that are other than those of the nominal one."""
        own = {effect.content() for effect in self.model.effects}
        return [effect for effect in model.effects if effect.content() not in own]

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
    check_plan(model, campaign)
    say(f"measuring {len(campaign.shots)} shots of {campaign.name}")
    with closing(Runner(jobs, say.counted)) as runner:  # until the predictor goes on with its workers
        nominal = nominal_of(model, campaign, runner)
        chosen = Nominal(nominal.choices)  # goes to the workers with each shot: the keys of all rows need not
        table = table or measure_campaign(
            campaign,
            choices=chosen.that_hold,
            summaries=False,
            over=runner.in_turn,
            kept=KeptShots(content_hash(nominal.choices)),
            progress=lambda _, done, total: say.counted(done, total),
        )
        campaign = _without_broken(campaign)
        usual = [e.name for e in model.effects]
        predictor = Predictor(campaign, table, usual=usual, rows=nominal.rows, jobs=jobs, progress=say.counted)
        say(f"simulating the plan with {model.name}")
        try:
            problem = make_problem(
                predictor, Point(model), base=predictor.base(Point(model), _replicas(campaign), darks=DARK_REPLICAS)
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
