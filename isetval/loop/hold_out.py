"""What a second session says of hypotheses: effects as they were found, its own nuisances free."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from isetval.loop.evidence import Hypothesis, linear_model
from isetval.loop.fit import Fit
from isetval.loop.fit_state import POSED_FACTOR, walked
from isetval.loop.focus_chain import at_same_focus, focus_shifts
from isetval.loop.investigation import Investigation, draws_of, named_model
from isetval.loop.other_focus import best_of_places, other_places
from isetval.loop.posterior import NOTHING, Names
from isetval.loop.prediction import Point, Predictor
from isetval.loop.problem import Problem
from isetval.loop.score_test import score
from isetval.loop.slopes import at
from isetval.loop.stand_ins import numbered, renamed
from isetval.loop.subset_sum import Term, Weighed, weigh

Float = NDArray[np.float64]
LOOKED = (
    20  # single effects of which it is asked: of ninety so many stand 1.2 sigmas off by chance, 5 that are so faint 1 in 14,000
)
WALKS = 4  # of the nuisances to where a hypothesis has them: where planes fill up the first goes astray, the second is there


def ask_holdout(case: Investigation, others: Sequence[Hypothesis]) -> None:
    """Ask the hold-out of those hypotheses that it was not asked of, and let the sum know what it `said`."""
    asked = [h for h in others if h.names not in case.told and h is not case.standing]
    if case.held is None or not asked:
        return
    told = {h.names: word for h, word in zip(asked, said(case, asked), strict=True)}
    case.told |= told
    # what is linear about a hypothesis is no likelier beyond it in the hold-out than that itself
    logs, case.promised = (
        {n: value + (0.0 if n in case.heard else told.get(case.about.get(n, n), 0.0)) for n, value in table.items()}
        for table in (case.table.logs, case.promised)
    )
    known = {names: case.score(h) for names, h in case.known.items() if names in logs}
    case.table = replace(case.table, logs=logs | known)


def likely_in_both(case: Investigation) -> list[Names]:
    """Single effects that are likelier than nothing with both sessions together, the likeliest first, though no fit said so.

    Of an effect of five sigmas the captures used show two or three now and then, which ninety effects do by chance: alone they
    are no reason for a fit, and the hold-out was never asked.  Here it is asked of the linear model, with the amplitudes that the
    captures used give: 2.5 sigmas here and five there are e^9 and more.  Signatures are those of the captures used, in the rows
    that both sessions have.  Looked at are those that stand out most there, whatever the width of their priors: by their
    probability a knee that the hold-out shows was none of the first twenty (`full-scoring-1776`).
    """
    if case.held is None:
        return []
    logs, white = case.table.logs, case.white()
    effects = {frozenset({c.name}): c for c in case.candidates if c.name not in case.unobservable}
    chance = {
        names: score(case.nominal_frame, white[c.name], side=c.only_side).p_value
        for names, c in effects.items()
        if names in logs and names not in case.known
    }
    looked = sorted(chance, key=lambda names: chance[names])[:LOOKED]
    if not looked:
        return []
    terms = [Term(c.name, white[c.name], c.tau, c.side) for c in (effects[names] for names in looked)]
    here = linear_model(case.problem, case.known[NOTHING].fitted, terms)
    problem, settled = case.held.settled(case.prepared.model)
    place = _same_rows(case.problem.predictor, problem.predictor)
    linear = linear_model(problem, settled)
    alone = weigh(linear, ()).log_evidence
    free = len(case.known[NOTHING].fitted.free)

    def with_both(names: Names) -> float:
        columns, values = case.signatures[effects[names].name].columns, weigh(here, (looked.index(names),)).values[free:]
        moved = np.where(place >= 0, columns[place] @ (effects[names].tau * values), 0.0)
        shifted = replace(linear, z=linear.z - problem.whitened(moved))
        return logs[names] + weigh(shifted, ()).log_evidence - alone

    both = {names: with_both(names) for names in looked}
    return sorted((names for names in looked if both[names] > logs[NOTHING]), key=lambda names: -both[names])


def _same_rows(here: Predictor, there: Predictor) -> NDArray[np.intp]:
    """Of each row ``there`` the place of the same metric of the same kind of shot ``here``, (rows there,); -1 where none is."""
    places = {key: i for i, key in enumerate(_by_kind(here))}
    return np.array([places.get(key, -1) for key in _by_kind(there)], dtype=np.intp)


def _by_kind(predictor: Predictor) -> list[tuple[Hashable, ...]]:
    """What each row is, with what is seen in its shot in place of that one's name; the same shot again counts as the second."""
    kinds = numbered(predictor.shots)
    return [(renamed(m.key(), ""), kinds[m.shot]) for m in predictor.table.metrics]


def said(case: Investigation, asked: Sequence[Hypothesis]) -> list[float]:
    """What the hold-out says of hypotheses: ln of its probability over that with what stands; 0 without one.

    The effects stay as they were found, the nuisances of the hold-out are its own.  All are predicted at the nuisances that fit
    with what stands, and led from there to their bottoms by the same derivatives: fits of their own would end at other poses of
    the edges, where other noise is simulated (10 in ln Z between two models that are the same to a thousandth of a sigma).
    Those of lenses are fitted where focus may stand elsewhere with them (`isetval.loop.other_focus`).
    By how much an effect moves the film, focus errors take back first: twice as far out of focus no derivative leads back.
    All that bends no row is simulated where derivatives put it, if that is far from where what stands has it: a gain 1 % up
    fills planes that in 1 % less light are not full, and over eight prior sigmas of the light's shape the simulation's own noise
    in its derivatives came to 57 in ln Z.
    """
    if case.held is None:
        return [0.0] * len(asked)
    nominal = case.prepared.model
    problem, settled = case.held.settled(named_model(nominal, case.standing))
    problem = problem.with_draws(draws_of([m for h in (*asked, case.standing) for m in h.effects]))
    focus = [f for f in settled.free if f.focus]
    shifts = focus_shifts(problem, settled.point.model, focus)
    standing = _weighed_at(problem, settled, settled.point)
    if standing is None:  # a fit that stands nowhere compares nothing
        return [0.0] * len(asked)

    def log_probability(found: Hypothesis) -> float:
        point = Point(named_model(nominal, found), settled.point.values)
        if others := other_places(problem, settled, [m.effect for m in (*found.effects, *case.standing.effects)]):
            own = best_of_places(problem, point, settled.free, others)
            there = _weighed_at(problem, own, own.point)
            return -np.inf if there is None else there.weighed.log_evidence
        point = at_same_focus(problem, point, shifts, focus)
        return _at_its_bottom(problem, settled, point, standing.weighed.values)

    return [log_probability(h) - standing.weighed.log_evidence for h in asked]


def _at_its_bottom(problem: Problem, settled: Fit, point: Point, bottom: Float) -> float:
    """The evidence with all that bends no row walked to where it stands, until it is as near to there as a fit leaves it.

    ``bottom`` are steps that what stands is left by: they are common to all, and no way to go.
    """
    straight = np.array([not f.curved for f in settled.free], bool)
    near = np.array([POSED_FACTOR if f.factor and not f.patch else f.reach for f in settled.free])
    reach = np.array([f.reach for f in settled.free])
    best, goal = -np.inf, bottom
    for walk in range(WALKS + 1):
        there = _weighed_at(problem, settled, point)
        if there is None:
            break
        best = max(best, there.weighed.log_evidence)
        step = np.where(straight, (there.seen.values - goal) * reach, 0.0)
        if walk == WALKS or not np.any(np.abs(step) > near):
            break
        point, goal = at(point, settled.free, list(walked(there.values, step, settled.free))), np.zeros(len(bottom))
    return best


@dataclass(frozen=True, eq=False)
class _There:
    """Nuisances (values), the evidence with them led to their bottom by a fit's derivatives, and the same of rows ``seen``."""

    values: Float
    weighed: Weighed
    seen: Weighed


def _weighed_at(problem: Problem, settled: Fit, point: Point) -> _There | None:
    """The evidence at a point; None where nothing can be simulated.

    A plane that fills up there keeps the prediction that it had where it was none: it says how improbable the point is, and not
    which way to go (it held a glare of 2 % at full planes, and denied it by 567 in ln Z).
    """
    prediction, lost = problem.predict_seen(point)
    z = problem.whitened(problem.measured - prediction)
    values = np.array([point.values.get(f.label, 0.0) for f in settled.free])
    if not np.isfinite(z).all():
        return None
    here = replace(settled, values=values, prediction=prediction, z=z)
    weighed = weigh(linear_model(problem, here), ())
    if not lost.any():
        return _There(values, weighed, weighed)
    shown = replace(here, z=np.where(lost, 0.0, z), jacobian=np.where(lost[:, None], 0.0, settled.jacobian))
    return _There(values, weighed, weigh(linear_model(problem, shown), ()))
