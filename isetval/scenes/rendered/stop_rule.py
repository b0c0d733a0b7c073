"""How much render noise a sensor can bear: electrons for each unit of spectral radiance."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.errors import InputError
from isetval.scenes.rendered.accumulation import NoiseTarget
from isetval.scenes.rendered.spectra import band_weights_nm

Float = NDArray[np.float64]
PLANCK_J_S, LIGHT_M_S = 6.62607015e-34, 299792458.0  # exact, SI 2019


def electrons_per_radiance(
    wavelength_nm: ArrayLike, quantum_efficiency: ArrayLike, *, time_s: float, pixel_um: float, solid_angle_sr: float
) -> Float:
    """Photo-electrons of a pixel for unit spectral radiance in each band, (bands,).

    Parameters
    ----------
    wavelength_nm : (bands,)
        Centers of the bands.
    quantum_efficiency : (bands,)
        Electrons per photon.
    time_s, pixel_um : float
        Exposure time and pixel pitch.
    solid_angle_sr : float
        Irradiance per radiance, E/L: pi / (4 N^2) on the axis of a lens of f-number N.

    Notes
    -----
    t A (E/L) QE lambda / (h c) times the band's trapezoid weight.
    """
    wavelength = np.asarray(wavelength_nm, float)
    efficiency = np.asarray(quantum_efficiency, float)
    if efficiency.shape != wavelength.shape:
        raise InputError(f"quantum_efficiency has shape {efficiency.shape}; {len(wavelength)} bands need {wavelength.shape}")
    photons_per_joule = wavelength * 1e-9 / (PLANCK_J_S * LIGHT_M_S)
    area_m2 = (pixel_um * 1e-6) ** 2
    return np.asarray(time_s * area_m2 * solid_angle_sr * efficiency * photons_per_joule * band_weights_nm(wavelength))


def below_shot_noise(electrons: ArrayLike, *, fraction: float = 0.1, minimum_passes: int = 8) -> NoiseTarget:
    """Stop when the render's noise is below ``fraction`` of the shot noise over the region rendered.

    ``electrons`` is what :func:`electrons_per_radiance` gives for the channel that counts.
    """
    per_band = tuple(float(v) for v in np.asarray(electrons, float))
    return NoiseTarget(fraction_of_shot=fraction, electrons_per_radiance=per_band, minimum_passes=minimum_passes)
