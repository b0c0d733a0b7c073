"""The circular exit pupil: diffraction, defocus and aberrations as one transfer function.

Effects do not multiply blurs of the lens: they add focus shifts and aberrations to this pupil, which
then forms one transfer function.  Two focus shifts of +5 um and -5 um therefore cancel.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, fields, replace
from functools import lru_cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from isetval.core.cache import Remembered, content_hash
from isetval.core.context import Context
from isetval.core.errors import InputError
from isetval.core.signal import Signal
from isetval.effects.pupil_integrals import aberrated, defocused

Float = NDArray[np.float64]
REFERENCE_NM = 550.0  # where a lens is in focus: the middle of the visible range
MANY_FREQUENCIES, GRID_FREQUENCIES = 20_000, 129  # a picture of 141 px a side; the grid is exact to 1e-4 (tested)
DIGITS = 12  # of a frequency in cycles/um: roundings of sine and cosine apart, edges of all directions ask for the same ones
KNOWN_BYTES = 32 << 20  # a thousand lines of frequencies: pupils of all edges at all steps of a derivative
RED_NM, GREEN_NM, BLUE_NM = 610.0, 540.0, 460.0
"""Wavelengths at which the axial colour of the red, green and blue channel is stated."""


@dataclass(frozen=True)
class CircularPupil:
    """A circular pupil with focus shift and Zernike aberrations.

    Parameters
    ----------
    f_number : float
        Ratio of image distance to pupil diameter N of geometric optics.
    pixel_um : float
        Pixel pitch in um: turns cycles/pixel into cycles/um.
    diffraction_f_number : float
        N of the wave optics, in place of ``f_number``: the pupil that diffracts sets the cone; 0 is geometric optics.
    focus_um : float
        Shift z of the sensor from best focus in um, away from the lens.
    red_um, blue_um : float
        Further focus shift at 610 and at 460 nm relative to 540 nm; linear in 1/wavelength^2 (`by_dispersion`).
    spherical_waves, coma_x_waves, coma_y_waves, astigmatism_0_waves, astigmatism_45_waves, secondary_spherical_waves : float
        Orthonormal (Noll) Zernike coefficients in waves at 550 nm, that is rms wavefront errors.

    Notes
    -----
    With s = f lambda N the separation of the two pupils of the autocorrelation in pupil diameters and
    k W the phase over the unit pupil, ``OTF = (1/pi) integral exp(i k [W(u + s, v) - W(u - s, v)])``
    over their common area.  Defocus W = z/(8 N^2) rho^2 gives the phase a u with a = pi z f / N and
    ``OTF = (4/pi) int_0^sqrt(1-s^2) sin(a X)/a dv``, X = sqrt(1 - v^2) - s (Hopkins 1955), which is
    (2/pi)(acos s - s sqrt(1-s^2)) in focus and 2 J1(a)/a, the geometric disc of diameter z/N, for s = 0.
    Phases of further aberrations are summed under the same integral by Gauss-Legendre quadrature.
    """

    f_number: float
    pixel_um: float
    diffraction_f_number: float = 0.0
    focus_um: float = 0.0
    red_um: float = 0.0
    blue_um: float = 0.0
    spherical_waves: float = 0.0
    coma_x_waves: float = 0.0
    coma_y_waves: float = 0.0
    astigmatism_0_waves: float = 0.0
    astigmatism_45_waves: float = 0.0
    secondary_spherical_waves: float = 0.0

    def adjusted(self, **added: float) -> CircularPupil:
        """The pupil with ``added`` on top of its focus shifts and aberrations."""
        return replace(self, **{name: getattr(self, name) + value for name, value in added.items()})

    def transfer(self, fx: Float, fy: Float, wavelength_nm: Float) -> Float:
        """Transfer function at (fx, fy) in cycles/pixel and wavelength in nm; arguments broadcast.

        Real, unless there is coma.
        """
        turn = np.arctan2(fy, fx) if self._turns() else np.zeros(1)
        many = np.broadcast(fx, fy, wavelength_nm).size > MANY_FREQUENCIES
        if many and self._aberrated() and np.ndim(wavelength_nm) == 0:
            return self._interpolated(fx, fy, wavelength_nm)
        frequency = np.hypot(fx, fy) / self.pixel_um
        if many:
            return self._integrated(frequency, turn, wavelength_nm)
        # edges of one direction or another meet the same pupil at the same frequencies, over and over in a fit
        frequency, turn = np.round(frequency, DIGITS), np.round(turn, DIGITS)
        key = content_hash((astuple(self), frequency, turn, np.asarray(wavelength_nm, float)))
        known = _KNOWN.get(key)
        if known is None:
            known = self._integrated(frequency, turn, wavelength_nm)
            _KNOWN.put(key, known)
        return known

    def _integrated(self, frequency: Float, turn: Float, wavelength_nm: Float) -> Float:
        """The transfer function at frequencies in cycles/um, in directions ``turn`` from the columns' axis."""
        wave_um = np.asarray(wavelength_nm, float) * 1e-3
        separation = np.asarray(frequency * wave_um * self.diffraction_f_number)
        phase = np.asarray(np.pi * self._focus(wavelength_nm) * frequency / self._cone)
        if not self._aberrated():
            return defocused(separation, phase)
        shear = 2 * np.pi * frequency * self._cone * REFERENCE_NM * 1e-3
        cos2, sin2 = np.cos(2 * turn), np.sin(2 * turn)
        a0, a45 = self.astigmatism_0_waves, self.astigmatism_45_waves
        phase = phase + shear * 4 * math.sqrt(6) * (a0 * cos2 + a45 * sin2)
        across = shear * 4 * math.sqrt(6) * (a45 * cos2 - a0 * sin2)
        along = self.coma_x_waves * np.cos(turn) + self.coma_y_waves * np.sin(turn)
        aside = self.coma_y_waves * np.cos(turn) - self.coma_x_waves * np.sin(turn)
        spherical, secondary = shear * self.spherical_waves, shear * self.secondary_spherical_waves
        out = aberrated(separation, phase, across, spherical, shear * along, shear * aside, secondary)
        return out if self.coma_x_waves or self.coma_y_waves else cast(Float, out.real)

    def _interpolated(self, fx: Float, fy: Float, wavelength_nm: Float) -> Float:
        """The transfer function of a picture's many frequencies from a grid of few.

        What the aberrations change is smooth and confined to a few pixels; the cone of diffraction at
        zero frequency, which makes the far tail, is not interpolated.
        """
        plain = self._plain()
        reach = max(0.5, float(np.abs(fx).max()), float(np.abs(fy).max()))
        changes = _changes(self, float(wavelength_nm), reach)
        real = plain.transfer(fx, fy, wavelength_nm) + _evaluated(changes[0], fy, fx)
        return np.asarray(real) if len(changes) == 1 else cast(Float, real + 1j * _evaluated(changes[1], fy, fx))

    def _plain(self) -> CircularPupil:
        """Without aberrations."""
        return replace(self, **{field.name: 0.0 for field in fields(self) if field.name.endswith("_waves")})

    @property
    def _cone(self) -> float:
        """N of the cone of light: of the pupil that diffracts, where one does."""
        return self.diffraction_f_number or self.f_number

    def _focus(self, wavelength_nm: Float) -> Float | float:
        if not (self.red_um or self.blue_um):
            return self.focus_um
        return np.asarray(self.focus_um + by_dispersion(wavelength_nm, self.red_um, self.blue_um))

    def _turns(self) -> bool:
        """Whether it is another in another direction."""
        return any((self.coma_x_waves, self.coma_y_waves, self.astigmatism_0_waves, self.astigmatism_45_waves))

    def _aberrated(self) -> bool:
        return any(getattr(self, field.name) for field in fields(self) if field.name.endswith("_waves"))


_KNOWN = Remembered(KNOWN_BYTES)


@lru_cache(maxsize=64)
def _changes(pupil: CircularPupil, wavelength_nm: float, reach: float) -> tuple[Any, ...]:
    """Splines over (fy, fx) up to ``reach`` of what aberrations change in a transfer function, real and imaginary part; kept.

    A picture is blurred in strips, and all shots at one focus alike.
    """
    from scipy.interpolate import RectBivariateSpline

    axis = np.linspace(-reach, reach, GRID_FREQUENCIES)
    at, there = np.array(wavelength_nm), (axis[None, :], axis[:, None])
    change = np.asarray(pupil.transfer(*there, at) - pupil._plain().transfer(*there, at))
    parts = (change.real, change.imag) if pupil.coma_x_waves or pupil.coma_y_waves else (change.real,)
    return tuple(RectBivariateSpline(axis, axis, part) for part in parts)


def _evaluated(spline: Any, fy: Float, fx: Float) -> Float:
    """A spline at (fy, fx); on the grid of a picture's frequencies, a column and a row, by its two axes."""
    if fy.shape[1:] != (1,) or fx.shape[:1] != (1,):
        return np.asarray(spline(fy, fx, grid=False))
    (rows, at_row), (cols, at_col) = (np.unique(axis, return_inverse=True) for axis in (fy[:, 0], fx[0]))
    return np.asarray(spline(rows, cols)[np.ix_(at_row, at_col)])


def by_dispersion(wavelength_nm: Float | float, red: float, blue: float) -> Float:
    """What glass does to a quantity by wavelength: ``red`` at 610 nm, 0 at 540 and ``blue`` at 460, linear in 1/wavelength^2.

    Cauchy's law (Kingslake & Johnson, Lens Design Fundamentals, 2nd ed., sec. 5.1), on either side of green and beyond.
    """
    u, green = np.asarray(wavelength_nm, float) ** -2, GREEN_NM**-2
    toward_red, toward_blue = (u - green) / (RED_NM**-2 - green), (u - green) / (BLUE_NM**-2 - green)
    return np.asarray(np.where(u < green, red * toward_red, blue * toward_blue))


def thin_lens_shift_um(focal_mm: float, focus_m: float | None, object_m: float | None) -> float:
    """Shift of the sensor from the image of an object when a thin lens is focused elsewhere; 0 where a distance is not stated.

    Parameters
    ----------
    focal_mm : float
        Focal length; 0 where it is unknown.
    focus_m, object_m : float or None
        Distance that is in focus, and that of the object, from the lens; infinity allowed.

    Notes
    -----
    1/image = 1/f - 1/object for both; positive where the sensor is further from the lens than the object's image.
    """
    if not focal_mm or focus_m is None or object_m is None:
        return 0.0
    if min(focus_m, object_m) * 1e3 <= focal_mm:
        raise InputError(
            f"focus_m {focus_m:g} and distance_m {object_m:g}: a lens of {focal_mm:g} mm images only what is further away"
        )
    images_mm = [1 / (1 / focal_mm - 1e-3 / distance) for distance in (focus_m, object_m)]
    return 1e3 * (images_mm[0] - images_mm[1])


def adjust_pupil(signal: Signal, effect: str, **added: float) -> Signal:
    """The signal imaged by its pupil with focus shifts and aberrations ``added``.

    Raises
    ------
    InputError
        If no pupil stands in front, or one that cannot take aberrations.
    """
    adjusted = getattr(signal.pupil, "adjusted", None)
    if adjusted is None:
        raise InputError(f"effect {effect}: no lens pupil in front of it; put aperture or ray_transfer before {effect}")
    return signal.through(adjusted(**added))


def field_point(context: Context) -> tuple[float, float]:
    """Place (x, y) of the middle of the shot's window in half diagonals: one point spread per shot."""
    row0, col0, rows, cols = context.shot_window or context.window
    sensor = context.sensor
    half = math.hypot(sensor.rows, sensor.cols) / 2
    return (col0 + (cols - sensor.cols) / 2) / half, (row0 + (rows - sensor.rows) / 2) / half
