"""Light or charge of one pixel found in another: colors mix, and pictures blur."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, ParameterInfo, parameter
from isetval.core.sensor import plane_position
from isetval.core.signal import Signal

Float = NDArray[np.float64]
CROSSTALK_FORMS = ("matrix", "neighbors", "pixels")


@dataclass(frozen=True, kw_only=True)
class SpectralCrosstalk(Effect):
    """Electrons of one colour channel found in another: the same mixing matrix under all lights.

    ``form`` "matrix": ``eps_rg`` is the part of the green channel's signal that is added to red, and so on; the diagonal
    stays 1.  "neighbors": each pixel gives ``leak`` of its electrons to its four neighbors, which decides all of the matrix:
    red and blue have four green neighbors, green has two of each; of uniform light, as a mean of the colors.  "pixels": the same
    pixel by pixel, so that it blurs the picture as well.  Confounded with
    channel gain (.86) and the light's spectrum (.72); narrow-band lights help.
    Acts on colour channels behind quantum_efficiency and microlens, before cfa.
    """

    name = "spectral_crosstalk"
    stage = "pixel"
    acts_on = "electron"
    gives = "electron"
    order = 50.0
    absent = "monochrome sensors"
    imitated_by = (
        "channel_gain",
        "spd_mismatch",
        "ir_leak",
    )
    equation = (
        "mu' = M mu, M = I + (eps_ij off the diagonal); of neighbors R' = (1 - l) R + l G, G' = (1 - l) G + l (R + B)/2; "
        "of pixels mu'(p) = (1 - l) mu(p) + l/4 sum_nb mu(nb), each neighbor in its own color"
    )
    reference = (
        "Lyu et al., Accurate smartphone camera simulation using 3D scenes, sec. sensor QE (matrix M); "
        "Hirakawa, Cross-talk explained, IEEE ICIP 2008, 677 (of neighbors)"
    )
    must_not_change = ("dark",)
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"form": CROSSTALK_FORMS}

    eps_rg: float = parameter(0.0, unit="1", low=-0.3, high=1.0, tau=0.04, doc="green signal added to red")
    eps_rb: float = parameter(0.0, unit="1", low=-0.3, high=1.0, tau=0.04, doc="blue signal added to red")
    eps_gr: float = parameter(0.0, unit="1", low=-0.3, high=1.0, tau=0.04, doc="red signal added to green")
    eps_gb: float = parameter(0.0, unit="1", low=-0.3, high=1.0, tau=0.04, doc="blue signal added to green")
    eps_br: float = parameter(0.0, unit="1", low=-0.3, high=1.0, tau=0.04, doc="red signal added to blue")
    eps_bg: float = parameter(0.0, unit="1", low=-0.3, high=1.0, tau=0.04, doc="green signal added to blue")
    leak: float = parameter(0.0, unit="1", low=0.0, high=0.5, tau=0.02, doc="part l of a pixel in its four neighbors together")
    form: str = CROSSTALK_FORMS[0]

    def __post_init__(self) -> None:
        """A number that its form does not read would be stated for nothing: InputError."""
        super().__post_init__()
        self.refuse_idle()

    def own_parameters(self) -> tuple[ParameterInfo, ...]:
        """The six of a matrix, or the one leak to the neighbors."""
        return tuple(p for p in self.parameters() if (p.name == "leak") == (self.form != "matrix"))

    def matrix(self) -> Float:
        """The mixing matrix M (3, 3)."""
        if self.form != "matrix":
            stays, leak = 1 - self.leak, self.leak
            return np.array([[stays, leak, 0.0], [leak / 2, stays, leak / 2], [0.0, leak, stays]])
        return np.array([[1.0, self.eps_rg, self.eps_rb], [self.eps_gr, 1.0, self.eps_gb], [self.eps_br, self.eps_bg, 1.0]])

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Mix the colour channels (nothing to mix for MONO)."""
        if context.sensor.cfa == "MONO" or not any(self.values().values()):
            return signal
        values = signal.values
        if self.form == "pixels" and max(values.shape[1:]) > 1:
            return signal.with_values(self._leaked(values, context))
        return signal.with_values(np.tensordot(self.matrix(), values, axes=1))

    def _leaked(self, values: Float, context: Context) -> Float:
        """Colors (3, rows, cols) of which each pixel has lost to, and got from, its four neighbors.

        Across the window's border stands the mirrored pixel, which has the neighbor's color.
        """
        red, green, blue = np.broadcast_to(values, (3, *context.window[2:]))
        row0, col0 = context.window[:2]
        red_rows = ((np.arange(len(red)) - plane_position(context.sensor.cfa, "R", (row0, col0))[0]) % 2 == 0)[:, None]
        green_near = (_beside(green, 0) + _beside(green, 1)) / 2
        in_red_rows, in_blue_rows = ((_beside(a, 1) + _beside(b, 0)) / 2 for a, b in ((red, blue), (blue, red)))
        near = np.stack([green_near, np.where(red_rows, in_red_rows, in_blue_rows), green_near])
        return np.asarray((1 - self.leak) * values + self.leak * near)


def _beside(values: Float, axis: int) -> Float:
    """Mean of the two neighbors along an axis of values (rows, cols)."""
    if values.shape[axis] < 2:
        return values
    wide = np.pad(values, [(1, 1) if k == axis else (0, 0) for k in range(2)], mode="reflect")
    return np.asarray((wide[:-2] + wide[2:] if axis == 0 else wide[:, :-2] + wide[:, 2:]) / 2)
