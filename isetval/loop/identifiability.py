"""What could be told apart with a plan, before anything is measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.camera.shooting import simulate
from isetval.core.campaign import Campaign
from isetval.core.jsonable import plain
from isetval.core.shown import Drawn
from isetval.loop.camera_scale import brightest_of
from isetval.loop.candidates import candidates_for
from isetval.loop.derivatives import nuisance_parameters
from isetval.loop.fit import fit
from isetval.loop.next_captures import KEEP, next_captures
from isetval.loop.prediction import Point
from isetval.loop.prepared import prepare
from isetval.loop.result import NextCapture
from isetval.loop.score_test import cosine, make_frame, score
from isetval.loop.signatures import signatures

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.float64]
CLOSE = 0.7  # cosine of a pair that is listed: above it half of one's chi2 is explained by the other
MAX_PAIRS = 8  # pairs for which further captures are searched: each costs as much as a short campaign
FALSE_ALARMS = 0.01  # in a true model, all candidates together: the detective's own level
POWERS = (0.5, 0.95)


@dataclass(frozen=True)
class Detectability:
    """How well a parameter would be known: standard deviation, prior scale, strengths found with 50 and 95 % power.

    Both strengths are of this parameter alone, the effect's others at nothing.
    """

    effect: str
    parameter: str
    unit: str
    sigma: float
    smallest_detectable: float | None
    half_detectable: float | None
    tau: float
    observable: bool


@dataclass(frozen=True, eq=False, repr=False)
class Identifiability(Drawn):
    """What a plan can tell: per parameter, per pair (profiled cosine rho), and captures that would help."""

    parameters: tuple[Detectability, ...]
    unobservable: tuple[str, ...]
    pairs: tuple[tuple[str, str, float], ...]
    next_captures: tuple[NextCapture, ...]
    next_of_pair: Mapping[tuple[str, str], NextCapture] = field(default_factory=dict)

    def headline(self) -> str:
        """How many parameters are seen, what is not."""
        seen, hidden = sum(p.observable for p in self.parameters), len(self.unobservable)
        return f"{seen} of {len(self.parameters)} parameters seen, {hidden} effects not, {len(self.pairs)} close pairs"

    def to_frame(self) -> pd.DataFrame:
        """One row a parameter: effect, parameter, unit, sigma, smallest_detectable, half_detectable, tau, observable."""
        import pandas as pd

        return pd.DataFrame([vars(p) for p in self.parameters], columns=list(Detectability.__dataclass_fields__))

    def to_json(self) -> dict[str, Any]:
        """Plain numbers and words; None for what is not finite."""
        found: dict[str, Any] = {
            "parameters": [vars(p) for p in self.parameters],
            "unobservable": list(self.unobservable),
            "pairs": [{"effects": [a, b], "rho": rho, "next": self._next_json(a, b)} for a, b, rho in self.pairs],
            "next_captures": [vars(c) | {"separates": list(c.separates)} for c in self.next_captures],
        }
        return {name: plain(value) for name, value in found.items()}

    def _next_json(self, a: str, b: str) -> dict[str, Any] | None:
        """The capture that separates a pair best; None where none that was tried does, or none was searched."""
        found = self.next_of_pair.get((a, b))
        return None if found is None else {"capture": found.capture, "rho_after": found.rho_after}


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
        every = candidates_for(model, brightest=brightest_of(problem.plan))
        own = [c for c in every if c.name == c.klass]  # of several forms of an effect the first speaks for it
        made = signatures(problem, Point(model), own, project=frame.basis[: frame.rows])
        each = problem.whitened_each([s.columns for s in made])
        white = {s.candidate.name: part for s, part in zip(made, each, strict=True)}
        rows, hidden = [], []
        for s in made:
            c = s.candidate
            found = score(frame, white[c.name])
            seen = found.shows(c.tau)
            if not seen:
                hidden.append(c.name)
            sigmas = noncentralities(found.rank, len(made), one_sided=bool(c.only_side))
            lengths = np.linalg.norm(frame.profiled(white[c.name]), axis=0)
            for p, sigma, length in zip(c.parameters, found.sigma, lengths, strict=True):
                half, nearly = (float(s / length) if length > 0 and found.rank else None for s in sigmas)
                rows.append(Detectability(c.name, p.name, p.unit, float(sigma), nearly, half, float(p.tau or 0), seen))
        names = [n for n in white if n not in hidden]
        pairs = [(a, b, cosine(frame, white[a], white[b])) for i, a in enumerate(names) for b in names[i + 1 :]]
        pairs = sorted((p for p in pairs if p[2] > CLOSE), key=lambda p: p[2], reverse=True)
        by_name = {s.candidate.name: s for s in made}
        close = [(by_name[a], by_name[b]) for a, b, _ in pairs[:MAX_PAIRS]]
        captures = next_captures(problem, fitted, close, keep=None) if with_next_captures else []
        best = {pair: next(c for c in captures if c.separates == pair) for pair in dict.fromkeys(c.separates for c in captures)}
        return Identifiability(tuple(rows), tuple(hidden), tuple(pairs), tuple(captures[:KEEP]), best)


def noncentralities(rank: int, tests: int, *, one_sided: bool = False) -> tuple[float, ...]:
    """Significances s at which an effect of ``rank`` visible parameters is found with 50 and 95 % power.

    The score is chi2 of ``rank`` degrees of freedom, non-central by s^2; `FALSE_ALARMS` is shared out evenly between
    ``tests`` candidates (Bonferroni), and a single parameter that can only grow is tested on its side only.
    """
    from scipy.optimize import brentq
    from scipy.stats import chi2, ncx2

    level = FALSE_ALARMS / tests * (2 if one_sided and rank == 1 else 1)
    limit = float(chi2.isf(level, max(rank, 1)))
    return tuple(float(brentq(lambda s, p=power: ncx2.sf(limit, max(rank, 1), s * s) - p, 1e-3, 60.0)) for power in POWERS)


def _shot(model: CameraModel, plan: Campaign, seed: int) -> Campaign:
    """The plan as the model shoots it; metrics that are given instead of captures stay, with their covariance."""
    told = [shot.name for shot in plan.shots if shot.given is not None and not shot.files]
    rest = [shot.name for shot in plan.shots if shot.name not in told]
    if not rest:
        return plan.as_plan()
    taken = simulate(model, plan.only(rest).as_plan(), seed=seed)
    shots = (*taken.shots, *(shot for shot in plan.shots if shot.name in told))
    return replace(taken, shots=shots)
