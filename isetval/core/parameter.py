"""Parameters that a fit may move: of a camera's effects, and the unknowns of a laboratory (nuisances)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

MODEL = "model"
"""Scope of a parameter that belongs to the camera model itself; all other scopes are nuisances of a campaign."""


@dataclass(frozen=True)
class NuisanceKind:
    """What a laboratory may not know of a shot.

    ``curved``: metrics bend within a few prior sigmas, so that derivatives are taken anew where it has moved;
    ``focus``: it is an error of the focus scale, which a lens's own defocus imitates exactly;
    ``factor``: it is what something is multiplied with less 1, so that it never falls below -1;
    ``each_patch``: every patch of a chart has a value of its own, named ``NAME:PATCH``;
    ``of_rows``: it changes rows and no picture: nothing simulates or fits it, the rows are weighed by it.
    """

    unit: str
    doc: str
    curved: bool = False
    focus: bool = False
    factor: bool = False
    each_patch: bool = False
    of_rows: bool = False


@dataclass(frozen=True)
class Parameter:
    """One number that a fit may move.

    Parameters
    ----------
    name : str
        Of the effect's parameter or of the nuisance.
    owner : str
        The effect it belongs to; empty for what belongs to shots.
    scope : str
        `MODEL`, or what shares one value: campaign, measurement session, set-up, frame.
    group : str
        Which session, set-up or frame.
    only : tuple of str
        Roles and lights that a nuisance is restricted to.
    prior : float or None
        Standard deviation of its Gaussian prior around ``center`` (None: no prior).
    step : float
        Finite difference of derivatives, in the parameter's unit.
    factor : bool
        Whether something is multiplied with 1 + value, which stays above 0.
    patch : str
        The patch of a chart whose rows it moves (empty: any): parameters of several patches are differentiated in one step.
    """

    name: str
    owner: str = ""
    scope: str = MODEL
    group: str = ""
    only: tuple[str, ...] = ()
    unit: str = "1"
    prior: float | None = None
    step: float = 1.0
    center: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    curved: bool = False
    focus: bool = False
    factor: bool = False
    patch: str = ""

    @property
    def key(self) -> str:
        """What it is, whoever shares it: ``effect.parameter`` or the nuisance's name."""
        return f"{self.owner}.{self.name}" if self.owner else self.name

    @property
    def label(self) -> str:
        """Its name in results and in the values of a simulation: the key, and for nuisances who shares the value."""
        if self.scope == MODEL:
            return self.key
        return f"{self.key}@{self.scope}:{self.group}" + (f"[{','.join(self.only)}]" if self.only else "")

    @property
    def is_nuisance(self) -> bool:
        """Whether it is an unknown of the laboratory rather than a part of the model."""
        return self.scope != MODEL

    @property
    def weight(self) -> float:
        """One over the prior's standard deviation; 0 without a prior."""
        return 0.0 if self.prior is None else 1 / self.prior

    @property
    def reach(self) -> float:
        """What a long way is for it: the prior's standard deviation, or the step where it has none."""
        return self.prior or self.step

    def stepped(self, step: float) -> Parameter:
        """The same with another finite difference."""
        return replace(self, step=step)


def split_key(key: str) -> tuple[str, str]:
    """Owner and name of ``effect.parameter``; no owner for the name of a nuisance."""
    owner, _, name = key.rpartition(".")
    return owner, name
