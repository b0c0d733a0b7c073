"""Light over the field: natural and mechanical fall-off, decentring, shifts, flare.  All act on irradiance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, FreeAxis, Scan, parameter
from isetval.core.scene import Spectrum
from isetval.core.signal import Signal
from isetval.effects.pupil import REFERENCE_NM

Float = NDArray[np.float64]
GLASS = 1.5  # index of a cover glass, on which the angle inside hangs
ORDERS_AT_ONCE = 4096  # 13 MB of waves at 400 wavelengths: a cover glass of a millimeter has thousands of orders
UNIT = 0.01  # an amplitude within its bounds
ORDER_STEP = 0.005  # orders between which a fringe is a straight line to 2.3e-4 of its height: (2 pi step 550/400)^2/8 at 400 nm


def _tangent2(x_mm: Float, y_mm: Float, focal_mm: float) -> Float:
    """Squared tangent of the field angle, (rows, cols), at distances from the lens axis in mm."""
    return np.asarray((x_mm * x_mm + y_mm * y_mm) / focal_mm**2)


@dataclass(frozen=True, kw_only=True)
class Cos4(Effect):
    """Natural fall-off of a lens with a pupil of fixed size: cos^4, with a free exponent.

    Even, smooth and free of colour: the microlens has the same shape (rho .998); a lens with another
    exit pupil separates them.  delta = -4 is no fall-off at all.  Leaves edges and darks alone.
    """

    name = "cos4"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 30.0
    absent = "telecentric lenses, whose chief rays arrive upright"
    imitated_by = (
        "microlens",
        "vignetting",
        "light_nonuniformity",
        "pixel_angular_response",
    )
    free = FreeAxis("field radius", "gain", 0.2)
    equation = "E x cos^(4 + delta)(theta), tan theta = distance from the middle / focal length"
    reference = "Kingslake, Optics in Photography (1992), ch. 7; Born & Wolf, 7th ed., sec. 4.8.1"
    must_not_change = ("dark",)

    focal_mm: float = parameter(
        4.38, unit="mm", low=0.1, high=2000.0, shape=True, doc="focal length (distance of the exit pupil)"
    )
    delta: float = parameter(0.0, unit="1", low=-4.0, high=16.0, tau=2.0, null=-4.0, doc="exponent above 4")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale by the fall-off of each pixel."""
        if self.delta == -4.0:
            return signal
        x, y = context.xy_mm()
        return signal.scaled((1 + _tangent2(x, y, self.focal_mm))[None] ** (-(4 + self.delta) / 2))


@dataclass(frozen=True, kw_only=True)
class Vignetting(Effect):
    """Mechanical vignetting: loss with a sharp onset beyond a field radius.

    Confounded with a radial light field and the microlens; a smaller stop removes it.  A rim as large as the pupil that
    moves off it takes 4/pi of its shift, to first order: ``power`` 1.  The change of the corner's blur by the cut pupil is not
    modelled.
    """

    name = "vignetting"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 32.0
    absent = "lenses stopped down: the rim of the pupil is then free"
    imitated_by = (
        "light_nonuniformity",
        "microlens",
        "cos4",
    )
    free = FreeAxis("field radius", "gain", 0.2)
    equation = "E x (1 - v max(0, (r - r0)/(1 - r0))^power), r = 1 at the corner"
    reference = (
        "Kingslake & Johnson, Lens Design Fundamentals, 2nd ed., sec. 8.1 (vignetting); Asada, Amano & Baba, ICPR 1996, 186 "
        "(overlap of two discs); quadratic onset is a convention"
    )
    must_not_change = ("dark",)
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"power": (2.0, 1.0)}
    further_shapes = ("power",)

    v: float = parameter(0.0, unit="1", low=0.0, high=1.0, tau=0.2, doc="loss at the corner")
    r0: float = parameter(0.6, unit="half diagonal", low=0.0, high=0.99, tau=0.15, shape=True, doc="onset r0")
    power: float = parameter(2.0, unit="1", low=0.5, high=8.0, tau=1.0, shape=True, doc="power with which the loss sets in")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale by the loss of each pixel."""
        if not self.v:
            return signal
        reach = np.maximum(0.0, (context.field_radius() - self.r0) / (1 - self.r0))
        return signal.scaled(1 - self.v * reach[None] ** self.power)


@dataclass(frozen=True, kw_only=True)
class Decenter(Effect):
    """A lens or pupil that sits beside the sensor's middle: its natural fall-off is moved, equal in all channels.

    To first order a gradient, which a tilt of the light imitates: what tells them apart is that the gradient becomes flatter
    outwards, and rotating the camera by 180 degrees (.73 to .19).
    """

    name = "decenter"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 34.0
    absent = "centred lenses"
    imitated_by = (
        "light_nonuniformity",
        "sensor_tilt",
    )
    free = FreeAxis("field radius", "share", 0.5)
    equation = "E x cos^4(theta from the lens axis)/cos^4(theta from the sensor's middle), tan theta = distance / focal length"
    reference = "Kingslake, Optics in Photography (1992), ch. 7, about the axis of the lens"
    must_not_change = ("dark",)

    x_um: float = parameter(0.0, unit="um", low=-5000.0, high=5000.0, tau=50.0, doc="lens axis from the sensor's middle, x")
    y_um: float = parameter(0.0, unit="um", low=-5000.0, high=5000.0, tau=50.0, doc="lens axis from the sensor's middle, y")
    focal_mm: float = parameter(
        4.38, unit="mm", low=0.1, high=2000.0, shape=True, doc="focal length (distance of the exit pupil)"
    )

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale by the ratio of both fall-offs at each pixel."""
        if not (self.x_um or self.y_um):
            return signal
        x, y = context.xy_mm()
        moved = _tangent2(x - 1e-3 * self.x_um, y - 1e-3 * self.y_um, self.focal_mm)
        return signal.scaled((((1 + _tangent2(x, y, self.focal_mm)) / (1 + moved)) ** 2)[None])


def _ripple_gains(
    plate: EtalonRipple, names: Sequence[str], wavelength_nm: Float, x_mm: Float, y_mm: Float, radiance: Spectrum | None
) -> Float:
    """The ripple of a plate per unit of each of its amplitudes (`Scan.gains`)."""
    order, none = plate.order_at(x_mm, y_mm), {"amplitude": 0.0, "quadrature": 0.0}
    return np.stack([plate.changed(**none | {name: UNIT}).ripple(order, wavelength_nm, radiance) / UNIT for name in names])


@dataclass(frozen=True, kw_only=True)
class EtalonRipple(Effect):
    """Interference in the cover glass: radial fringes on flats, washed out by broad-band light.

    Asked with orders whose periods, 28 and 14 nm, are narrower than color filters: broader ones are what filters and lights do;
    where either explains something, with all between and beyond.
    """

    name = "etalon_ripple"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 36.0
    absent = "broad light, anti-reflection coatings, no cover glass"
    imitated_by = (
        "light_nonuniformity",
        "prnu",
        "vignetting",
    )
    forms: ClassVar[Mapping[str, tuple[str | float, ...]]] = {"order_550": (20.0, 40.0)}
    # lines of a lamp 60 nm apart turn against each other once in 9 orders, all of a mercury lamp's once in 2.8
    scan: ClassVar[Scan | None] = Scan("order_550", tuple(np.arange(10.0, 60.01, 0.25).tolist()), 0.05, _ripple_gains)
    equation = (
        "E x (1 + a cos(phi) + b sin(phi)), phi = 2 pi (550 nm/lambda) m cos(theta'), sin(theta') = sin(theta)/1.5, theta the "
        "angle of the chief ray, averaged over the photons of each band; m - n r^2 for m cos(theta') where n fringes to the "
        "corner are stated"
    )
    reference = "Born & Wolf, Principles of Optics, 7th ed., sec. 7.6 (plane-parallel plate, low reflectance)"
    must_not_change = ("dark", "edge")

    amplitude: float = parameter(0.0, unit="1", low=-0.5, high=0.5, tau=0.005, doc="amplitude a of the ripple")
    quadrature: float = parameter(
        0.0, unit="1", low=-0.5, high=0.5, tau=0.005, doc="amplitude b a quarter of a fringe on: the phase hangs on nanometers"
    )
    fringes: float = parameter(
        0.0, unit="1", low=0.0, high=1000.0, shape=True, doc="fringes n from middle to corner at 550 nm; 0: those of a plate"
    )
    order_550: float = parameter(
        20.0, unit="1", low=0.0, high=1e5, shape=True, doc="interference order m in the middle at 550 nm"
    )
    focal_mm: float = parameter(
        4.38, unit="mm", low=0.1, high=2000.0, shape=True, doc="focal length (distance of the exit pupil)"
    )

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale by the fringe of each pixel and wavelength."""
        if not (self.amplitude or self.quadrature):
            return signal
        grid = np.array([REFERENCE_NM]) if signal.wavelength_nm is None else signal.wavelength_nm
        return signal.scaled(1 + self.ripple(self._order(context), grid, context.radiance))

    def _order(self, context: Context) -> Float:
        """Interference order at 550 nm, (rows, cols)."""
        if self.fringes:
            return np.asarray(self.order_550 - self.fringes * context.field_radius() ** 2)
        return self.order_at(*context.xy_mm())

    def order_at(self, x_mm: Float, y_mm: Float) -> Float:
        """Interference order at 550 nm of a plate, where chief rays arrive at places in mm from the sensor's middle."""
        tangent2 = _tangent2(x_mm, y_mm, self.focal_mm)
        return np.asarray(self.order_550 * np.sqrt(1 - tangent2 / (1 + tangent2) / GLASS**2))

    def ripple(self, order: Float, grid: Float, radiance: Spectrum | None) -> Float:
        """The ripple (bands, ...) at orders (...), averaged over the photons of each band of a light's ``radiance``."""
        if radiance is None or grid.size < 2:
            return np.stack([self._wave(nm, order) for nm in grid])
        points, shares = radiance.photon_shares(grid)
        count = int((float(order.max()) - float(order.min())) / ORDER_STEP) + 3
        orders = float(order.min()) + ORDER_STEP * np.arange(count) if count < order.size else order.ravel()
        parts = np.array_split(orders, -(-orders.size // ORDERS_AT_ONCE))
        means = np.hstack([shares @ self._wave(points[:, None], part) for part in parts])
        if count >= order.size:
            return means.reshape(-1, *order.shape)
        return np.stack([np.interp(order, orders, band) for band in means])

    def _wave(self, wavelength_nm: Float, order: Float) -> Float:
        phase = 2 * np.pi * (REFERENCE_NM / wavelength_nm) * order
        return np.asarray(self.amplitude * np.cos(phase) + self.quadrature * np.sin(phase))


def field_mean(signal: Signal, context: Context) -> Float:
    """Mean irradiance (bands, 1, 1) of the field: the context's, or that of the window where it has none."""
    if context.mean_irradiance is not None:
        return np.asarray(context.mean_irradiance, float)[:, None, None]
    return np.asarray(signal.values.mean(axis=(1, 2), keepdims=True))


@dataclass(frozen=True, kw_only=True)
class Ghost(Effect):
    """Light thrown back between lens surfaces: a wide disc of the whole field's mean around the middle.

    The mirrored image E(-k x) is far out of focus, so its detail is replaced by the field's mean and its
    border at r = 1/k is a smooth step of width 1/(4k).  Leaves darks alone.
    """

    name = "ghost"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 80.0
    absent = "scenes without bright places, well coated lenses"
    imitated_by = (
        "light_nonuniformity",
        "veiling_glare",
        "vignetting",
    )
    free = FreeAxis("field radius", "share", 0.5)
    equation = "E += gamma <E> disc(k r)"
    reference = "ISO 18844:2017 (image flare); Kingslake, Optics in Photography (1992), ch. 5 (ghosts)"
    must_not_change = ("dark",)
    uses_mean_irradiance = True

    gamma: float = parameter(0.0, unit="1", low=0.0, high=1.0, tau=0.005, doc="ghost light as a fraction of the field's mean")
    k: float = parameter(2.0, unit="1", low=0.2, high=50.0, tau=0.7, shape=True, doc="inverse radius in half diagonals")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add the disc."""
        if not self.gamma:
            return signal
        disc = 0.5 * (1 - np.tanh(8 * (self.k * context.field_radius() - 1)))
        return signal.plus(self.gamma * field_mean(signal, context) * disc[None])


@dataclass(frozen=True, kw_only=True)
class VeilingGlare(Effect):
    """Light scattered evenly over the field: darks of a scene rise in proportion to its mean.

    Gain-like on flats, absent from darks; confounded with ambient light and black reflectance (a black
    trap in bright and in dark surround separates them).
    """

    name = "veiling_glare"
    stage = "optics"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 90.0
    absent = "capped darks; small in clean lenses without a bright surround"
    imitated_by = (
        "ambient_light",
        "black_reflectance",
        "black_level",
    )
    free = FreeAxis("field radius", "share", 0.5)
    equation = "E += gamma <E>, <E> the mean over the whole field"
    reference = "ISO 18844:2017; ISO 9358:1994"
    must_not_change = ("dark",)
    uses_mean_irradiance = True

    gamma: float = parameter(0.0, unit="1", low=0.0, high=1.0, tau=0.02, doc="glare as a fraction of the field's mean irradiance")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Add the scattered light."""
        return signal.plus(self.gamma * field_mean(signal, context)) if self.gamma else signal
