"""Second thoughts: after a further effect is named, an earlier name may give way to one that it had beaten.

A first effect may have been named because it answered for two that were missing; with the second in the
model another candidate may explain the rest better.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from isetval.core.parameter import Parameter
from isetval.loop.evidence import PROBABILITY_CAP, Refit, log_hessian, without_prior, without_values
from isetval.loop.fit import Fit, fit, nuisance_parameters
from isetval.loop.investigation import ODDS, Investigation, named_model

Float = NDArray[np.float64]
Say = Callable[[str], None]


def swap(case: Investigation, say: Say) -> bool:
    """Replace earlier names where the evidence with all later ones prefers a beaten candidate by 19 to 1."""
    swapped = False
    for place, earlier in enumerate(case.named[:-1]):
        beaten = [r for r in case.runners_up[place] if r.candidate.name not in [other.candidate.name for other in case.named]]
        if not beaten:
            continue
        say(f"weighing {', '.join(r.candidate.name for r in beaten)} in place of {earlier.candidate.name} again")
        tried = [(joint := _in_place_of(case, place, rival), _odds(case, earlier, rival, joint), rival) for rival in beaten]
        joint, odds, rival = max(tried, key=lambda entry: entry[1])
        if odds > np.log(ODDS):
            _exchange(case, place, replace(rival, fitted=joint, log_evidence=earlier.log_evidence + odds), odds)
            say(f"named {rival.candidate.name} in place of {earlier.candidate.name}")
            swapped = True
    return swapped


def _in_place_of(case: Investigation, place: int, rival: Refit) -> Fit:
    """The joint fit with ``rival`` in place of one of the named effects."""
    others = [named for i, named in enumerate(case.named) if i != place]
    model = rival.candidate.model_with(named_model(case, others, case.fitted)).with_values(dict(rival.values))
    free: tuple[Parameter, ...] = nuisance_parameters(case.problem.plan, case.prepared.model)
    kept = [key for named in others for key in named.candidate.keys]
    gone: tuple[Parameter, ...] = ()
    for named in (*others, rival):
        free, dropped = without_prior(free, named.candidate)
        gone += dropped
    effects = [f for f in case.fitted.free if f.key in kept] + [f for f in rival.fitted.free if f.key in rival.candidate.keys]
    return fit(case.problem, without_values(case.fitted.point, gone, model), (*free, *effects))


def _odds(case: Investigation, earlier: Refit, rival: Refit, joint: Fit) -> float:
    """Logarithm of the evidence with ``rival`` over that with ``earlier``, the other effects in both (Laplace)."""
    widths = float(np.sum(np.log(earlier.candidate.tau)) - np.sum(np.log(rival.candidate.tau)))
    sides = float(np.log(2.0)) * (int(rival.candidate.one_sided) - int(earlier.candidate.one_sided))
    return (case.fitted.chi2 - joint.chi2) / 2 - (log_hessian(joint) - log_hessian(case.fitted)) / 2 + widths + sides


def _exchange(case: Investigation, place: int, rival: Refit, odds: float) -> None:
    """Put ``rival`` where another effect was named; that one is no rival of what has beaten it."""
    case.remarks.append(f"{case.named[place].candidate.name} was named first and gave way to {rival.candidate.name}")
    case.named[place] = rival
    case.fitted = rival.fitted
    case.equivalent[place] = case.rivals[place] = ()
    chance = min(1 / (1 + float(np.exp(-odds))), PROBABILITY_CAP)
    case.named_posteriors[place] = (chance, chance, chance)
