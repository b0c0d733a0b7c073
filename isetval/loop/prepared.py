"""A campaign measured once, and the problem of predicting it with a model: what comparing and diagnosing start from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import TracebackType

from isetval.camera.model import CameraModel
from isetval.camera.shooting import check_sensor
from isetval.core.campaign import Campaign, Shot
from isetval.core.errors import InputError
from isetval.core.metric import MetricTable
from isetval.loop.fit import Fit, far_values, fit, nuisance_parameters
from isetval.loop.prediction import DERIVATIVE_SEEDS, Point, Predictor
from isetval.loop.problem import Problem, make_problem
from isetval.measure.campaign import measure_campaign

Say = Callable[[str], None]


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
    table = table or measure_campaign(campaign, summaries=False)
    campaign = _without_broken(campaign)
    predictor = Predictor(campaign, table, jobs=jobs)
    say(f"simulating the plan with {model.name}")
    return Prepared(model, campaign, table, make_problem(predictor, Point(model)))


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
