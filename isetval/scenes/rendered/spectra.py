"""Spectra as scene dictionaries hold them, and the bands that a render is made in."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.errors import InputError
from isetval.core.scene import Spectrum

Float = NDArray[np.float64]
SHORTEST_NM, LONGEST_NM = 360.0, 830.0


def scaled(spectrum: Spectrum, factor: float) -> Spectrum:
    """The spectrum times a number."""
    return Spectrum(spectrum.wavelength_nm, factor * spectrum.values)


def raised(spectrum: Spectrum, offset: float) -> Spectrum:
    """The spectrum plus a number."""
    return spectrum if offset == 0 else Spectrum(spectrum.wavelength_nm, spectrum.values + offset)


def reflectance_dict(name: str, spectrum: Spectrum) -> dict[str, Any]:
    """A reflectance as plain lists.

    Raises
    ------
    InputError
        For a value outside 0 to 1, with its wavelength.
    """
    bad = np.flatnonzero((spectrum.values < 0) | (spectrum.values > 1))
    if bad.size:
        where = f"{spectrum.values[bad[0]]:.6g} at {spectrum.wavelength_nm[bad[0]]:g} nm"
        raise InputError(f"the reflectance {name!r} is {where}; a surface reflects between 0 and 1 of the light")
    return _plain(spectrum)


def radiance_dict(name: str, spectrum: Spectrum) -> dict[str, Any]:
    """A radiance in W/(sr m2 nm) as plain lists.

    Raises
    ------
    InputError
        For a negative value, with its wavelength.
    """
    bad = np.flatnonzero(spectrum.values < 0)
    if bad.size:
        where = f"{spectrum.values[bad[0]]:.6g} at {spectrum.wavelength_nm[bad[0]]:g} nm"
        raise InputError(f"the radiance {name!r} is {where}; it needs values of 0 or more in W/(sr m2 nm)")
    return _plain(spectrum)


def _plain(spectrum: Spectrum) -> dict[str, Any]:
    return {"wavelength_nm": spectrum.wavelength_nm.tolist(), "values": spectrum.values.tolist()}


def band_feet_nm(wavelength_nm: ArrayLike) -> tuple[Float, Float]:
    """Feet of the triangular bands around the given centers, (bands,) each.

    A band reaches to its neighbors' centers; the outer ones end at their own center.  These are the hat
    functions of linear interpolation (`isetval.core.scene.Spectrum.band_means` uses the same), so a sum
    over bands of radiance x efficiency x trapezoid weight is exact for an efficiency that is linear between
    the centers.

    Raises
    ------
    InputError
        For fewer than two bands, bands that do not rise or that leave 360 to 830 nm.
    """
    center = np.asarray(wavelength_nm, float)
    if center.ndim != 1 or len(center) < 2 or not np.all(np.diff(center) > 0):
        raise InputError(f"wavelength_nm is {center.tolist()}; it needs two or more band centers in rising order")
    if center[0] < SHORTEST_NM or center[-1] > LONGEST_NM:
        raise InputError(f"the bands reach from {center[0]:g} to {center[-1]:g} nm; they must stay within 360 to 830 nm")
    return np.concatenate([center[:1], center[:-1]]), np.concatenate([center[1:], center[-1:]])


def band_weights_nm(wavelength_nm: ArrayLike) -> Float:
    """Trapezoid weights of the bands in nm, (bands,)."""
    low, high = band_feet_nm(wavelength_nm)
    return np.asarray((high - low) / 2)
