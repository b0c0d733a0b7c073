"""What could be told apart with a plan, before anything is measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.camera.shooting import simulate
from isetval.core.campaign import Campaign
from isetval.core.shown import Drawn
from isetval.loop.candidates import candidates_for, signatures
from isetval.loop.evidence import smallest_detectable
from isetval.loop.fit import fit, nuisance_parameters
from isetval.loop.next_captures import next_captures
from isetval.loop.prediction import Point
from isetval.loop.prepared import prepare
from isetval.loop.result import NextCapture
from isetval.loop.score_test import cosine, make_frame, score

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.float64]
CLOSE = 0.7  # cosine of a pair that is listed: above it half of one's chi2 is explained by the other
MAX_PAIRS = 8  # pairs for which further captures are searched: each costs as much as a short campaign


@dataclass(frozen=True)
class Detectability:
    """How well a parameter would be known: standard deviation, smallest strength found with 95 % power, prior scale."""

    effect: str
    parameter: str
    unit: str
    sigma: float
    smallest_detectable: float | None
    tau: float
    observable: bool


@dataclass(frozen=True, eq=False, repr=False)
class Identifiability(Drawn):
    """What a plan can tell: per parameter, per pair (profiled cosine rho), and captures that would help."""

    parameters: tuple[Detectability, ...]
    unobservable: tuple[str, ...]
    pairs: tuple[tuple[str, str, float], ...]
    next_captures: tuple[NextCapture, ...]

    def headline(self) -> str:
        """How many parameters are seen, what is not."""
        seen, hidden = sum(p.observable for p in self.parameters), len(self.unobservable)
        return f"{seen} of {len(self.parameters)} parameters seen, {hidden} effects not, {len(self.pairs)} close pairs"

    def to_frame(self) -> pd.DataFrame:
        """One row a parameter: effect, parameter, unit, sigma, smallest_detectable, tau, observable."""
        import pandas as pd

        return pd.DataFrame([vars(p) for p in self.parameters], columns=list(Detectability.__dataclass_fields__))

    def to_json(self) -> dict[str, Any]:
        """Plain numbers and words."""
        return {
            "parameters": [vars(p) for p in self.parameters],
            "unobservable": list(self.unobservable),
            "pairs": [{"effects": [a, b], "rho": rho} for a, b, rho in self.pairs],
            "next_captures": [vars(c) | {"separates": list(c.separates)} for c in self.next_captures],
        }


def identify(
    model: CameraModel,
    plan: Campaign,
    *,
    seed: int = 0,
    jobs: int = 1,
    say: Callable[[str], None] | None = None,
    with_next_captures: bool = True,
) -> Identifiability:
    """What could be told apart with ``plan``, before measuring.

    The model shoots the plan once; standard deviations come from the profiled Fisher information of
    the simulated signatures (nuisances free within their priors).

    Raises
    ------
    InputError
        If the plan's sensor is not the model's, or nothing in it can be measured.
    """
    shot = _shot(model, plan, seed)
    with prepare(model, shot, jobs=jobs, say=say) as prepared:
        problem = prepared.problem
        fitted = fit(problem, Point(model), nuisance_parameters(problem.plan, model))
        frame = make_frame(fitted)
        made = signatures(problem, Point(model), candidates_for(model), project=frame.basis[: frame.rows])
        white = {s.candidate.name: problem.whitened(s.columns) for s in made}
        rows, hidden = [], []
        for s in made:
            c = s.candidate
            found = score(frame, white[c.name])
            seen = bool(found.rank and np.any(found.sigma < c.tau))
            if not seen:
                hidden.append(c.name)
            for p, sigma in zip(c.parameters, found.sigma, strict=True):
                smallest = smallest_detectable(found) if len(c.parameters) == 1 else None
                rows.append(Detectability(c.name, p.name, p.unit, float(sigma), smallest, float(p.tau or 0), seen))
        names = [n for n in white if n not in hidden]
        pairs = [(a, b, cosine(frame, white[a], white[b])) for i, a in enumerate(names) for b in names[i + 1 :]]
        pairs = sorted((p for p in pairs if p[2] > CLOSE), key=lambda p: p[2], reverse=True)
        by_name = {s.candidate.name: s for s in made}
        close = [(by_name[a], by_name[b]) for a, b, _ in pairs[:MAX_PAIRS]]
        captures = tuple(next_captures(problem, fitted, close)) if with_next_captures else ()
        return Identifiability(tuple(rows), tuple(hidden), tuple(pairs), captures)


def _shot(model: CameraModel, plan: Campaign, seed: int) -> Campaign:
    """The plan as the model shoots it; metrics that are given instead of captures stay, with their covariance."""
    told = [shot.name for shot in plan.shots if shot.given is not None and not shot.files]
    rest = [shot.name for shot in plan.shots if shot.name not in told]
    if not rest:
        return plan.as_plan()
    taken = simulate(model, plan.only(rest).as_plan(), seed=seed)
    shots = (*taken.shots, *(shot for shot in plan.shots if shot.name in told))
    return replace(taken, shots=shots)
