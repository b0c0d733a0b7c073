"""Hidden effects in the charge: what the pixels collect and what the source follower makes of it."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

from . import optics
from .effects import CONSTANTS, at
from .patterns import fixed_normals
from .types import Camera, Float, Generator, Place

CONSTANTS["conversion_gain"] = {"gain_dn_per_e": "gain"}
CONSTANTS["full_well"] = {"well_e": "well_e"}
BUNCHES = 12


def _rare(camera: Camera, kind: int, place: Place, fraction: float) -> Float:
    """A fixed random fraction of the pixels (rows, cols) is 1, the rest 0."""
    return (fixed_normals(camera.specimen, kind, place.window) > NormalDist().inv_cdf(1 - fraction)).astype(float)


@at("mean_charge", "prnu")
def prnu(charge: Float, camera: Camera, place: Place, rng: Generator, *, extra: float) -> Float:
    """A second, independent gain pattern (fraction)."""
    return charge * (1 + extra * fixed_normals(camera.specimen, 11, place.window))


@at("mean_charge", "dark_current")
def dark_current(charge: Float, camera: Camera, place: Place, rng: Generator, *, extra_e_per_s: float) -> Float:
    """A warmer sensor."""
    return charge + extra_e_per_s * place.time_s


@at("mean_charge", "temperature_drift")
def temperature_drift(charge: Float, camera: Camera, place: Place, rng: Generator, *, rise_e_per_s: float) -> Float:
    """The camera warms up within a series: towards an end, by a factor 1/e in eight frames."""
    return charge + rise_e_per_s * 8 * (1 - np.exp(-place.frame / 8)) * place.time_s


@at("mean_charge", "amp_glow")
def amp_glow(charge: Float, camera: Camera, place: Place, rng: Generator, *, e_per_s: float) -> Float:
    """A glowing amplifier beside the lower right corner: inverse square of the distance from a point above the sensor."""
    x, y = (along / optics.corner_mm(camera) for along in optics.pixel_places(camera, place.window))
    return np.asarray(charge + e_per_s * place.time_s / (1 + ((x - 0.82) ** 2 + (y - 0.62) ** 2) / 0.25**2))


@at("mean_charge", "uneven_dark_current")
def uneven_dark_current(charge: Float, camera: Camera, place: Place, rng: Generator, *, sd_e_per_s: float) -> Float:
    """Rates spread as the sum of four squared normals, their mean kept: no rate is far below it, some are far above."""
    four = sum(fixed_normals(camera.specimen, kind, place.window) ** 2 for kind in (41, 42, 43, 44))
    return charge + sd_e_per_s * place.time_s * (four - 4) / 8**0.5


@at("mean_charge", "hot_pixels")
def hot_pixels(charge: Float, camera: Camera, place: Place, rng: Generator, *, fraction: float, mean_e_per_s: float) -> Float:
    """Single defects with an exponential spread of rates, always the same pixels."""
    # half the sum of two squared normals is exponential with mean 1
    one, other = (fixed_normals(camera.specimen, kind, place.window) for kind in (13, 14))
    return charge + _rare(camera, 12, place, fraction) * mean_e_per_s * place.time_s * (one**2 + other**2) / 2


@at("mean_charge", "lag")
def lag(charge: Float, camera: Camera, place: Place, rng: Generator, *, fraction: float) -> Float:
    """Of what a well held, no more than it holds, a part stays behind at the transfer gate and comes with the next frame."""
    return np.asarray(charge + fraction * np.minimum(place.before_e, camera.well_e))


@at("collect", "brighter_fatter")
def brighter_fatter(charge: Float, camera: Camera, place: Place, rng: Generator, *, a_per_e: float) -> Float:
    """Charge arrives in bunches; the border between two pixels has moved towards the emptier one.

    Between bunches the border shifts by k times the difference of the charges so far, and the fuller
    pixel loses that share of its next bunch: dQ_i = F_donor k (Q_j - Q_i).  Integrated over a flat this
    gives Var = mu (1 - 4 k mu) and Cov(nearest) = k mu^2, so k = A/4.
    """
    mean, total = charge / BUNCHES, np.zeros_like(charge)
    for _ in range(BUNCHES):
        # half of a bunch is there, on average, while it arrives
        flux = mean.copy()
        for axis in (0, 1):
            gap = np.diff(total + mean / 2, axis=axis)
            low, high = np.take(mean, range(mean.shape[axis] - 1), axis), np.take(mean, range(1, mean.shape[axis]), axis)
            moved = a_per_e / 4 * gap * np.where(gap > 0, high, low)
            index = [slice(None)] * 2
            index[axis] = slice(None, -1)
            flux[tuple(index)] += moved
            index[axis] = slice(1, None)
            flux[tuple(index)] -= moved
        total = total + rng.poisson(np.maximum(flux, 0))
    return total


@at("voltage", "dsnu")
def dsnu(charge: Float, camera: Camera, place: Place, rng: Generator, *, extra_e: float) -> Float:
    """A second, independent offset pattern."""
    return charge + extra_e * fixed_normals(camera.specimen, 15, place.window)


@at("voltage", "read_noise")
def read_noise(charge: Float, camera: Camera, place: Place, rng: Generator, *, extra_e: float) -> Float:
    """A noisier source follower beside the reset noise."""
    return charge + extra_e * rng.standard_normal(charge.shape)


@at("voltage", "rts")
def rts(charge: Float, camera: Camera, place: Place, rng: Generator, *, fraction: float, step_e: float) -> Float:
    """Single traps under some gates: these pixels read a step more in every other frame, at random."""
    return np.asarray(charge + _rare(camera, 17, place, fraction) * step_e * (rng.uniform(size=charge.shape) < 0.5))


@at("voltage", "nonlinearity")
def nonlinearity(charge: Float, camera: Camera, place: Place, rng: Generator, *, a: float) -> Float:
    """A source follower whose gain falls with the swing: x / (1 + a x / full well)."""
    return charge / (1 + a * charge / camera.well_e)


@at("voltage", "gain_knee")
def gain_knee(charge: Float, camera: Camera, place: Place, rng: Generator, *, slope: float, knee_e: float) -> Float:
    """A second, smaller gain takes over around the knee, softly within a twentieth of it."""
    width = knee_e / 20
    above = width * np.logaddexp(0, (charge - knee_e) / width)
    return np.asarray(charge + slope * above)


@at("voltage", "alternating_columns")
def alternating_columns(charge: Float, camera: Camera, place: Place, rng: Generator, *, share: float) -> Float:
    """Two rows of converters, above and below the sensor, each for every other column."""
    odd = (place.window[1] + np.arange(charge.shape[1])[None]) % 2
    return np.asarray(charge * np.where(odd == 1, 1 + share, 1 - share))


@at("voltage", "amplifier_crosstalk")
def amplifier_crosstalk(charge: Float, camera: Camera, place: Place, rng: Generator, *, share: float) -> Float:
    """One amplifier reads pixel after pixel and has not quite left the one before: a first-order lag along the row."""
    return np.concatenate([charge[:, :1], (1 - share) * charge[:, 1:] + share * charge[:, :-1]], axis=1)
