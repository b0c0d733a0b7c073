"""From irradiance to the electrons of colour channels, and on to the mosaic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, FreeAxis, parameter, table_file
from isetval.core.errors import InputError
from isetval.core.scene import Spectrum, read_spectra
from isetval.core.signal import SHIFT_STATED_AT_NM, Signal
from isetval.core.toml import resolve_path

Float = NDArray[np.float64]
PLANCK_J_S = 6.62607015e-34
LIGHT_M_PER_S = 299792458.0
LEAK_ABOVE_NM = 700.0  # where the infrared-cut filter of a camera has closed
CHANNELS = ("R", "G", "B")


@dataclass(frozen=True, kw_only=True)
class CfaAngleShift(Effect):
    """Colour-filter curves that move with the angle of incidence: a colour residual growing with r.

    Confounded with an error of the light's spectrum, which does not depend on the place in the field.
    Interference filters move to shorter wavelengths, in proportion to them: delta < 0.  Stands before quantum_efficiency,
    which moves its curves (linear between whole nanometres at 550 nm).
    """

    name = "cfa_angle_shift"
    stage = "pixel"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 30.0
    absent = "the middle of the field, absorbing filters without an interference coating"
    imitated_by = (
        "spd_mismatch",
        "microlens",
        "spectral_crosstalk",
    )
    free = FreeAxis("field radius", "filters", 0.5)
    equation = "QE(lambda (1 - Delta(r)/550 nm)), Delta = delta r^2, r = 1 at the corner"
    reference = "Macleod, Thin-Film Optical Filters, 4th ed., sec. 8.2: lambda sqrt(1 - sin^2/n^2), second order"
    must_not_change = ("dark", "edge")

    delta_nm: float = parameter(0.0, unit="nm", low=-40.0, high=40.0, tau=5.0, doc="shift of the QE at the corner, at 550 nm")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """State the shift for quantum_efficiency."""
        return signal.filtered(shift_nm=self.delta_nm * context.field_radius() ** 2) if self.delta_nm else signal


@dataclass(frozen=True, kw_only=True)
class QeShift(Effect):
    """Curves of quantum efficiency that lie at other wavelengths than their table says, each channel by its own.

    Filters of another lot, an infrared-cut filter that closes elsewhere, a monochromator that is some nm off.  In one light it
    is a gain of each channel, in charts of many colours it is not; lights with lines tell it best.  Stands before
    quantum_efficiency, which moves its curves (those of a monochrome sensor by ``green_nm``).
    """

    name = "qe_shift"
    stage = "pixel"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 32.0
    absent = "curves measured on the very camera with a checked monochromator"
    imitated_by = (
        "channel_gain",
        "spectral_crosstalk",
        "spd_mismatch",
        "cfa_angle_shift",
    )
    free = FreeAxis("wavelength", "filters", 0.5)
    equation = "QE_c(lambda - d_c)"
    reference = "Jiang, Liu, Gu & Suesstrunk, WACV 2013, 168 (curves of 28 cameras)"
    must_not_change = ("dark", "edge")

    red_nm: float = parameter(0.0, unit="nm", low=-40.0, high=40.0, tau=3.0, doc="shift d of the red curve to longer waves")
    green_nm: float = parameter(0.0, unit="nm", low=-40.0, high=40.0, tau=3.0, doc="shift d of the green curve to longer waves")
    blue_nm: float = parameter(0.0, unit="nm", low=-40.0, high=40.0, tau=3.0, doc="shift d of the blue curve to longer waves")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """State the shifts for quantum_efficiency."""
        apart = (self.red_nm, self.green_nm, self.blue_nm)
        return signal.filtered(apart_nm=apart) if any(apart) else signal


@dataclass(frozen=True, kw_only=True)
class IrLeak(Effect):
    """Response beyond the infrared-cut filter, equal in all channels unless it is said otherwise: seen under light A only.

    Reaches as far as the tables of light and of quantum efficiency do, or to where it has fallen to nothing: silicon absorbs less
    and less up to 1100 nm, and dyes of the filters differ up to about 800 nm.  Stands before quantum_efficiency, which adds it.
    """

    name = "ir_leak"
    stage = "pixel"
    acts_on = "irradiance"
    gives = "irradiance"
    order = 35.0
    absent = "lights without infrared: LED, fluorescent tubes"
    imitated_by = (
        "spd_mismatch",
        "channel_gain",
        "spectral_crosstalk",
    )
    equation = "QE_c + eps (1 + d_c) max(0, 1 - f (lambda - 700 nm) / 100 nm) for lambda > 700 nm, d_green = 0"
    reference = "Holst & Lomheim, CMOS/CCD Sensors and Camera Systems, 2nd ed., sec. 5.3 (infrared-cut filter); f: ours"
    must_not_change = ("dark", "edge")

    eps: float = parameter(0.0, unit="e-/photon", low=0.0, high=1.0, tau=0.02, doc="quantum efficiency added above 700 nm")
    fall_per_100_nm: float = parameter(
        0.0, unit="1", low=0.0, high=4.0, tau=0.25, shape=True, doc="fall f of it over 100 nm (silicon from 700 to 1100 nm: .25)"
    )
    d_red: float = parameter(0.0, unit="1", low=-1.0, high=20.0, tau=0.3, shape=True, doc="red's leak over green's, less 1")
    d_blue: float = parameter(0.0, unit="1", low=-1.0, high=20.0, tau=0.3, shape=True, doc="blue's leak over green's, less 1")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """State the leak for quantum_efficiency, which asks for wavelengths."""
        grid = signal.wavelength_nm
        if not self.eps or grid is None:
            return signal
        colors = [1.0] if context.sensor.cfa == "MONO" else [1 + self.d_red, 1.0, 1 + self.d_blue]
        left = np.maximum(0.0, 1 - self.fall_per_100_nm * (grid - LEAK_ABOVE_NM) / 100) * (grid > LEAK_ABOVE_NM)
        return signal.filtered(leak=self.eps * np.outer(colors, left))


@lru_cache(maxsize=32)
def _table(path: str, changed_ns: int) -> tuple[Spectrum, ...]:
    spectra = read_spectra(path)
    if len(spectra) == 1:
        return tuple(spectra.values())
    if set(spectra) != set(CHANNELS):
        raise InputError(f"{path}: columns are {', '.join(spectra)}; quantum efficiency needs R, G, B (or one column for MONO)")
    return tuple(spectra[channel] for channel in CHANNELS)


def _known_to(context: Context, channels: int) -> Float:
    """Factors (channels, 1, 1) by which a laboratory does not know the quantum efficiency in the light of this shot."""
    names = ("qe_red", "qe_green", "qe_blue") if channels == 3 else ("qe_green",)
    return np.array([1 + context.get(name) for name in names])[:, None, None]


def _trapezoid(grid: Float) -> Float:
    """Integration weights (bands,) in nm; one band alone counts 1 nm."""
    if grid.size == 1:
        return np.ones(1)
    gaps = np.diff(grid)
    return np.asarray(np.concatenate([gaps, [0]]) / 2 + np.concatenate([[0], gaps]) / 2)


@dataclass(frozen=True, kw_only=True)
class QuantumEfficiency(Effect):
    """Light becomes electrons: pixel area, exposure time, photon energy and QE of each channel.

    Samples the signal: blur must stand before it.  ``file`` is a CSV table wavelength_nm, R, G, B (one
    column for a monochrome sensor), held at its ends from 380 to 740 nm and no farther.  Touches every level.
    """

    name = "quantum_efficiency"
    stage = "pixel"
    acts_on = "irradiance"
    gives = "electron"
    order = 40.0
    absent = "nothing: every model has it"
    imitated_by = (
        "channel_gain",
        "spd_mismatch",
    )
    candidate = False
    equation = "mu_c = scale sum_lambda E QE_c (lambda / h c) A t dlambda"
    reference = "EMVA Standard 1288 Release 4.0, eq. 1-3; trapezoid rule over the bands"
    must_not_change = ("dark",)

    file: str = table_file("CSV of quantum efficiency: wavelength_nm, R, G, B (or one column for MONO), electrons per photon")
    scale: float = parameter(1.0, unit="1", low=0.0, high=10.0, doc="factor on all curves")

    def curves(self, context: Context, wavelength_nm: Float) -> Float:
        """Quantum efficiency (channels, bands).

        Raises
        ------
        InputError
            If no file is named, or its columns do not fit the sensor's colours.
        """
        table = self.table()
        wanted = 1 if context.sensor.cfa == "MONO" else 3
        if len(table) != wanted:
            path = resolve_path(self.file, Path(self.base))
            raise InputError(f"{path}: {len(table)} quantum efficiency columns; a {context.sensor.cfa} sensor needs {wanted}")
        return self.scale * np.array([spectrum.at(wavelength_nm) for spectrum in table])

    def table(self) -> tuple[Spectrum, ...]:
        """The curves as the file has them: red, green and blue, or one.

        Raises
        ------
        InputError
            If no file is named, or it is none of curves.
        """
        if not self.file:
            raise InputError('effect quantum_efficiency: file is empty; name a CSV table, for example file = "qe.csv"')
        path = resolve_path(self.file, Path(self.base))
        stamp = path.stat().st_mtime_ns if path.is_file() else 0
        return _table(str(path), stamp)

    def _moved_apart(self, context: Context, wavelength_nm: Float, apart_nm: Sequence[Float | float]) -> Float:
        """The same, each channel's curve moved by its own part of ``apart_nm`` (red, green, blue; monochrome: green)."""
        if not any(np.any(d) for d in apart_nm):
            return self.curves(context, wavelength_nm)
        own = apart_nm[1:2] if context.sensor.cfa == "MONO" else apart_nm
        return np.array([self.curves(context, wavelength_nm - d)[c] for c, d in enumerate(own)])

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Electrons (channels, rows, cols)."""
        grid = signal.wavelength_nm
        if grid is None:
            raise InputError("effect quantum_efficiency: the light carries no wavelengths; give the signal wavelength_nm")
        area_m2 = (context.sensor.pixel_um * 1e-6) ** 2
        photons = grid * 1e-9 / (PLANCK_J_S * LIGHT_M_PER_S) * area_m2 * context.time_s() * _trapezoid(grid)
        leak = signal.filters.leak
        shift, apart = signal.filters.shift_nm, signal.filters.apart_nm
        nodes = np.zeros(1) if shift is None else np.unique(np.floor(shift))
        total: Any = 0.0
        for node in np.union1d(nodes, nodes + 1) if shift is not None else nodes:
            weight = 1.0 if shift is None else np.maximum(0.0, 1 - np.abs(shift - node))
            moved = grid * (1 - node / SHIFT_STATED_AT_NM)
            total = total + weight * signal.mixed((self._moved_apart(context, moved, apart) + leak) * photons)
        return signal.with_values(np.asarray(total) * _known_to(context, len(total)), "electron")


@dataclass(frozen=True, kw_only=True)
class ChannelGain(Effect):
    """Efficiency of red and blue relative to green: a factor per channel, the same under all lights.

    A factor on the electrons, in front of shot noise (a gain in DN is conversion_gain).
    """

    name = "channel_gain"
    stage = "pixel"
    acts_on = "electron"
    gives = "electron"
    order = 55.0
    absent = "levels given relative to each channel"
    imitated_by = (
        "spectral_crosstalk",
        "spd_mismatch",
        "conversion_gain",
    )
    equation = "mu_R x (1 + d_R), mu_B x (1 + d_B)"
    reference = "Lyu et al., Accurate smartphone camera simulation using 3D scenes, sec. sensor QE (diagonal of M)"
    must_not_change = ("dark", "edge")

    d_red: float = parameter(0.0, unit="1", low=-0.9, high=5.0, tau=0.05, doc="relative change of red")
    d_blue: float = parameter(0.0, unit="1", low=-0.9, high=5.0, tau=0.05, doc="relative change of blue")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Scale red and blue (nothing to do for MONO)."""
        if context.sensor.cfa == "MONO" or not (self.d_red or self.d_blue):
            return signal
        return signal.scaled(np.array([1 + self.d_red, 1.0, 1 + self.d_blue])[:, None, None])


@dataclass(frozen=True, kw_only=True)
class ColorFilterArray(Effect):
    """Each pixel keeps the electrons of its own colour: three channels become one mosaic."""

    name = "cfa"
    stage = "pixel"
    acts_on = "electron"
    gives = "electron"
    makes_mosaic = True
    order = 90.0
    absent = "monochrome sensors"
    imitated_by = ("channel_gain",)
    candidate = False
    equation = "mu(row, col) = mu_c(row, col), c the colour of the pixel"
    reference = "Bayer, US patent 3971065 (1976)"

    def apply(self, signal: Signal, context: Context) -> Signal:
        """The mosaic (1, rows, cols)."""
        values = signal.values
        rows, cols = context.window[2:]
        if context.sensor.cfa == "MONO":
            return signal.with_values(np.broadcast_to(values, (1, rows, cols)).copy())
        channel = context.channel_index()[None]
        full = np.broadcast_to(values, (3, rows, cols))
        return signal.with_values(np.where(channel == 0, full[0], np.where(channel == 1, full[1], full[2])))
