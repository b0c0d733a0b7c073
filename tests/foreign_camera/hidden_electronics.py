"""Hidden effects in the charge and behind it."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

from .effects import CONSTANTS, at
from .patterns import fixed_normals, fixed_stream

CONSTANTS["conversion_gain"] = {"gain_dn_per_e": "gain"}
BUNCHES = 12


@at("mean_charge", "prnu")
def prnu(charge, camera, place, rng, *, extra):
    """A second, independent gain pattern (fraction)."""
    return charge * (1 + extra * fixed_normals(camera.specimen, 11, place.window))


@at("mean_charge", "dark_current")
def dark_current(charge, camera, place, rng, *, extra_e_per_s):
    """A warmer sensor."""
    return charge + extra_e_per_s * place.time_s


@at("mean_charge", "hot_pixels")
def hot_pixels(charge, camera, place, rng, *, fraction, mean_e_per_s):
    """Single defects with an exponential spread of rates, always the same pixels."""
    hot = fixed_normals(camera.specimen, 12, place.window) > NormalDist().inv_cdf(1 - fraction)
    # half the sum of two squared normals is exponential with mean 1
    one, other = (fixed_normals(camera.specimen, kind, place.window) for kind in (13, 14))
    return charge + hot * mean_e_per_s * place.time_s * (one**2 + other**2) / 2


@at("collect", "brighter_fatter")
def brighter_fatter(charge, camera, place, rng, *, a_per_e):
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
def dsnu(charge, camera, place, rng, *, extra_e):
    """A second, independent offset pattern."""
    return charge + extra_e * fixed_normals(camera.specimen, 15, place.window)


@at("voltage", "read_noise")
def read_noise(charge, camera, place, rng, *, extra_e):
    """A noisier source follower beside the reset noise."""
    return charge + extra_e * rng.standard_normal(charge.shape)


@at("voltage", "nonlinearity")
def nonlinearity(charge, camera, place, rng, *, a):
    """A source follower whose gain falls with the swing: x / (1 + a x / full well)."""
    return charge / (1 + a * charge / camera.well_e)


@at("signal", "temporal_row_noise")
def temporal_row_noise(signal, camera, place, rng, *, sigma_dn):
    """The reference is sampled once per row."""
    return signal + sigma_dn * rng.standard_normal((signal.shape[0], 1))


@at("signal", "column_fpn")
def column_fpn(signal, camera, place, rng, *, sigma_dn):
    """Column converters with offsets of their own."""
    col0, cols = place.window[1], place.window[3]
    offsets = fixed_stream(camera.specimen, 16).standard_normal(col0 + cols)
    return signal + sigma_dn * offsets[None, col0:]


@at("signal", "black_level")
def black_level(signal, camera, place, rng, *, offset_dn):
    """A pedestal that is not the stated one."""
    return signal + offset_dn
