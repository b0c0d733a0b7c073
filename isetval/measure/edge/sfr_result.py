"""What a slanted edge gives: curves, numbers, their uncertainty, settings and verdict."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.errors import MeasurementError
from isetval.core.sensor import RoiLike
from isetval.core.shown import Drawn
from isetval.core.threads import one_blas_thread
from isetval.measure.edge import spectrum
from isetval.measure.edge.esf_fit import EsfFit, solve_lower

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.floating[Any]]


AXIS = "frequency along the edge normal, cycles per pixel of the full sensor grid"


@dataclass(frozen=True, eq=False, repr=False)
class SfrResult(Drawn):
    """Slanted-edge SFR of one region.

    Parameters
    ----------
    frequency_cy_px : (n,)
        Frequency along the edge normal, cycles per pixel of the full sensor grid.
    mtf : (n,)
        SFR, 1 at frequency 0; NaN when refused.
    mtf50_cy_px, mtf30_cy_px, mtf10_cy_px, mtf50p_cy_px : float
        First falls to 50, 30, 10 % of the value at 0, and to 50 % of the curve's peak.
    angle_deg : float
        Angle of the edge from the nearer pixel axis, -45 to 45; ``orientation`` says which axis.
    normal_deg : float
        Direction from the dark to the bright side, 0 to 360: 0 towards larger columns, 90 towards larger rows.
    flags : tuple of str
        Reason codes for refusing the edge; empty = accepted.
    warnings : tuple of str
        Codes that do not refuse it: see ``isetval.measure.edge.verdict``.
    edge_row_px, edge_col_px : float
        Point of the edge in the middle of the region, capture pixels.
    sagitta_px : float
        Bow of the edge over the region; 0 for a straight fit.
    curvature_per_px : float
        Curvature of the edge (1/radius) at the middle of the region, 1/px.
    polynomial : (order + 1,)
        Legendre coefficients of the edge's position against the row (column, for horizontal edges).
    roughness_px : float
        Scatter of the edge's position from row to row beyond the noise, r.m.s.
    dark_dn, bright_dn : float
        Levels on both sides above black; ``noise_dark_dn``, ``noise_bright_dn`` their standard deviations per sample.
    method : str
    settings, choices : mapping
        What was asked for; what the estimator chose from the data (give it to ``sfr(choices=...)`` to choose the same again).
    """

    frequency_cy_px: Float
    mtf: Float
    mtf50_cy_px: float
    mtf50_sigma: float
    mtf30_cy_px: float
    mtf30_sigma: float
    mtf10_cy_px: float
    mtf10_sigma: float
    mtf50p_cy_px: float
    mtf50p_sigma: float
    angle_deg: float
    orientation: str
    normal_deg: float
    flags: tuple[str, ...]
    warnings: tuple[str, ...]
    edge_row_px: float
    edge_col_px: float
    edge_sigma_px: float
    sagitta_px: float
    curvature_per_px: float
    polynomial: Float
    roughness_px: float
    dark_dn: float
    bright_dn: float
    dark_sigma_dn: float
    bright_sigma_dn: float
    noise_dark_dn: float
    noise_bright_dn: float
    channel: str
    roi: RoiLike
    pixel_um: float
    method: str
    settings: Mapping[str, Any]
    choices: Mapping[str, Any]
    inflation: float = 1.0
    fit: EsfFit | None = field(default=None, repr=False)
    illumination_covariance: Float | None = field(default=None, repr=False)
    reach_px: tuple[float, float] = (0.0, 0.0)
    measured_curves: tuple[Float, Float, Float] | None = field(default=None, repr=False)
    sigma_curve: Float | None = field(default=None, repr=False)
    messages: Mapping[str, str] = field(default_factory=dict)

    axis = AXIS

    def headline(self) -> str:
        """Region, MTF50 and verdict."""
        region = ",".join(map(str, self.roi))
        if self.flags:
            return f"channel {self.channel}, region {region}: refused, {', '.join(self.flags)}"
        return (
            f"channel {self.channel}, region {region}: MTF50 {self.mtf50_cy_px:.4f} +- {self.mtf50_sigma:.4f} cy/px, "
            f"edge {self.angle_deg:.2f} deg from {self.orientation}"
        )

    def to_frame(self) -> pd.DataFrame:
        """MTF50, 30, 10 and the curve: name, channel, frequency_cy_px, value, sigma, unit."""
        import pandas as pd

        rows: list[tuple[Any, ...]] = [
            (name, self.channel, None, getattr(self, f"{name}_cy_px"), getattr(self, f"{name}_sigma"), "cy/px")
            for name in ("mtf50", "mtf50p", "mtf30", "mtf10")
        ]
        curve = zip(self.frequency_cy_px, self.mtf, self.mtf_sigma, strict=True)
        rows += [("mtf", self.channel, float(f), float(v), float(s), "1") for f, v, s in curve]
        return pd.DataFrame(rows, columns=["name", "channel", "frequency_cy_px", "value", "sigma", "unit"])

    @property
    def accepted(self) -> bool:
        """Whether no reason speaks against the edge."""
        return not self.flags

    @cached_property
    def _curves(self) -> tuple[Float, Float, Float]:
        if self.measured_curves is not None:
            return self.measured_curves
        return (np.zeros(0),) * 3 if self.fit is None else spectrum.esf_curves(self.fit, self.reach_px)

    @property
    def distance_px(self) -> Float:
        """Signed distance along the normal, positive on the bright side, (m,)."""
        return self._curves[0]

    @property
    def esf(self) -> Float:
        """ESF in DN above black at ``distance_px``, (m,)."""
        return self._curves[1]

    @property
    def lsf(self) -> Float:
        """LSF in 1/px at ``distance_px``, (m,); its integral is 1."""
        return self._curves[2]

    @cached_property
    @one_blas_thread()
    def mtf_sigma(self) -> Float:
        """Standard deviation of ``mtf`` at every frequency, (n,)."""
        if self.fit is None or self.flags:
            return np.full(len(self.mtf), np.nan) if self.sigma_curve is None else self.sigma_curve
        gradient = spectrum.mtf_gradient(self.fit, self.frequency_cy_px)
        out = np.sqrt(spectrum.gradient_variance(self.fit, gradient)) * self.inflation
        out[self.frequency_cy_px == 0] = 0.0
        return np.asarray(out)

    @property
    def frequency_cy_mm(self) -> Float:
        """``frequency_cy_px`` in cycles/mm on the sensor."""
        return self.frequency_cy_px / (self.pixel_um * 1e-3)

    @property
    def mtf50_cy_mm(self) -> float:
        """MTF50 in cycles/mm on the sensor."""
        return self.mtf50_cy_px / (self.pixel_um * 1e-3)

    @property
    def nyquist_mtf(self) -> float:
        """SFR at 0.5 cy/px."""
        return float(np.interp(0.5, self.frequency_cy_px, self.mtf))

    @property
    def sampling_efficiency(self) -> float:
        """MTF10 over the Nyquist frequency, at most 1 (the convention of the ISO reference code)."""
        return float(min(self.mtf10_cy_px, 0.5) / 0.5) if np.isfinite(self.mtf10_cy_px) else float("nan")

    @property
    def snr_bright(self) -> float:
        """Bright level over its noise."""
        return self.bright_dn / self.noise_bright_dn if self.noise_bright_dn > 0 else float("inf")

    def mtf_at(self, frequency_cy_px: ArrayLike) -> Float:
        """SFR at any frequencies (cy/px)."""
        f = np.atleast_1d(np.asarray(frequency_cy_px, dtype=float))
        if self.fit is None or self.flags:
            return np.asarray(np.interp(f, self.frequency_cy_px, self.mtf))
        return spectrum.mtf_of(self.fit, f)

    @one_blas_thread()
    def mtf_covariance(self, frequency_cy_px: ArrayLike | None = None, *, kind: str = "posterior") -> Float:
        """Covariance of the SFR at ``frequency_cy_px``, (n, n).

        ``kind="posterior"``: uncertainty of the SFR as an estimate of the system's (what ``mtf_sigma``
        is made from).  ``kind="sampling"``: scatter of the estimate over repeated noise with the same
        choices, the one to use between two captures measured alike, where biases cancel.

        Raises
        ------
        MeasurementError
            When the edge was refused or the method gives no covariance.
        """
        if self.fit is None or self.flags:
            raise MeasurementError(
                f"roi {self.roi}: method {self.method!r} with flags {self.flags} has no covariance; "
                "use the default method on an accepted edge"
            )
        f = self.frequency_cy_px if frequency_cy_px is None else np.atleast_1d(np.asarray(frequency_cy_px, dtype=float))
        gradient = spectrum.mtf_gradient(self.fit, f)
        gradient[f == 0] = 0.0
        return np.asarray(gradient @ spectrum.shape_covariance(self.fit, kind=kind) @ gradient.T * self.inflation**2)

    @one_blas_thread()
    def level_covariance_dn(self, *, kind: str = "posterior") -> Float:
        """Covariance of the dark and the bright level, DN^2, (2, 2); ``kind`` as in ``mtf_covariance``.

        Raises
        ------
        MeasurementError
            When the edge was refused or the method gives no covariance.
        """
        if self.fit is None or self.flags or self.illumination_covariance is None:
            raise MeasurementError(
                f"roi {self.roi}: method {self.method!r} with flags {self.flags} has no covariance; "
                "use the default method on an accepted edge"
            )
        return level_covariance(self.fit, self.illumination_covariance, kind=kind)

    def acutance(self, *, pixels_per_degree: float) -> float:
        """Acutance for a viewer who sees ``pixels_per_degree`` pixels in one degree."""
        return spectrum.acutance(self.frequency_cy_px, self.mtf, pixels_per_degree=pixels_per_degree)

    def to_dict(self) -> dict[str, Any]:
        """Everything but the fit, as plain JSON values."""
        skip = {"fit", "sigma_curve", "measured_curves", "illumination_covariance"}
        out: dict[str, Any] = {"axis": AXIS}
        for name in self.__dataclass_fields__:
            if name not in skip:
                out[name] = _plain(getattr(self, name))
        for name in ("mtf_sigma", "distance_px", "esf", "lsf"):
            out[name] = _plain(getattr(self, name))
        out["nyquist_mtf"] = self.nyquist_mtf
        out["sampling_efficiency"] = self.sampling_efficiency
        return out

    def to_json(self) -> str:
        """JSON text; NaN becomes null."""
        return json.dumps(_finite(self.to_dict()), indent=1)

    def to_csv(self) -> str:
        """The curve as CSV text with the axis definition in the first line."""
        rows = zip(self.frequency_cy_px, self.frequency_cy_mm, self.mtf, self.mtf_sigma, strict=True)
        head = f"# {AXIS}; method {self.method}; flags {' '.join(self.flags) or 'none'}\n"
        head += "frequency_cy_px,frequency_cy_mm,mtf,mtf_sigma\n"
        return head + "".join(f"{a:.6g},{b:.6g},{c:.8g},{d:.4g}\n" for a, b, c, d in rows)


def level_covariance(fit: EsfFit, illumination: Float, *, kind: str) -> Float:
    """Covariance of the dark and the bright level, DN^2, (2, 2).

    The levels are the coefficients of the constant and, added to it, of the mean shape.  The illumination along the edge
    that was divided out has noise of its own, ``illumination`` (2, 2, relative): an error of its square along the edge
    moves both levels, and by more than the pixels' noise.
    """
    pick = np.zeros((2, len(fit.coefficients)))
    pick[0, 0] = pick[1, 0] = pick[1, 1] = 1.0
    if kind == "posterior":
        half = solve_lower(fit.lower, (pick * fit.mode_root).T)
        pixels = half.T @ half
    else:
        pixels = pick @ fit.sampling_covariance @ pick.T
    levels = np.array([fit.dark, fit.dark + fit.step])
    return np.asarray(pixels + illumination * np.outer(levels, levels))


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(v) for v in value]
    return value


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    return value
