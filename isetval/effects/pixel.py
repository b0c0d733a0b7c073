"""The pixel as an optical element: aperture, diffusion, microlens."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, FreeAxis, ParameterInfo, parameter
from isetval.core.errors import InputError
from isetval.core.signal import Signal
from isetval.effects.pupil import REFERENCE_NM

Float = NDArray[np.float64]
FORMS = ("gaussian", "sin2")
DIFFUSION_FORMS = ("gaussian", "tail")
REFERENCE_DEG = 30.0  # angle at which the loss is stated: about the largest chief ray angle of phone lenses


def _square(fx: Float, fy: Float, wavelength_nm: Float, *, width_px: float) -> Float:
    """Transfer function of a square pixel."""
    return np.asarray(np.sinc(width_px * fx) * np.sinc(width_px * fy))


def _diffused(fx: Float, fy: Float, wavelength_nm: Float, *, sigma_px: float, growth: float) -> Float:
    """Transfer function of Gaussian diffusion that grows with wavelength."""
    sigma = sigma_px * np.maximum(0.0, 1 + growth * (wavelength_nm - REFERENCE_NM) / 100)
    return np.asarray(np.exp(-2 * np.pi**2 * sigma**2 * (fx * fx + fy * fy)))


def _with_tail(fx: Float, fy: Float, wavelength_nm: Float, *, share: float, length_px: float) -> Float:
    """Transfer function of which a share falls off exponentially with the distance from an edge."""
    return np.asarray(1 - share + share / (1 + (2 * np.pi * length_px) ** 2 * (fx * fx + fy * fy)))


@dataclass(frozen=True, kw_only=True)
class PixelAperture(Effect):
    """The light-sensitive square of a pixel: the same blur for all channels and focus settings.

    Confounded with charge diffusion (rho .986); only the wavelength dependence of the latter helps.
    The fill factor changes blur here, not the level.
    """

    name = "pixel_aperture"
    stage = "pixel"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 10.0
    absent = "flats: it blurs and takes no light"
    imitated_by = (
        "charge_diffusion",
        "diffraction",
        "defocus",
    )
    free = FreeAxis("frequency", "transfer", 0.5)
    equation = "MTF x sinc(w fx) sinc(w fy)"
    reference = "Holst & Lomheim, CMOS/CCD Sensors and Camera Systems, 2nd ed., eq. 10-26 (detector MTF)"
    must_not_change = ("dark", "flat", "illumination")

    width_px: float = parameter(0.0, unit="px", low=0.0, high=2.0, tau=0.3, doc="width w of the pixel's aperture")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """One more transfer function."""
        return signal.blurred(partial(_square, width_px=self.width_px)) if self.width_px else signal


@dataclass(frozen=True, kw_only=True)
class ChargeDiffusion(Effect):
    """Spatial crosstalk: carriers that reach a neighbouring pixel.  Independent of focus, worst in red.

    ``form`` "gaussian": all of them spread by the same sigma.  "tail": a ``share`` of them was set free where no field draws it,
    and wanders as far as exp(-|x|/l): contrast falls early and then no further.  Confounded with the pixel aperture and with
    print blur of the chart.
    """

    name = "charge_diffusion"
    stage = "pixel"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 20.0
    absent = "back-illuminated sensors with deep trenches: little of it"
    imitated_by = (
        "pixel_aperture",
        "defocus",
        "interpixel_capacitance",
    )
    free = FreeAxis("frequency", "transfer", 0.5)
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"form": DIFFUSION_FORMS}
    equation = (
        "MTF x exp(-2 pi^2 sigma^2 f^2), sigma = sigma_c (1 + growth (lambda - 550 nm)/100 nm); "
        "of a tail MTF x (1 - s + s/(1 + (2 pi l f)^2))"
    )
    reference = (
        "Janesick, Photon Transfer (SPIE 2007), sec. 10; Seib, IEEE Trans. Electron Devices 21 (1974) 210 (charge from the bulk "
        "without field); both kernels are conventions"
    )
    must_not_change = ("dark", "flat", "illumination")

    sigma_px: float = parameter(0.0, unit="px", low=0.0, high=3.0, tau=0.25, doc="standard deviation of the spread at 550 nm")
    growth: float = parameter(0.0, unit="1/100 nm", low=-0.5, high=1.0, tau=0.1, shape=True, doc="growth with wavelength")
    share: float = parameter(0.0, unit="1", low=0.0, high=1.0, tau=0.05, doc="share s of the carriers in the tail")
    length_px: float = parameter(1.0, unit="px", low=0.1, high=20.0, tau=0.5, shape=True, doc="decay length l of the tail")
    form: str = DIFFUSION_FORMS[0]

    def __post_init__(self) -> None:
        """A number of the other form: InputError."""
        super().__post_init__()
        self.refuse_idle()

    def own_parameters(self) -> tuple[ParameterInfo, ...]:
        """Without those of the other form."""
        idle = ("sigma_px", "growth") if self.form == DIFFUSION_FORMS[1] else ("share", "length_px")
        return tuple(p for p in self.parameters() if p.name not in idle)

    def apply(self, signal: Signal, context: Context) -> Signal:
        """One more transfer function."""
        if self.share:
            return signal.blurred(partial(_with_tail, share=self.share, length_px=self.length_px))
        if not self.sigma_px:
            return signal
        return signal.blurred(partial(_diffused, sigma_px=self.sigma_px, growth=self.growth))


@dataclass(frozen=True, kw_only=True)
class Microlens(Effect):
    """Loss at the microlens that grows with the chief-ray angle; may differ between channels.

    Even over the field.  The part common to all channels has the shape of cos^4 (rho .998); the channel ratios R/G(r) and
    B/G(r) are its own.  One color may gain towards the corner, where light that another filter's pixels lose arrives: its
    loss is negative.  Acts on the electrons of each colour channel (a monochrome sensor uses ``m_green``), so it stands
    behind quantum_efficiency and before cfa.
    """

    name = "microlens"
    stage = "pixel"
    acts_on = "electron"
    gives = "electron"
    order = 45.0
    absent = "telecentric lenses; sensors whose microlenses are shifted to the chief rays"
    imitated_by = (
        "cos4",
        "vignetting",
        "light_nonuniformity",
        "pixel_angular_response",
    )
    free = FreeAxis("field radius", "share", 0.5)
    equation = "mu_c x (1 - m_c r^2), r = 1 at the corner"
    reference = "Catrysse & Wandell, J. Opt. Soc. Am. A 19 (2002) 1610 (pixel vignetting); second-order term"
    must_not_change = ("dark",)
    for_unstated_chief_ray = True

    m_red: float = parameter(0.0, unit="1", low=-1.0, high=1.0, tau=0.15, doc="loss of red at the corner (gain < 0)")
    m_green: float = parameter(0.0, unit="1", low=-1.0, high=1.0, tau=0.15, doc="loss of green at the corner (gain < 0)")
    m_blue: float = parameter(0.0, unit="1", low=-1.0, high=1.0, tau=0.15, doc="loss of blue at the corner (gain < 0)")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale each colour channel."""
        if not (self.m_red or self.m_green or self.m_blue):
            return signal
        loss = (self.m_green,) if context.sensor.cfa == "MONO" else (self.m_red, self.m_green, self.m_blue)
        return signal.scaled(1 - np.array(loss)[:, None, None] * context.field_radius()[None] ** 2)


@dataclass(frozen=True, kw_only=True)
class PixelAngularResponse(Effect):
    """Loss of a pixel by the angle at which light arrives: the lens's chief ray angle, against shifted microlenses.

    Even over the field, and other than cos^4 where the lens bends its chief rays back towards the corner, as phone lenses
    do; may differ between channels.  Microlenses that are shifted towards the middle take off ``-shift_deg`` at the
    corner, in proportion to the field radius; a positive shift is one in the wrong direction, or the growing loss of a pixel
    that is deeper than its microlens allows.  Needs a lens that states its chief rays (ray_transfer) in front of it; for
    models without one, microlens (1 - m r^2) has the shape to second order.  Acts on electrons behind
    quantum_efficiency and before cfa; a monochrome sensor uses ``m_green``.

    ``form``: "gaussian" (1 - m)^((a / 30 deg)^2), or "sin2" 1 - m sin^2 a / sin^2 30 deg, with the angle
    a = chief ray + shift r.  On the paper's measured curve both leave .7 points of held-out error without a shift and
    .4 with one; 1 - m r^2 leaves 1.9.
    """

    name = "pixel_angular_response"
    stage = "pixel"
    acts_on = "electron"
    gives = "electron"
    order = 46.0
    absent = "telecentric lenses"
    imitated_by = (
        "microlens",
        "cos4",
        "vignetting",
    )
    free = FreeAxis("chief ray angle", "share", 0.5)
    equation = "mu_c x (1 - m_c)^((a/30 deg)^2), a = chief ray angle + shift r, r = 1 at the corner"
    reference = "Catrysse & Wandell, J. Opt. Soc. Am. A 19 (2002) 1610 (pixel vignetting); forms are conventions"
    must_not_change = ("dark",)
    needs_chief_ray = True
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"form": FORMS}

    m_red: float = parameter(0.0, unit="1", low=0.0, high=0.99, tau=0.1, doc="loss of red at 30 degrees")
    m_green: float = parameter(0.0, unit="1", low=0.0, high=0.99, tau=0.1, doc="loss of green at 30 degrees")
    m_blue: float = parameter(0.0, unit="1", low=0.0, high=0.99, tau=0.1, doc="loss of blue at 30 degrees")
    shift_deg: float = parameter(0.0, unit="deg", low=-60.0, high=60.0, tau=15.0, doc="added to the angle at the corner, by r")
    form: str = "gaussian"

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale each colour channel; InputError where no lens stated its chief rays."""
        if not (self.m_red or self.m_green or self.m_blue):
            return signal
        if signal.chief_ray_deg is None:
            raise InputError(
                "effect pixel_angular_response: no lens in front of it states the angle of its chief rays; put in ray_transfer, "
                "or use microlens"
            )
        loss = (self.m_green,) if context.sensor.cfa == "MONO" else (self.m_red, self.m_green, self.m_blue)
        angle = signal.chief_ray_deg(*context.xy_mm()) + self.shift_deg * context.field_radius()
        if self.form == "gaussian":
            power = (angle / REFERENCE_DEG) ** 2
            return signal.scaled((1 - np.array(loss)[:, None, None]) ** power[None])
        share = (np.sin(np.radians(angle)) / np.sin(np.radians(REFERENCE_DEG))) ** 2
        return signal.scaled(np.maximum(1 - np.array(loss)[:, None, None] * share[None], 0.0))
