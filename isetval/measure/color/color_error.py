"""Colour error of a chart: CIEDE2000 against published colours, with one gain a channel and with a fitted 3 x 3 matrix."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError, MeasurementError
from isetval.core.shown import Drawn

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]
# XYZ under D50 of the primaries of linear sRGB: IEC 61966-2-1, adapted from D65 by the Bradford matrix (ICC.1:2010, annex E)
SRGB_PRIMARIES = np.array(
    [[0.4360747, 0.3850649, 0.1430804], [0.2225045, 0.7168786, 0.0606169], [0.0139322, 0.0971045, 0.7141733]]
)
LEAST_PATCHES = 6  # nine numbers from three values a patch, and as many to spare
LEAST_STRENGTH = 1e-6  # of the third colour, relative to the first: below, it is rounding
DRAWS = 100  # sigma of a mean error from 100 draws is itself known to 7 %
LIGHTNESS_POWER = -2 / 3  # L* rises as Y^(1/3): equal steps of L* are steps of Y^(2/3)


@dataclass(frozen=True, eq=False, repr=False)
class ColorError(Drawn):
    """CIEDE2000 of a chart's patches; patches that are clipped are NaN and not fitted.

    Parameters
    ----------
    gains_only, fitted : (patches,)
        Error with one gain a channel (the sensor's R, G, B taken for those of linear sRGB), and with the 3 x 3 matrix.
    mean_gains_only, mean_fitted, sigma_gains_only, sigma_fitted : float
        Means over the patches and their standard deviation from the patches' noise.
    noise : float
        Mean error with the fitted matrix that the patches' noise alone would give a perfect camera.
    gains : (3,)
        R, G, B times these are linear sRGB.
    matrix : (3, 3)
        Row vectors: (R, G, B) @ matrix is XYZ under D50, white Y = 1.
    """

    names: tuple[str, ...]
    gains_only: Float
    fitted: Float
    mean_gains_only: float
    sigma_gains_only: float
    mean_fitted: float
    sigma_fitted: float
    noise: float
    gains: Float
    matrix: Float

    def headline(self) -> str:
        """Mean errors and the worst patch."""
        worst = int(np.nanargmax(self.fitted))
        return (
            f"dE2000 mean {self.mean_gains_only:.2f} +- {self.sigma_gains_only:.2f} with gains only, "
            f"{self.mean_fitted:.2f} +- {self.sigma_fitted:.2f} with a fitted 3 x 3 (noise alone {self.noise:.2f}), "
            f"worst {self.fitted[worst]:.2f}: {self.names[worst]}"
        )

    def to_frame(self) -> pd.DataFrame:
        """One row a patch and kind of correction: name, patch, value, unit; the means with their sigma."""
        import pandas as pd

        kinds = (
            ("de2000_gains_only", self.gains_only, self.mean_gains_only, self.sigma_gains_only),
            ("de2000_fitted", self.fitted, self.mean_fitted, self.sigma_fitted),
        )
        rows = [(name, "mean", mean, sigma, "1") for name, _, mean, sigma in kinds]
        rows += [
            (n, patch, float(v), np.nan, "1") for n, values, *_ in kinds for patch, v in zip(self.names, values, strict=True)
        ]
        return pd.DataFrame(rows, columns=["name", "patch", "value", "sigma", "unit"])


def color_error(rgb: Float, sigma: Float, lab: Float, *, usable: Bool, names: tuple[str, ...], seed: int = 0) -> ColorError:
    """CIEDE2000 of patches against their published colours.

    Parameters
    ----------
    rgb, sigma : (patches, 3)
        R, G, B above black and their standard deviation.
    lab : (patches, 3)
        CIE L*, a*, b* under D50, 2 degree observer.
    usable : (patches,) bool
    names : tuple of str
    seed : int
        Of the draws of noise.

    Raises
    ------
    InputError
        For shapes that do not fit.
    MeasurementError
        For too few usable patches, or colours that do not determine a matrix.

    Notes
    -----
    Gains and matrix are least squares on linear sRGB and on XYZ, both weighted by Y^(-2/3), which makes steps of
    lightness count alike.  The light of the picture is absorbed in them as far as three gains or a matrix can; what is
    left holds the camera's filters (Luther condition), the light's difference from D50, flare and uneven light.
    CIEDE2000: ISO/CIE 11664-6, as in scikit-image.
    """
    if rgb.shape != lab.shape or rgb.shape != sigma.shape or rgb.ndim != 2 or rgb.shape[1] != 3:
        raise InputError(f"responses {rgb.shape}, sigma {sigma.shape} and lab {lab.shape} need one shape, (patches, 3)")
    good = usable & np.all(np.isfinite(rgb), axis=1)
    if good.sum() < LEAST_PATCHES:
        raise MeasurementError(f"{int(good.sum())} patches are unclipped; a colour error needs at least {LEAST_PATCHES}")
    measured, noise, wanted = rgb[good], sigma[good], lab[good]
    _check_rank(measured)
    gains, matrix = _fits(measured, wanted)
    found = _errors(measured, wanted, gains, matrix)
    draws = np.random.default_rng(seed).standard_normal((DRAWS, *measured.shape)) * noise
    perfect = _xyz(wanted) @ np.linalg.inv(matrix)
    noisy, floor = (_errors(base + draws, wanted, *_fits(base + draws, wanted)).mean(axis=-1) for base in (measured, perfect))
    spread = noisy.std(axis=1, ddof=1)
    table = np.full((2, len(rgb)), np.nan)
    table[:, good] = found
    return ColorError(
        names=names,
        gains_only=table[0],
        fitted=table[1],
        mean_gains_only=float(np.mean(found[0])),
        sigma_gains_only=float(spread[0]),
        mean_fitted=float(np.mean(found[1])),
        sigma_fitted=float(spread[1]),
        noise=float(floor[1].mean()),
        gains=gains,
        matrix=matrix,
    )


def _xyz(lab: Float) -> Float:
    from skimage.color import lab2xyz

    return np.asarray(lab2xyz(lab, illuminant="D50"))


def _check_rank(rgb: Float) -> None:
    strength = np.linalg.svd(rgb, compute_uv=False)
    if strength[-1] < LEAST_STRENGTH * strength[0]:
        raise MeasurementError("the patches' responses lie in a plane; a 3 x 3 matrix needs patches of three colours")


def _fits(rgb: Float, lab: Float) -> tuple[Float, Float]:
    """Gains to linear sRGB, (..., 3), and matrix to XYZ, (..., 3, 3), of responses (..., patches, 3)."""
    xyz = _xyz(lab)
    weight = xyz[:, [1]] ** LIGHTNESS_POWER
    linear = xyz @ np.linalg.inv(SRGB_PRIMARIES).T
    gains = (weight**2 * rgb * linear).sum(axis=-2) / (weight**2 * rgb**2).sum(axis=-2)
    weighted = np.swapaxes(rgb * weight, -1, -2)
    matrix = np.linalg.solve(weighted @ (rgb * weight), weighted @ (xyz * weight))
    return np.asarray(gains), np.asarray(matrix)


def _errors(rgb: Float, lab: Float, gains: Float, matrix: Float) -> Float:
    """CIEDE2000 with gains and with the matrix, (2, ..., patches), of responses (..., patches, 3)."""
    from skimage.color import deltaE_ciede2000, xyz2lab

    pictures = np.stack([rgb * gains[..., None, :] @ SRGB_PRIMARIES.T, rgb @ matrix])
    return np.asarray(deltaE_ciede2000(np.broadcast_to(lab, pictures.shape), xyz2lab(pictures, illuminant="D50")))
