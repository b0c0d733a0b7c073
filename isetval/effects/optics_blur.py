"""Blur of the lens: aperture, diffraction, focus and aberrations, and motion.  All act before the pixel."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, FreeAxis, parameter
from isetval.core.signal import Signal
from isetval.effects.pupil import CircularPupil, adjust_pupil, field_point, thin_lens_shift_um

Float = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Aperture(Effect):
    """The lens stop: radiance becomes irradiance, imaged by a circular pupil.

    The light factor is the *named* place for a lens file whose pupil is too small (a free scale is
    never silent).  The shot's stated focus and its focus nuisance enter here, once; with ``focal_mm``, so does the defocus
    of a target at ``distance_m`` while the lens is focused on ``focus_m``, by the thin-lens equation.  Touches every level;
    must stand in front of all optics.
    """

    name = "aperture"
    stage = "optics"
    acts_on = "radiance"
    gives = "irradiance"
    order = 0.0
    absent = "models whose lens is given by its rays (ray_transfer)"
    imitated_by = (
        "exposure_time",
        "channel_gain",
    )
    candidate = False
    equation = "E = pi L / (4 N^2) * transmittance * light_factor"
    reference = "ISO 15739:2013 annex; Holst & Lomheim, CMOS/CCD Sensors and Camera Systems, 2nd ed., eq. 2-24 (far object)"
    must_not_change = ("dark",)

    f_number: float = parameter(1.73, unit="1", low=0.5, high=64.0, tau=0.05, doc="f-number N")
    transmittance: float = parameter(1.0, unit="1", low=0.0, high=1.0, doc="transmittance of the lens")
    light_factor: float = parameter(1.0, unit="1", low=0.0, high=100.0, doc="stated correction of a lens file's light")
    focal_mm: float = parameter(
        0.0, unit="mm", low=0.0, high=10000.0, shape=True, doc="focal length, for focus by distance (0: unknown)"
    )

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Irradiance behind the stop; the pupil is shifted by the shot's focus."""
        shift_um = thin_lens_shift_um(self.focal_mm, context.exposure.focus_m, context.object_distance_m)
        focus_um = context.focus_um + context.get("focus_um") + shift_um
        pupil = CircularPupil(self.f_number, context.sensor.pixel_um, focus_um=focus_um)
        scaled = signal.scaled(math.pi / (4 * self.f_number**2) * self.transmittance * self.light_factor)
        return replace(scaled, unit="irradiance", pupil=pupil)


@dataclass(frozen=True, kw_only=True)
class Diffraction(Effect):
    """Diffraction at a circular stop: blur that grows with wavelength and f-number.

    Confounded with pixel aperture and diffusion; narrow-band lights tell them apart.  Leaves levels,
    noise and darks alone.  f_number 0 is geometric optics.
    """

    name = "diffraction"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 5.0
    absent = "lenses far from their limit: pixels wider than lambda N"
    imitated_by = (
        "pixel_aperture",
        "charge_diffusion",
        "defocus",
    )
    equation = "OTF(s) = (2/pi)(acos s - s sqrt(1-s^2)), s = f lambda N; defocused: Hopkins' integral"
    reference = "Goodman, Introduction to Fourier Optics, 3rd ed., eq. 6-31; Hopkins, Proc. R. Soc. A 231 (1955) 91"
    must_not_change = ("dark", "flat", "illumination")

    f_number: float = parameter(0.0, unit="1", low=0.0, high=64.0, tau=1.0, doc="f-number N of the wave optics (0: none)")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Switch the pupil to wave optics."""
        return adjust_pupil(signal, self.name, diffraction_f_number=self.f_number) if self.f_number else signal


@dataclass(frozen=True, kw_only=True)
class Defocus(Effect):
    """A focus error, equal over the field; adds to the shot's focus, does not multiply blurs.

    Identical with the focus nuisance of a shot: only a through-focus series with a calibrated step
    separates them.  Leaves levels, noise and darks alone.
    """

    name = "defocus"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 10.0
    absent = "flats, charts of large patches; hidden by a focus scale of unknown zero"
    imitated_by = (
        "spherical",
        "charge_diffusion",
        "axial_color",
    )
    of_focus_depth = ("z_um",)
    equation = "W20 = z/(8 N^2); geometric: 2 J1(X)/X, X = pi (z/N) f"
    reference = "Hopkins, Proc. R. Soc. A 231 (1955) 91"
    must_not_change = ("dark", "flat", "illumination")

    z_um: float = parameter(0.0, unit="um", low=-200.0, high=200.0, tau=5.0, doc="shift z of the sensor from best focus")

    def focus_shift_um(self, context: Context) -> float:
        """The same everywhere."""
        return self.z_um

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Shift the pupil's focus."""
        return adjust_pupil(signal, self.name, focus_um=self.z_um) if self.z_um else signal


@dataclass(frozen=True, kw_only=True)
class FieldCurvature(Effect):
    """Best focus that moves with the square of the field radius.

    Even over the field, which a sensor tilt is not; separated by edges at opposite field points with
    three or more focus settings.
    """

    name = "field_curvature"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 12.0
    absent = "the middle of the field"
    imitated_by = (
        "sensor_tilt",
        "astigmatism",
        "defocus",
    )
    free = FreeAxis("field radius", "strength", 0.5)
    of_focus_depth = ("kappa_um",)
    equation = "z += kappa r^2, r = 1 at the corner"
    reference = "Born & Wolf, Principles of Optics, 7th ed., sec. 5.3 (Petzval curvature)"
    must_not_change = ("dark", "flat", "illumination")

    kappa_um: float = parameter(0.0, unit="um", low=-200.0, high=200.0, tau=10.0, doc="focus shift at the corner")

    def focus_shift_um(self, context: Context) -> float:
        """With the square of the field radius."""
        x, y = field_point(context)
        return self.kappa_um * (x * x + y * y)

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Shift the pupil's focus by the value at the window's middle."""
        return adjust_pupil(signal, self.name, focus_um=self.focus_shift_um(context)) if self.kappa_um else signal


@dataclass(frozen=True, kw_only=True)
class SensorTilt(Effect):
    """A sensor that is tilted against the lens: focus linear and odd over the field.

    Chart tilt looks alike; rotating the camera by 180 degrees tells them apart.
    """

    name = "sensor_tilt"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 13.0
    absent = "the middle of the field"
    imitated_by = (
        "field_curvature",
        "defocus",
        "chart_tilt",
    )
    free = FreeAxis("field radius", "strength", 0.5)
    of_focus_depth = ("alpha_um", "beta_um")
    equation = "z += alpha x + beta y, x and y in half diagonals"
    reference = "geometry; Holst & Lomheim, CMOS/CCD Sensors and Camera Systems, 2nd ed., ch. 10"
    must_not_change = ("dark", "flat", "illumination")

    alpha_um: float = parameter(0.0, unit="um", low=-200.0, high=200.0, tau=8.0, doc="focus shift at x = half diagonal")
    beta_um: float = parameter(0.0, unit="um", low=-200.0, high=200.0, tau=8.0, doc="focus shift at y = half diagonal")

    def focus_shift_um(self, context: Context) -> float:
        """Linear over the field."""
        x, y = field_point(context)
        return self.alpha_um * x + self.beta_um * y

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Shift the pupil's focus by the value at the window's middle."""
        return adjust_pupil(signal, self.name, focus_um=self.focus_shift_um(context))


@dataclass(frozen=True, kw_only=True)
class AxialColor(Effect):
    """Best focus that depends on colour.

    Stated as the focus shift of red (610 nm) and blue (460 nm) relative to 540 nm, linear in 1/wavelength^2 on either side and
    beyond, as glass disperses: each channel's best focus moves by nearly its own number.
    """

    name = "axial_color"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 14.0
    absent = "monochrome sensors in narrow light, mirrors"
    imitated_by = (
        "charge_diffusion",
        "defocus",
        "lateral_color",
    )
    of_focus_depth = ("red_um", "blue_um")
    equation = "z(lambda) = z + a(lambda); a(610) = a_R, a(540) = 0, a(460) = a_B"
    reference = "Kingslake & Johnson, Lens Design Fundamentals, 2nd ed., ch. 5"
    must_not_change = ("dark", "flat", "illumination")

    red_um: float = parameter(0.0, unit="um", low=-100.0, high=100.0, tau=5.0, doc="focus shift a_R at 610 nm")
    blue_um: float = parameter(0.0, unit="um", low=-100.0, high=100.0, tau=5.0, doc="focus shift a_B at 460 nm")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add the wavelength-dependent focus shift to the pupil."""
        return adjust_pupil(signal, self.name, red_um=self.red_um, blue_um=self.blue_um)


@dataclass(frozen=True, kw_only=True)
class Spherical(Effect):
    """Spherical aberration, equal over the field: asymmetry of the through-focus series.

    ``secondary`` is the share of the next order, which a corrected lens balances the primary one with.
    """

    name = "spherical"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 15.0
    absent = "lenses stopped down far"
    imitated_by = (
        "defocus",
        "charge_diffusion",
    )
    free = FreeAxis("field radius", "strength", 0.5)
    equation = (
        "W = c (sqrt(5) (6 rho^4 - 6 rho^2 + 1) + q sqrt(7) (20 rho^6 - 30 rho^4 + 12 rho^2 - 1)), c in waves rms at 550 nm, "
        "q = secondary"
    )
    reference = "Noll, J. Opt. Soc. Am. 66 (1976) 207, Z11 and Z22"
    must_not_change = ("dark", "flat", "illumination")

    rms_waves: float = parameter(0.0, unit="waves", low=-2.0, high=2.0, tau=0.1, doc="Noll coefficient Z11 at 550 nm")
    secondary: float = parameter(
        0.0, unit="1", low=-5.0, high=5.0, tau=0.3, shape=True, doc="Noll coefficient Z22, of that of Z11"
    )

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add the coefficients to the pupil."""
        more = {"secondary_spherical_waves": self.secondary * self.rms_waves} if self.secondary else {}
        return adjust_pupil(signal, self.name, spherical_waves=self.rms_waves, **more)


@dataclass(frozen=True, kw_only=True)
class Coma(Effect):
    """Primary coma along the field radius, growing linearly with it; makes edges asymmetric.

    The tilt that balances it is part of the Zernike term, so edges stay where they are to first order.  Rays land
    against the slope of W: the flare of a positive coefficient points towards the middle of the picture.  Programs that count
    the path the other way have the other sign.
    """

    name = "coma"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 16.0
    absent = "the middle of a centred lens"
    imitated_by = (
        "lateral_color",
        "motion_blur",
        "astigmatism",
    )
    free = FreeAxis("field radius", "strength", 0.5)
    equation = "W = c r sqrt(8) (3 rho^3 - 2 rho) cos(theta), theta from the field radius, r = 1 at the corner"
    reference = "Noll, J. Opt. Soc. Am. 66 (1976) 207, Z7/Z8"
    must_not_change = ("dark", "flat", "illumination")

    rms_waves: float = parameter(0.0, unit="waves", low=-2.0, high=2.0, tau=0.1, doc="Noll coefficient at the corner, 550 nm")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add the coefficient along the radius of the window's middle."""
        x, y = field_point(context)
        return adjust_pupil(signal, self.name, coma_x_waves=self.rms_waves * x, coma_y_waves=self.rms_waves * y)


@dataclass(frozen=True, kw_only=True)
class Astigmatism(Effect):
    """Primary astigmatism about the field radius, growing with its square: H and V edges part.

    Confounded with field curvature and motion blur; needs H and V edges at each field point.
    """

    name = "astigmatism"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 17.0
    absent = "the middle of a centred lens"
    imitated_by = (
        "field_curvature",
        "motion_blur",
        "sensor_tilt",
    )
    free = FreeAxis("field radius", "strength", 0.5)
    equation = "W = c r^2 sqrt(6) rho^2 cos(2 theta), theta from the field radius, r = 1 at the corner"
    reference = "Noll, J. Opt. Soc. Am. 66 (1976) 207, Z5/Z6"
    must_not_change = ("dark", "flat", "illumination")

    rms_waves: float = parameter(0.0, unit="waves", low=-2.0, high=2.0, tau=0.15, doc="Noll coefficient at the corner, 550 nm")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add the coefficient about the radius of the window's middle: r^2 cos 2phi = x^2 - y^2."""
        x, y = field_point(context)
        c = self.rms_waves
        return adjust_pupil(signal, self.name, astigmatism_0_waves=c * (x * x - y * y), astigmatism_45_waves=2 * c * x * y)


def _smear(fx: Float, fy: Float, wavelength_nm: Float, *, dx_px: float, dy_px: float) -> Float:
    """Transfer function of a box along (dx, dy)."""
    return np.asarray(np.sinc(fx * dx_px + fy * dy_px))


@dataclass(frozen=True, kw_only=True)
class MotionBlur(Effect):
    """Even motion of the image during the exposure: directional loss, the same at every focus and channel."""

    name = "motion_blur"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 60.0
    absent = "a camera and target that are bolted down, flashes"
    imitated_by = (
        "astigmatism",
        "charge_diffusion",
        "coma",
    )
    free = FreeAxis("frequency", "transfer", 0.5)
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"angle_deg": (0.0, 45.0, 90.0)}
    equation = "MTF x sinc(l (fx cos phi + fy sin phi))"
    reference = "Holst & Lomheim, CMOS/CCD Sensors and Camera Systems, 2nd ed., sec. 10.6 (linear motion)"
    must_not_change = ("dark", "flat", "illumination")

    length_px: float = parameter(0.0, unit="px", low=0.0, high=50.0, tau=0.7, doc="length l of the motion")
    angle_deg: float = parameter(0.0, unit="deg", low=-180.0, high=180.0, tau=45.0, shape=True, doc="direction phi off the rows")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """One more transfer function."""
        if not self.length_px:
            return signal
        phi = math.radians(self.angle_deg)
        return signal.blurred(partial(_smear, dx_px=self.length_px * math.cos(phi), dy_px=self.length_px * math.sin(phi)))
