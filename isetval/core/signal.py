"""What effects pass on: light or charge on a window of the sensor.

A signal is a sum of layers.  A layer is an amplitude, (bands, rows, cols) or anything that broadcasts
to it, kept as a spectrum times what is the same in all bands, times an optional sharp structure (an edge, a rendered
picture) that has not been sampled on pixels yet.  Blur does not touch amplitudes: it adds a transfer function, and `values`
applies the product of all transfer functions, that of the pupil among them, to the structures.  An edge is therefore exact
at every blur.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.errors import InputError

Float = NDArray[np.float64]
UNITS = ("radiance", "irradiance", "electron", "dn")
SPECTRAL_UNITS = ("radiance", "irradiance")
SHIFT_STATED_AT_NM = 550.0  # shifts of interference filters go with the wavelength; this is the middle of what is seen

FieldCurve = Callable[[Float, Float], Float]
"""A quantity over the sensor at places (x_mm, y_mm) from its middle.  Arguments broadcast."""

Transfer = Callable[[Float, Float, Float], Float]
"""Optical transfer function (fx_cy_px, fy_cy_px, wavelength_nm) ; complex where the blur is not even.  Arguments broadcast."""


@dataclass(frozen=True)
class Moved:
    """Transfer function of an image that is moved by ``shift_px(wavelength_nm)``, to higher columns and to higher rows, in px.

    ``of_samples`` is that of a picture of whole pixels, each of one colour: what a pixel then sees is the share of both
    neighbours, exactly.  Between samples a phase alone rings: 4 px inside a patch it leaves a hundredth of the step to the next.
    """

    shift_px: Callable[[Float], tuple[Any, Any]]

    def __call__(self, fx: Float, fy: Float, wavelength_nm: Float) -> Float:
        """A phase."""
        right, down = self.shift_px(wavelength_nm)
        return np.asarray(np.exp(-2j * np.pi * (fx * right + fy * down)))

    def of_samples(self, fx: Float, fy: Float, wavelength_nm: Float) -> Float:
        """Linear interpolation along both axes."""
        right, down = self.shift_px(wavelength_nm)
        return np.asarray(_between(fx, right) * _between(fy, down))


def _between(frequency: Float, shift: Any) -> Any:
    whole = np.floor(shift)
    part = shift - whole
    return np.exp(-2j * np.pi * frequency * whole) * (1 - part + part * np.exp(-2j * np.pi * frequency))


@dataclass(frozen=True)
class Product:
    """The product of transfer functions; ``of_samples`` takes each as a picture of whole pixels sees it."""

    parts: tuple[Transfer, ...]

    def __call__(self, fx: Float, fy: Float, wavelength_nm: Float) -> Float:
        """Of all."""
        return self._of(self.parts, fx, fy, wavelength_nm)

    def of_samples(self, fx: Float, fy: Float, wavelength_nm: Float) -> Float:
        """Of all, moves between samples."""
        return self._of([getattr(part, "of_samples", part) for part in self.parts], fx, fy, wavelength_nm)

    @staticmethod
    def _of(parts: Sequence[Transfer], fx: Float, fy: Float, wavelength_nm: Float) -> Float:
        out: Any = 1.0
        for part in parts:
            out = out * part(fx, fy, wavelength_nm)
        return np.asarray(out)


class Structure(Protocol):
    """Sharp detail of a scene, not yet sampled on pixels."""

    def sample(self, amplitude: Float, transfer: Transfer | None, wavelength_nm: Float | None) -> Float:
        """The blurred and sampled layer, (bands, rows, cols)."""
        ...

    def mixed(self, weights: Float, transfer: Transfer | None, wavelength_nm: Float | None) -> Float:
        """Sums over the bands with ``weights`` (channels, bands) of the blurred structure, (channels, rows, cols)."""
        ...


class Pupil(Protocol):
    """The exit pupil that images the scene: effects shift its focus and add aberrations to it."""

    def transfer(self, fx: Float, fy: Float, wavelength_nm: Float) -> Float:
        """Transfer function at (fx_cy_px, fy_cy_px, wavelength_nm); arguments broadcast."""
        ...


@dataclass(frozen=True, eq=False)
class Layer:
    """An amplitude, ``spectrum`` times ``gain``, and the sharp structure it multiplies (None: everywhere 1).

    ``gain``, (1, rows, cols) or what broadcasts, is the same in all bands: most of what light meets on its way.  Sums over the
    bands are then taken before any picture is made.
    """

    spectrum: Float
    structure: Structure | None = None
    gain: Float | None = None

    @property
    def amplitude(self) -> Float:
        """Spectrum times gain."""
        return self.spectrum if self.gain is None else self.spectrum * self.gain

    def scaled(self, factor: Float) -> Layer:
        """The layer times a factor, which broadcasts to (bands, rows, cols)."""
        if factor.ndim < 3 or len(factor) == 1:
            return replace(self, gain=factor if self.gain is None else self.gain * factor)
        return replace(self, spectrum=self.spectrum * factor)

    def mixed(self, weights: Float, transfer: Transfer | None, wavelength_nm: Float | None) -> Float:
        """Sums over the bands with ``weights`` (channels, bands): (channels, rows, cols), or what broadcasts to it."""
        spectrum = self.spectrum
        if self.structure is not None and spectrum.shape[1:] == (1, 1):
            sums = self.structure.mixed(weights * spectrum[:, 0, 0], transfer, wavelength_nm)
        else:
            values = spectrum if self.structure is None else self.structure.sample(spectrum, transfer, wavelength_nm)
            sums = np.tensordot(weights, np.broadcast_to(values, (weights.shape[1], *values.shape[1:])), axes=1)
        return sums if self.gain is None else sums * self.gain


@dataclass(frozen=True, eq=False)
class Filters:
    """How the colour filters differ from their tables: stated by effects in front of the quantum efficiency, which applies it.

    ``leak`` is a quantum efficiency added beyond the infrared-cut filter, in electrons per photon (channels, bands); ``shift_nm``
    moves the curves by so much at `SHIFT_STATED_AT_NM`, elsewhere in proportion to the wavelength, and broadcasts to (rows, cols)
    (None: nowhere); ``apart_nm`` moves those of red, green and blue each by its own, which may be another in each band (bands,).
    """

    leak: Float | float = 0.0
    shift_nm: Float | None = None
    apart_nm: tuple[Float | float, Float | float, Float | float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Signal:
    """Light or charge on a window.

    ``unit`` is radiance (W/(sr m2 nm)), irradiance (W/(m2 nm)), electron or dn; ``wavelength_nm`` is
    (bands,) for the spectral units and None behind the quantum efficiency, where the first axis
    holds colour channels (R, G, B; one for MONO) and, behind the colour filter array, one mosaic.
    ``chief_ray_deg`` is the angle of the lens's chief ray to the axis, where a lens stated it: kept up to the mosaic.
    ``apart_px`` are shifts of the pictures of red, green and blue (to higher columns, to higher rows), each moved as a whole.
    """

    layers: tuple[Layer, ...]
    unit: str
    shape: tuple[int, int]
    wavelength_nm: Float | None = None
    transfers: tuple[Transfer, ...] = ()
    pupil: Pupil | None = None
    filters: Filters = Filters()
    chief_ray_deg: FieldCurve | None = None
    apart_px: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        if self.unit not in UNITS:
            raise InputError(f"signal unit is {self.unit!r}; it needs one of {', '.join(UNITS)}")

    @classmethod
    def of(cls, values: ArrayLike, unit: str, *, shape: tuple[int, int] | None = None, wavelength_nm: Any = None) -> Signal:
        """A signal of plain values (bands or channels, rows, cols)."""
        array = np.asarray(values)
        grid = None if wavelength_nm is None else np.asarray(wavelength_nm, float)
        return cls((Layer(array),), unit, shape or (array.shape[-2], array.shape[-1]), grid)

    @property
    def values(self) -> Float:
        """Sampled values; bands and pixels in which nothing varies may have length 1."""
        if len(self.layers) == 1 and self.layers[0].structure is None:
            return self.layers[0].amplitude
        total: Any = 0
        transfer = self._transfer()
        for layer in self.layers:
            if layer.structure is None:
                total = total + layer.amplitude
            else:
                total = total + layer.structure.sample(layer.amplitude, transfer, self.wavelength_nm)
        return np.asarray(total)

    def mixed(self, weights: Float) -> Float:
        """Sums over the bands with ``weights`` (channels, bands): (channels, rows, cols), or what broadcasts to it."""
        if self.apart_px:
            own = self.apart_px[1:2] if len(weights) == 1 else self.apart_px
            return np.concatenate([self._moved(shift).mixed(weights[c : c + 1]) for c, shift in enumerate(own)])
        transfer = self._transfer()
        return np.asarray(sum(layer.mixed(weights, transfer, self.wavelength_nm) for layer in self.layers))

    def _moved(self, shift: tuple[float, float]) -> Signal:
        """One channel's light, moved as a whole."""
        still = replace(self, apart_px=())
        return still.blurred(Moved(lambda wavelength_nm: shift)) if any(shift) else still

    def _transfer(self) -> Transfer | None:
        parts = self.transfers if self.pupil is None else (self.pupil.transfer, *self.transfers)
        return Product(parts) if parts else None

    def scaled(self, factor: ArrayLike) -> Signal:
        """Every layer times ``factor``, which broadcasts to (bands, rows, cols)."""
        array = np.asarray(factor)
        return replace(self, layers=tuple(layer.scaled(array) for layer in self.layers))

    def plus(self, offset: ArrayLike) -> Signal:
        """The signal and a smooth ``offset``, which broadcasts to (bands, rows, cols)."""
        return replace(self, layers=(*self.layers, Layer(np.asarray(offset))))

    def blurred(self, transfer: Transfer) -> Signal:
        """The signal behind one more transfer function."""
        return replace(self, transfers=(*self.transfers, transfer))

    def moved_apart(self, shifts_px: Sequence[tuple[float, float]]) -> Signal:
        """The signal of which the pictures of red, green and blue are moved each as a whole; further moves add up."""
        before = self.apart_px or ((0.0, 0.0),) * len(shifts_px)
        moved = tuple((x + dx, y + dy) for (x, y), (dx, dy) in zip(before, shifts_px, strict=True))
        return replace(self, apart_px=moved)

    def through(self, pupil: Pupil) -> Signal:
        """The signal imaged by another pupil."""
        return replace(self, pupil=pupil)

    def filtered(
        self, *, leak: Float | float = 0.0, shift_nm: Float | None = None, apart_nm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> Signal:
        """The signal in front of changed colour filters; further changes add up."""
        before = self.filters.shift_nm
        shift = before if shift_nm is None else shift_nm if before is None else before + shift_nm
        red, green, blue = (a + b for a, b in zip(self.filters.apart_nm, apart_nm, strict=True))
        return replace(self, filters=Filters(self.filters.leak + leak, shift, (red, green, blue)))

    def with_values(self, values: Float, unit: str | None = None) -> Signal:
        """Sampled ``values`` in place of the layers; structures and transfers are spent.

        Light that stays light keeps its wavelengths and what is stated of the filters; electrons have met both.
        """
        unit = unit or self.unit
        if unit in SPECTRAL_UNITS:
            return Signal(
                (Layer(values),), unit, self.shape, self.wavelength_nm, filters=self.filters, chief_ray_deg=self.chief_ray_deg
            )
        return Signal((Layer(values),), unit, self.shape, chief_ray_deg=self.chief_ray_deg)
