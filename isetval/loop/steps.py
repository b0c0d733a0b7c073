"""Finite steps in which effects are differentiated, and the values that a fit of them starts at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from isetval.core.parameter import Parameter
from isetval.loop.candidates import Candidate, Doubt
from isetval.loop.code_stair import CODES
from isetval.loop.fit import Fit
from isetval.loop.signatures import Signature

Float = NDArray[np.float64]
Member = Candidate | Doubt
STEP_SHARE = 0.02  # of a prior's width: smallest finite step of an effect's parameter, well above the noise of common numbers
SPAN = 10.0
"""Sigmas of a value that its finite step is long at least, or its prior's width: above the noise of rounded common random
numbers, and well inside the 50 within which signatures are straight (`signatures.WANTED`)."""
CLEAR_OF = SPAN / 2  # sigmas from its lowest value beyond which a value has a derivative to both sides: half of what noise allows
SAME_STEP = 0.1  # of a step: what a fit moves it by as its value and sigma move, and no reason for another fit
FAR_TOO_LONG = 2.0  # times what is ample: a step that the linear model asked for, and that a level may end on
NOISE_SHARE = 0.5
"""Of a noise's strength: its finite step.  Variances go as its square, of which central differences are exact at any step; short
ones measure which pixels happen to round to another code (row noise of 2 DN seemed known to .4 % in place of 4)."""
REACH = 1.5  # widths of a signature's secant that a fit starts away from the null at most: the secant bends beyond


def first_values(candidate: Candidate, signature: Signature, mean: Float) -> dict[str, float]:
    """Parameters to start a fit at, within their bounds, from the linear model's (in units of their priors' widths).

    A variance goes as the square of its parameter, and so does what is even: what a secant of one step says of half of it is a
    quarter.  What is
    counted in the pixels of a specimen starts where its signature was taken at least: with less than one of them in a window no
    derivative tells more from less.
    """
    moved = mean * candidate.tau
    step = np.abs(signature.steps)
    if candidate.effect.counted and candidate.effect.random == "sensor":
        moved = np.where(moved > 0, np.maximum(moved, step), moved)
    if candidate.goes_as_square or candidate.even:
        moved = step * np.sqrt(np.maximum(moved, 0.0) / step)
    reach = np.maximum(REACH * step, candidate.tau)
    low, high = ([getattr(p, side) for p in candidate.parameters] for side in ("low", "high"))
    values = np.clip(candidate.nominal + np.clip(moved, -reach, reach), low, high)
    return dict(zip(candidate.keys, map(float, values), strict=True))


def first_steps(candidate: Candidate, values: Mapping[str, float], sigma: Mapping[str, float] | None = None) -> dict[str, float]:
    """Finite steps of a candidate's parameters near some values, known to ``sigma`` where that is stated."""
    here = np.array([values[key] for key in candidate.keys])
    steps = np.maximum(candidate.effect.step_share * np.abs(here - candidate.nominal), STEP_SHARE * candidate.tau)
    steps = np.maximum(steps, [CODES * candidate.code_steps.get(key, 0.0) for key in candidate.keys])
    if _is_noise(candidate):
        steps = np.maximum(NOISE_SHARE * np.abs(here), steps)
    known = sigma or {} if candidate.effect.random == "none" else {}
    free = candidate.free(list(steps))
    return {f.key: _long_enough(f, known.get(f.key, 0.0), values[f.key]) for f in free}


def with_steps(free: Sequence[Parameter], members: Sequence[Member], values: Mapping[str, float]) -> tuple[Parameter, ...]:
    """Free parameters of a fit, those of ``members`` with the finite steps that suit where they stand now, or longer ones."""
    candidates = [m for m in members if isinstance(m, Candidate)]
    steps = {key: step for m in candidates for key, step in first_steps(m, values).items()}
    noise = {key for m in candidates if _is_noise(m) for key in m.keys}
    return tuple(f.stepped(max(steps.get(f.label, 0.0), 0.0 if f.label in noise else f.step)) for f in free)


def with_longer_steps(fitted: Fit, members: Sequence[Member]) -> tuple[Parameter, ...]:
    """What was free, with finite steps of effects at least `SPAN` times as long as values are uncertain, or as their priors.

    Rounded common random numbers give a derivative a noise of c sigmas in all rows together over its step h: as if the parameter
    were measured to h/c.  600 rows that are rounded to a fifth of their error bars have c = 5.  Steps of what is
    random stay as they are: its metrics go as its square.
    """
    steady = {key for m in members if isinstance(m, Doubt) or m.effect.random != "none" for key in m.keys}
    sigma = np.sqrt(np.diag(fitted.covariance))

    values = dict(zip((f.label for f in fitted.free), map(float, fitted.values), strict=True))
    least = {key: h for m in members if isinstance(m, Candidate) for key, h in first_steps(m, values).items()}

    def longer(f: Parameter, s: float) -> Parameter:
        if f.is_nuisance or f.key in steady:
            return f
        enough, ample = (_long_enough(f.stepped(least[f.key]), s, values[f.label], k) for k in (1, 2))
        one_sided = f.step > values[f.label] - f.low and np.isfinite(_longest(f, s, values[f.label]))
        good = enough <= f.step <= FAR_TOO_LONG * ample and not one_sided
        return f if good or abs(ample - f.step) <= SAME_STEP * f.step else f.stepped(ample)

    return tuple(longer(f, float(s)) for f, s in zip(fitted.free, sigma, strict=True))


def are_alike(some: Sequence[Parameter], others: Sequence[Parameter]) -> bool:
    """Whether finite steps are the same within `SAME_STEP`.

    A glare about `CLEAR_OF` sigmas off its lowest value has short steps to both sides, by which it may be found nearer, or long
    ones to one side, by which it may be found farther off: either is good, and each fit would ask for the other's.
    """
    return all(abs(a.step - b.step) <= SAME_STEP * abs(b.step) for a, b in zip(some, others, strict=True))


def _long_enough(f: Parameter, sigma: float, value: float, times: float = 1.0) -> float:
    """Its finite step, `SPAN` sigmas (``times`` more) at least, or as its prior is wide, that goes to both sides of the value."""
    return max(f.step, min(times * SPAN * sigma, f.prior or 0.0, _longest(f, sigma, value)))


def _longest(f: Parameter, sigma: float, value: float) -> float:
    """The longest step of a parameter that stands clear of its lowest value: half the way there, or `CLEAR_OF` sigmas.

    What goes as its square has exact central differences at any step and wrong ones to one side: a loss of 4.2 % stood there
    for 5.5, 5 sigmas off, by steps of 6 % that could go up only.
    """
    room = value - f.low
    return max(NOISE_SHARE * room, CLEAR_OF * sigma) if room >= CLEAR_OF * sigma else np.inf


def _is_noise(candidate: Candidate) -> bool:
    """Whether its parameters are strengths of noise, as the square of which metrics go."""
    return candidate.effect.random != "none" and not candidate.effect.rare and all(p.low == 0.0 for p in candidate.parameters)
