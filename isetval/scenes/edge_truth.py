"""Known-answer slanted edges: exact analytic edge, exact MTF, for users and for tests.

The picture of a straight edge is a function of the distance along its normal only, so each pixel is
a point sample of the edge spread function (ESF) of *optics and pixel aperture together*:

    ESF(d) = 1/2 + integral_0^inf MTF(f) sin(2 pi f d) / (pi f) df

with MTF(f) = optics(f) sinc(w f cos a) sinc(w f sin a), the last two factors being the square
aperture of width w seen along the normal at angle a.  Knows neither sensor effects nor measurements:
what it makes is either an array in units of the bright side or a plain ``Capture``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.sensor import Black

Float = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class EdgeBlur:
    """A blur with a closed-form or directly integrated MTF; the factors multiply.

    Parameters
    ----------
    gaussian_sigma_px : float
        Standard deviation of a Gaussian in pixels (0: none).
    cutoff_cy_px : float or None
        Cut-off 1/(lambda N) of a diffraction-limited circular pupil in cycles/pixel (None: none).
    defocus_waves : float
        Defocus W20 in waves at the pupil's rim; needs ``cutoff_cy_px``.
    disc_diameter_px : float
        Diameter of a uniform (geometric) defocus disc in pixels (0: none).
    aperture_px : float
        Width of the square pixel aperture in pixels (0: point sampling).

    Notes
    -----
    Diffraction: (2/pi) (arccos v - v sqrt(1 - v^2)), v = f / cut-off (Goodman, Introduction to Fourier
    Optics, ch. 6).  Defocus: the normalised autocorrelation of the pupil exp(2 pi i W20 rho^2),
    Hopkins, Proc. R. Soc. A 231 (1955).  Disc: 2 J1(x)/x, x = pi D f.
    """

    gaussian_sigma_px: float = 0.0
    cutoff_cy_px: float | None = None
    defocus_waves: float = 0.0
    disc_diameter_px: float = 0.0
    aperture_px: float = 1.0

    def __post_init__(self) -> None:
        if self.defocus_waves and self.cutoff_cy_px is None:
            raise InputError("defocus_waves needs cutoff_cy_px: defocus in waves is the phase of a finite pupil")
        widths = (self.gaussian_sigma_px, self.disc_diameter_px, self.aperture_px)
        if min(widths) < 0 or (self.cutoff_cy_px is not None and self.cutoff_cy_px <= 0):
            raise InputError(f"blur widths are {widths}, cut-off {self.cutoff_cy_px}; widths need >= 0, the cut-off > 0")
        if self.cutoff_cy_px is None and self.gaussian_sigma_px == 0 and max(widths) == 0:
            raise InputError("the blur has no width at all; give at least an aperture of 1 px")

    def mtf(self, frequency_cy_px: ArrayLike, angle_deg: float = 0.0) -> Float:
        """Signed transfer function along the normal at ``angle_deg`` from the nearest pixel axis."""
        f = np.asarray(frequency_cy_px, dtype=float)
        out = np.exp(-2 * (math.pi * self.gaussian_sigma_px * f) ** 2)
        if self.cutoff_cy_px is not None:
            out = out * pupil_otf(f / self.cutoff_cy_px, waves=self.defocus_waves)
        if self.disc_diameter_px > 0:
            out = out * _jinc(math.pi * self.disc_diameter_px * f)
        angle = math.radians(angle_deg)
        out = out * np.sinc(self.aperture_px * f * math.cos(angle)) * np.sinc(self.aperture_px * f * math.sin(angle))
        return np.asarray(out)

    def mtf50_cy_px(self, angle_deg: float = 0.0, level: float = 0.5) -> float:
        """First frequency at which the MTF falls to ``level``."""
        grid = np.linspace(0, 8, 8001)
        below = np.flatnonzero(np.abs(self.mtf(grid, angle_deg)) < level)
        low, high = grid[below[0] - 1], grid[below[0]]
        for _ in range(50):
            middle = (low + high) / 2
            low, high = (middle, high) if abs(float(self.mtf(middle, angle_deg))) >= level else (low, middle)
        return float((low + high) / 2)

    def highest_frequency_cy_px(self) -> float:
        """Frequency beyond which the ESF integral is cut (its tail is below 1e-7 of the step)."""
        limit = 200.0
        if self.cutoff_cy_px is not None:
            limit = min(limit, self.cutoff_cy_px)
        if self.gaussian_sigma_px > 0:
            limit = min(limit, math.sqrt(math.log(1e9) / 2) / (math.pi * self.gaussian_sigma_px))
        return limit


def _jinc(x: Float) -> Float:
    from scipy.special import j1

    safe = np.where(np.abs(x) < 1e-9, 1.0, x)
    return np.where(np.abs(x) < 1e-9, 1.0, 2 * j1(safe) / safe)


def pupil_otf(v: ArrayLike, *, waves: float = 0.0) -> Float:
    """Optical transfer function of a circular pupil at ``v`` = frequency / cut-off, defocused by ``waves``."""
    scaled: Float = np.abs(np.asarray(v, dtype=float))
    inside = np.minimum(scaled, 1.0)
    if waves == 0:
        return np.asarray(np.where(scaled < 1, 2 / math.pi * (np.arccos(inside) - inside * np.sqrt(1 - inside**2)), 0.0))
    # the overlap of two unit discs at distance 2v; the phase difference 2 pi W20 (4 v x) is odd in x
    nodes, weights = np.polynomial.legendre.leggauss(160)
    theta = np.arccos(inside)[..., None] * (nodes + 1) / 2
    # x = cos(theta) - v runs from 1 - v down to 0: the half overlap's chord has half length sin(theta)
    x = np.cos(theta) - inside[..., None]
    chord = np.sin(theta)
    phase = np.cos(2 * math.pi * waves * 4 * inside[..., None] * x)
    area = np.arccos(inside) / 2 * np.sum(weights * chord * np.sin(theta) * phase, axis=-1)
    return np.asarray(np.where(scaled < 1, area * 4 / math.pi, 0.0))


@dataclass(frozen=True)
class EdgeTruth:
    """Geometry and levels of a synthetic edge.

    Parameters
    ----------
    blur : EdgeBlur
    angle_deg : float
        Direction of the edge's normal from the +column axis towards +row, degrees; 0 is a vertical
        edge with its bright side on the right, 90 a horizontal one, bright below.
    offset_px : float
        Distance of the edge from the picture's centre along the normal.
    sagitta_px : float
        Bow of the edge over a chord of ``chord_px`` (default: the larger side of the picture); the edge is then a circular arc.
    chord_px : float or None
    contrast : float
        Bright level / dark level.
    shading_along, shading_across : float
        Relative change of the illumination over the picture's larger side, along the edge and across it
        (a plane, 1 at the centre).
    """

    blur: EdgeBlur = field(default_factory=EdgeBlur)
    angle_deg: float = 5.0
    offset_px: float = 0.0
    sagitta_px: float = 0.0
    chord_px: float | None = None
    contrast: float = 10.0
    shading_along: float = 0.0
    shading_across: float = 0.0

    @property
    def axis_angle_deg(self) -> float:
        """Angle of the edge from the nearest pixel axis, 0 to 45 degrees."""
        folded = abs(self.angle_deg) % 90
        return min(folded, 90 - folded)

    def mtf(self, frequency_cy_px: ArrayLike) -> Float:
        """True MTF along the normal, pixel aperture included; >= 0."""
        return np.abs(self.blur.mtf(frequency_cy_px, self.axis_angle_deg))

    def mtf50_cy_px(self, level: float = 0.5) -> float:
        """True first crossing of ``level`` in cycles/pixel."""
        return self.blur.mtf50_cy_px(self.axis_angle_deg, level)

    def distance_px(self, shape: tuple[int, int]) -> Float:
        """Signed distance of every pixel centre from the edge, positive on the bright side, (rows, cols)."""
        rows, cols = shape
        y = np.arange(rows)[:, None] - (rows - 1) / 2
        x = np.arange(cols)[None, :] - (cols - 1) / 2
        angle = math.radians(self.angle_deg)
        across = x * math.cos(angle) + y * math.sin(angle) - self.offset_px
        if self.sagitta_px == 0:
            return np.asarray(across)
        along = -x * math.sin(angle) + y * math.cos(angle)
        chord = self.chord_px or max(shape)
        radius = (chord**2 / 4 + self.sagitta_px**2) / (2 * self.sagitta_px)
        # the arc's middle third lies at `across` = +sagitta/3, so that the bow straddles the straight line
        center = self.sagitta_px / 3 - radius
        return np.asarray(np.copysign(1, radius) * (np.hypot(across - center, along) - abs(radius)))

    def image(self, shape: tuple[int, int]) -> Float:
        """Noise-free picture, (rows, cols); the bright side is 1 and the dark side 1/contrast at the centre."""
        distance = self.distance_px(shape)
        dark = 1 / self.contrast
        picture = dark + (1 - dark) * edge_spread(self.blur, distance, angle_deg=self.axis_angle_deg)
        return np.asarray(picture * self._shading(shape))

    def _shading(self, shape: tuple[int, int]) -> Float:
        rows, cols = shape
        y = (np.arange(rows)[:, None] - (rows - 1) / 2) / max(shape)
        x = (np.arange(cols)[None, :] - (cols - 1) / 2) / max(shape)
        angle = math.radians(self.angle_deg)
        across = x * math.cos(angle) + y * math.sin(angle)
        along = -x * math.sin(angle) + y * math.cos(angle)
        return np.asarray(1 + self.shading_along * along + self.shading_across * across)


def edge_spread(blur: EdgeBlur, distance_px: ArrayLike, *, angle_deg: float = 0.0) -> Float:
    """ESF of ``blur`` at signed distances, by table and cubic interpolation (error below 1e-6)."""
    from scipy.interpolate import CubicSpline

    d = np.asarray(distance_px, dtype=float)
    reach = float(2 ** math.ceil(math.log2(max(16.0, np.abs(d).max() + 1))))
    x, e = _esf_table(blur, round(angle_deg, 9), reach)
    return np.asarray(CubicSpline(x, e)(d))


@lru_cache(maxsize=64)
def _esf_table(blur: EdgeBlur, angle_deg: float, reach: float) -> tuple[Float, Float]:
    top = blur.highest_frequency_cy_px()
    if top >= 200:
        raise InputError("a blur without Gaussian or diffraction has an infinite spectrum; add gaussian_sigma_px >= 0.02")
    step = min(1 / 64, 1 / (24 * top))
    core = np.arange(0, 12, step)
    tail = 12 * np.exp(np.arange(0, math.log(reach / 12) + 0.01, 0.004)) if reach > 12 else np.array([12.0])
    slow = np.arange(12, reach + 1, min(0.08, 1 / (10 * top))) if blur.cutoff_cy_px is not None else tail
    x = np.concatenate([core, slow])
    pieces = max(8, int(reach * top / 4) + 1)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    edges = np.linspace(0, top, pieces + 1)
    half = np.diff(edges)[:, None] / 2
    f = ((edges[:-1, None] + half) + half * nodes).ravel()
    w = (half * weights).ravel() * blur.mtf(f, angle_deg) / (math.pi * f)
    e = np.concatenate([0.5 + np.sin(2 * math.pi * np.outer(part, f)) @ w for part in np.array_split(x, max(1, len(x) // 256))])
    return np.concatenate([-x[:0:-1], x]), np.concatenate([1 - e[:0:-1], e])


def edge_capture(
    truth: EdgeTruth,
    shape: tuple[int, int] = (100, 100),
    *,
    bright_dn: float = 12000.0,
    black_dn: float | Black = 256.0,
    white_dn: float = 16383.0,
    snr_bright: float | None = None,
    read_fraction: float = 0.1,
    seed: int = 0,
    cfa: str = "MONO",
    plane_gain: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0),
    window: tuple[int, int] = (0, 0),
) -> Capture:
    """A capture of the edge with shot and read noise, rounded and clipped to whole DN.

    Parameters
    ----------
    bright_dn : float
        Bright level above black at the picture's centre.
    snr_bright : float or None
        Mean over standard deviation of the bright side; None is noise-free (rounding only).
    read_fraction : float
        Share of the bright side's variance that is read noise; the rest is shot noise, which
        falls in proportion to the level.
    plane_gain : (R, Gr, Gb, B)
        Relative level of the colour planes.
    """
    from isetval.core.capture import black_image_dn, plane_view
    from isetval.core.sensor import BAYER_PLANES

    level = truth.image(shape) * bright_dn
    blank = Capture.from_array(
        np.zeros(shape, np.uint16), cfa=cfa, black_dn=black_dn, white_dn=white_dn, window=window, provenance={"truth": truth}
    )
    if cfa != "MONO":
        for name, gain in zip(BAYER_PLANES, plane_gain, strict=True):
            _, (row, col), step = plane_view(blank, name)
            level[row::step, col::step] *= gain
    if snr_bright is not None:
        rng = np.random.default_rng(seed)
        variance = (bright_dn / snr_bright) ** 2
        gain_dn_per_e = (1 - read_fraction) * variance / bright_dn
        level = rng.poisson(np.maximum(level, 0) / gain_dn_per_e) * gain_dn_per_e
        level = level + rng.normal(0, math.sqrt(read_fraction * variance), shape)
    values = np.clip(np.rint(level + black_image_dn(blank)), 0, white_dn).astype(np.uint16)
    return Capture(values, blank.sensor, blank.window, blank.exposure, blank.provenance)
