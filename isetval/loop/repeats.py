"""Whether repeated set-ups agree within the error bars, and by how much they differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.campaign import Shot
from isetval.core.metric import MetricTable
from isetval.loop.block_factor import part_of
from isetval.loop.fit import Fit
from isetval.loop.gaussian import towards_one
from isetval.loop.prepared import Prepared
from isetval.loop.problem import Problem
from isetval.loop.slopes import slopes

Float = NDArray[np.float64]
CONTRAST, NEAR_ZERO = "mtf", 3.0  # sigmas of a contrast within which it may be on either side of zero, once in 700 farther off
MIN_GATE = 0.05  # what sigma may be off by, however many repeats there are: 2.5 % of it


@dataclass(frozen=True)
class Session:
    """A session, and the error bars that its repeats are judged with: those of ``problem`` at ``fitted``.

    Without them the error bars are those of the model that the session was prepared with.
    """

    prepared: Prepared
    problem: Problem | None = None
    fitted: Fit | None = None


@dataclass(frozen=True)
class _Repeated:
    """z of a session's repeats: the sum of their squares, and of what it is expected from.

    ``numbers`` is the sum where captures scatter as the replicas do, ``spread`` half its variance (the squares of the scales of
    the independent numbers in it), ``known`` how many replicas beyond the first tell it.
    """

    square: float
    numbers: float
    spread: float
    known: int


def repeat_gate(used: Session, *others: Session) -> dict[str, Any]:
    """Whether repeated set-ups agree within the error bars; where those ``used`` do not, whether those of all sessions do.

    Some sixty numbers scatter too far or too little by chance now and then; those of a second session tell.

    z of the difference of a shot and the one it repeats, weighted with the sampling covariance and the set-up scope priors of
    both; their mean square, over what it is where captures scatter as the replicas do (ten contrasts of an edge hold five
    numbers), must be 1 within max(0.05, 3 sd).  A sum of squares of unequal scales has the spread of fewer equal ones
    (Satterthwaite); with what it is over known from some replicas alone it is distributed as F.

    Returns
    -------
    dict
        ``run`` (False without repeats), ``failed``, ``mean_square_z``, ``n`` (how many numbers the repeated rows hold),
        ``allowed`` (by how much more than 1 it may be).
    """
    first = _repeated(used)
    if first is None:
        return {"run": False, "failed": False, "mean_square_z": None, "n": 0, "allowed": None}
    alone = _judged([first])
    more = [own for own in map(_repeated, others) if own is not None] if alone["failed"] else []
    return _judged([first, *more]) if more else alone


def _judged(found: Sequence[_Repeated]) -> dict[str, Any]:
    from scipy.special import fdtri, ndtr  # as of scipy.stats, whose import takes .4 s

    numbers = sum(own.numbers for own in found)
    square = sum(own.square for own in found) / numbers
    equal = max(numbers**2 / sum(own.spread for own in found), 1.0)
    # sessions of one plan share their replicas: of two, what the sum is over is known no better than of one
    known = equal / len(found) * min(own.known for own in found)
    # 3 standard deviations as a probability: F is skew where the repeats are few
    low, high = (float(fdtri(equal, known, p)) for p in (ndtr(-3.0), ndtr(3.0)))
    failed = not min(low, 1 - MIN_GATE) <= square <= max(high, 1 + MIN_GATE)
    allowed = max(high, 1 + MIN_GATE) - 1
    return {"run": True, "failed": failed, "mean_square_z": square, "n": round(numbers), "allowed": allowed}


def gate_with(nominal: Mapping[str, Any], *sessions: Session) -> dict[str, Any]:
    """A gate that failed with the nominal camera's error bars (``nominal``), asked with those of another model.

    A strong effect changes what repeats should differ by: behind a smoothing rows and columns scatter otherwise, behind a bent
    converter two levels of one light are no longer in proportion.  ``nominal_mean_square_z`` keeps what it was.
    """
    if not nominal["failed"] or all(s.problem is None or s.problem is s.prepared.problem for s in sessions):
        return dict(nominal)
    first = nominal.get("nominal_mean_square_z", nominal["mean_square_z"])
    return repeat_gate(*sessions) | {"nominal_mean_square_z": first}


def _repeated(session: Session) -> _Repeated | None:
    problem = session.problem or session.prepared.problem
    rows, difference, stated = repeat_differences(session.prepared, problem, session.fitted)
    if not rows:
        return None
    values, vectors = np.linalg.eigh(stated)
    use = values > 1e-9 * values.max()
    white = vectors[:, use] / np.sqrt(values[use])
    return _Repeated(float(np.sum((white.T @ difference) ** 2)), *_numbers_held(problem, rows, white), problem.base.replicas - 1)


def _numbers_held(problem: Problem, rows: Sequence[tuple[int, int]], white: Float) -> tuple[float, float]:
    """What squares of z (``white`` (pairs, n): whitening) sum to where captures scatter as the replicas do, half its variance.

    The traces of the covariance C of z and of its square.  For the latter k + 1 replicas of sample covariance S stand with
    k^2 / ((k + 2) (k - 1)) (tr S^2 - tr(S)^2 / k) (Srivastava 2005, J. Japan Statist. Soc. 35, 251).  The sum is at most how many
    they are, and drawn towards that as the ladder's are (`gaussian.towards_one`).  Of what has no scatter in replicas (rows given
    with error bars) they say nothing.
    """
    first, second = np.transpose(rows)
    apart = problem.base.values[:, first] - problem.base.values[:, second]
    shows = np.ptp(apart, axis=0) > 0
    both = np.concatenate([first[shows], second[shows]])
    pick = np.concatenate([white[shows], -white[shows]])
    n, k = white.shape[1], problem.base.replicas - 1
    unseen = np.eye(n) - pick.T @ part_of(problem.base.covariance, both) @ pick
    z = apart[:, shows] @ white[shows]
    z = z - z.mean(axis=0)
    shown = z.T @ z / k
    total = float(np.trace(unseen + shown))
    of_shown = k**2 / ((k + 2) * (k - 1)) * (np.sum(shown**2) - np.trace(shown) ** 2 / k) if k > 1 else np.trace(shown)
    squares = float(of_shown + 2 * np.sum(unseen * shown) + np.sum(unseen**2))
    held = n * min(towards_one(total, n, problem.base.replicas), 1.0)
    return held, held**2 * max(squares / total**2, 1 / n)


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
    paired = np.any(local, axis=0)
    both = problem.keep[paired]
    covariance = part_of(problem.covariance, both) / problem.base.with_simulation(*np.ix_(both, both))
    spread = local[:, paired] @ covariance @ local[:, paired].T + (
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
