"""What the data of one capture choose for its edge, to be chosen again for others: order, width, amplitudes, noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError
from isetval.measure.edge.esf_prior import width_of
from isetval.measure.edge.geometry import MAX_ORDER, Index, PerRegion
from isetval.measure.edge.illumination import SideNoise
from isetval.measure.edge.marginal_likelihood import Amplitudes

Float = NDArray[np.floating[Any]]
ORDER, WIDTH = "order", "width_index"
AMPLITUDES = ("even", "odd", "light")
NOISE = ("dark_dn2", "bright_dn2")  # variances of a sample on both sides, by which samples are weighted


@dataclass(frozen=True, eq=False)
class Choices(PerRegion):
    """What is chosen for the regions of a stack before their data are looked at, (regions,) each; None: the data choose."""

    order: Index | None = None
    width_px: Float | None = None
    amplitudes: Amplitudes | None = None
    noise: SideNoise | None = None

    @classmethod
    def of(cls, each: Sequence[Mapping[str, Any]]) -> Choices:
        """Of regions that have the same names chosen (`checked_choices`)."""
        first = each[0] if each else {}

        def all_of(name: str) -> Float:
            return np.array([own[name] for own in each], dtype=float)

        return cls(
            order=np.array([own[ORDER] for own in each], dtype=np.intp) if ORDER in first else None,
            width_px=np.array([width_of(own[WIDTH]) for own in each]) if WIDTH in first else None,
            amplitudes=Amplitudes(*map(all_of, AMPLITUDES)) if AMPLITUDES[0] in first else None,
            noise=SideNoise(*map(all_of, NOISE)) if NOISE[0] in first else None,
        )


def checked_choices(choices: Mapping[str, Any] | None) -> dict[str, Any]:
    """Choices of another result as plain numbers.

    Raises
    ------
    InputError
        For names or values that no result has.
    """
    kinds = {ORDER: int, WIDTH: int, **dict.fromkeys((*AMPLITUDES, *NOISE), float)}
    try:
        out = {name: kinds[name](value) for name, value in dict(choices or {}).items()}
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"choices are {choices!r}; they need {', '.join(kinds)} of another result") from error
    if not 1 <= out.get(ORDER, 1) <= MAX_ORDER:
        raise InputError(f"choices ask for order {out[ORDER]}; it needs 1 to {MAX_ORDER}")
    if set(AMPLITUDES) & out.keys() and not set(AMPLITUDES) <= out.keys():
        raise InputError("choices hold some of even, odd and light; they need all three or none")
    noise = [out[name] for name in NOISE if name in out]
    if len(noise) == 1 or not all(0 < value < np.inf for value in noise):
        raise InputError(f"choices hold variances {noise} of {' and '.join(NOISE)}; they need both above 0, or none")
    return out
