"""Linearisation of rendered images: from code values back to exposure, before an edge is measured."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.measure.edge.samples import Samples

Float = NDArray[np.floating[Any]]
Oecf = float | str | ArrayLike | None

POINTS = 4096


def oecf_table(oecf: Oecf, *, full_dn: float) -> tuple[Float, Float] | None:
    """Code values above black and their exposures; None without an OECF.

    Parameters
    ----------
    oecf : "srgb", number, pairs (n, 2) or None
        The curve of IEC 61966-2-1; the exponent g of code ~ exposure^(1/g); or pairs (code above black,
        exposure in any unit), both rising, used with straight lines between them.
    full_dn : float
        White level above black; the exposures are scaled so that they end there.

    Raises
    ------
    InputError
        For anything else.
    """
    if oecf is None:
        return None
    share = np.linspace(0.0, 1.0, POINTS)
    if isinstance(oecf, str):
        if oecf != "srgb":
            raise InputError(f"oecf is {oecf!r}; it needs 'srgb', an exponent or pairs (code above black, exposure)")
        return full_dn * share, full_dn * np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    pairs = np.asarray(oecf, dtype=float)
    if pairs.ndim == 0:
        if not 0.1 <= pairs <= 10:
            raise InputError(f"oecf is an exponent of {pairs:g}; it needs 0.1 to 10")
        return full_dn * share, full_dn * share ** float(pairs)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or len(pairs) < 2 or not np.all(np.diff(pairs, axis=0) > 0):
        raise InputError(f"oecf has shape {pairs.shape}; it needs at least two pairs (code above black, exposure), both rising")
    code, exposure = pairs.T
    return code, (exposure - exposure[0]) * (full_dn / (exposure[-1] - exposure[0]))


def linearised(samples: Samples, capture: Capture, oecf: Oecf) -> Samples:
    """Samples with their values turned into exposures, in units in which the table's end is the white level."""
    full = capture.sensor.white_dn - float(np.mean(capture.sensor.black_dn))
    table = oecf_table(oecf, full_dn=full)
    return samples if table is None else replace(samples, values=np.interp(samples.values, *table))
