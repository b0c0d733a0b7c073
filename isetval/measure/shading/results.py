"""Results of the relative-illumination analysis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.errors import InputError
from isetval.core.shown import Drawn
from isetval.measure.shading.radial_basis import Radial

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlaneIllumination:
    """Fall-off of one colour plane.

    Parameters
    ----------
    radius_mm, curve, sigma : (radii,)
        Distance from the fitted centre, relative illumination (1 at the centre), its standard deviation.
    covariance : (radii, radii)
        Of ``curve``.
    center_px, center_sigma_px : (row, col)
        Centre of the curve in sensor pixels and its standard deviation, from this plane alone.
    tilt_per_mm, tilt_sigma_per_mm : (x, y)
        Relative change of the light per mm at the centre, from this plane alone; x along columns.
    signal_dn : float
        Signal above black at the centre.
    chi2, dof, chi2_dof
        Of the block means about the shared surface.
    map_row_px, map_col_px, map, map_sigma, model
        Block means over the signal at the centre, their sigma and the fitted surface: 2-D arrays where
        one window was measured, else 1-D lists of blocks.  Blocks left out are NaN in ``map``.
    ring_radius_mm, ring, ring_sigma : (rings,)
        Tilt-corrected ring means: the curve without a polynomial, for a look.
    truncation : (radii,)
        Distance from the next poorer basis, counted in ``sigma``; 0 where a spare order was left.
    """

    plane: str
    radius_mm: Float
    curve: Float
    sigma: Float
    covariance: Float
    center_px: tuple[float, float]
    center_sigma_px: tuple[float, float]
    tilt_per_mm: tuple[float, float]
    tilt_sigma_per_mm: tuple[float, float]
    signal_dn: float
    signal_sigma_dn: float
    chi2: float
    dof: int
    chi2_dof: float
    map_row_px: Float
    map_col_px: Float
    map: Float
    map_sigma: Float
    model: Float
    ring_radius_mm: Float
    ring: Float
    ring_sigma: Float
    coefficients: Float
    coefficients_covariance: Float
    radial: Radial
    truncation: Float
    sigma_scale: float
    black_sigma_dn: float = 0.0
    clipped_blocks: int = 0
    bad_pixels: int = 0
    dropped_blocks: int = 0

    def __repr__(self) -> str:
        edge = f"{self.curve[-1]:.4f} +- {self.sigma[-1]:.4f} at {self.radius_mm[-1]:.3f} mm"
        return f"PlaneIllumination({self.plane}: {edge}, {self.signal_dn:.1f} DN at the centre, chi2/dof {self.chi2_dof:.3f})"

    def at(self, radius_mm: ArrayLike) -> tuple[Float, Float]:
        """Relative illumination and its sigma at any radius in mm inside the measured range."""
        radius = np.atleast_1d(np.asarray(radius_mm, dtype=float))
        if radius.size and not (radius.min() >= 0 and radius.max() <= self.radius_mm[-1] * (1 + 1e-9)):
            raise InputError(
                f"radius {radius.min():.3f}..{radius.max():.3f} mm leaves the measured 0..{self.radius_mm[-1]:.3f} mm "
                f"of plane {self.plane}"
            )
        _, value = curve_gradient(radius, self.coefficients, self.radial)
        return value, np.sqrt(np.maximum(np.diag(self.curve_covariance(radius)), 0))

    def curve_covariance(self, radius_mm: ArrayLike) -> Float:
        """Covariance of the curve between radii in mm, (radii, radii), black level and truncation included."""
        radius = np.asarray(radius_mm, dtype=float)
        gradient, value = curve_gradient(radius, self.coefficients, self.radial)
        lift = (1 - value) * self.black_sigma_dn / self.signal_dn
        left = np.interp(radius, self.radius_mm, self.truncation)
        noise = self.sigma_scale**2 * gradient @ self.coefficients_covariance @ gradient.T
        return np.asarray(noise + np.outer(lift, lift) + np.outer(left, left))


@dataclass(frozen=True, eq=False)
class ColorShading:
    """Ratio of two planes' relative illumination, 1 at the centre: (radii,) with sigma; geometry errors cancel in it."""

    name: str
    radius_mm: Float
    ratio: Float
    sigma: Float


@dataclass(frozen=True, eq=False)
class OddEven:
    """Relative illumination in two dimensions about the sensor's middle, split by a half turn (planes averaged by weight).

    ``even_rms`` and ``odd_rms`` in relative units over the measured blocks; ``odd_decenter_rms`` and
    ``odd_tilt_rms`` are the parts of the odd map that the fitted decentre and tilt explain, and
    ``odd_left_rms`` what remains, with ``odd_noise_rms`` expected from noise alone.
    """

    even_rms: float
    odd_rms: float
    odd_decenter_rms: float
    odd_tilt_rms: float
    odd_left_rms: float
    odd_noise_rms: float


@dataclass(frozen=True, eq=False, repr=False)
class RelativeIllumination(Drawn):
    """Relative illumination of all planes; ``result["Gr"]`` is one plane, ``result["G"]`` is short for ``"Gr"``.

    ``center_px`` (row, col), ``tilt_per_mm`` (x, y) and their sigma are those of all planes together;
    ``decenter_px`` is the centre minus the sensor's middle.  ``warnings`` say what is doubtful.
    """

    planes: Mapping[str, PlaneIllumination]
    color_shading: Mapping[str, ColorShading]
    center_px: tuple[float, float]
    center_sigma_px: tuple[float, float]
    decenter_px: tuple[float, float]
    tilt_per_mm: tuple[float, float]
    tilt_sigma_per_mm: tuple[float, float]
    basis: str
    order: int
    chi2: float
    dof: int
    chi2_dof: float
    chi2_dof_by_order: Float
    same_center_p: float
    odd_even: OddEven | None
    gain_map_report: tuple[str, ...]
    choices: Mapping[str, Any]
    warnings: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)

    def headline(self) -> str:
        """Fall-off at the rim, centre, fit."""
        some = next(iter(self.planes.values()))
        edges = ", ".join(f"{p} {v.curve[-1]:.4f}" for p, v in self.planes.items())
        doubts = f", {len(self.warnings)} warnings" if self.warnings else ""
        return (
            f"{edges} at {some.radius_mm[-1]:.3f} mm, centre (row, col) "
            f"{self.center_px[0]:.1f}, {self.center_px[1]:.1f} px, {self.basis} of order {self.order}, "
            f"chi2/dof {self.chi2_dof:.3f}{doubts}"
        )

    def to_frame(self) -> pd.DataFrame:
        """The curves of all planes and their ratios: name, channel, radius_mm, value, sigma, unit."""
        import pandas as pd

        curves = [("relative_illumination", name, p.radius_mm, p.curve, p.sigma) for name, p in self.planes.items()]
        curves += [("color_shading", name, c.radius_mm, c.ratio, c.sigma) for name, c in self.color_shading.items()]
        rows = [
            (name, channel, float(r), float(v), float(s), "1")
            for name, channel, radius, value, sigma in curves
            for r, v, s in zip(radius, value, sigma, strict=True)
        ]
        return pd.DataFrame(rows, columns=["name", "channel", "radius_mm", "value", "sigma", "unit"])

    def __getitem__(self, plane: str) -> PlaneIllumination:
        if plane == "G" and "Gr" in self.planes:
            return self.planes["Gr"]
        if plane not in self.planes:
            raise InputError(f"plane is {plane!r}; this result has {', '.join(self.planes)}")
        return self.planes[plane]


def curve_gradient(radius_mm: Float, coefficients: Float, radial: Radial) -> tuple[Float, Float]:
    """P(r)/P(0), (radii,), and its derivative by the coefficients, (radii, coefficients)."""
    basis, middle = radial.values(radius_mm**2), radial.at_center()
    center = float(coefficients @ middle)
    value = (coefficients @ basis) / center
    return np.asarray((basis - value * middle[:, None]).T / center), np.asarray(value)
