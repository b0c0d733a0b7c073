"""What the noise of a render does to the metrics: their covariance, from draws of the render's own error.

A render of n passes carries an error that every simulated frame shares, so that replicas of a campaign do not show it.
Its passes do: differences between halves of them are draws from its distribution, with the right covariance over pixels
and bands.  Each draw goes through the camera without noise and is measured by the same estimators; the products of the
differences are the covariance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from isetval.camera.chain import ShotSetup, make_context, mean_electrons, render_draws
from isetval.camera.exposing import expose
from isetval.camera.model import CameraModel
from isetval.core.capture import Capture
from isetval.core.scene import RenderedTarget

Float = NDArray[np.float64]
Measure = Callable[[Sequence[Capture]], Float]
RISE_DN = 8.0
"""DN of standard deviation to which the draws are raised, so that whole DN do not hide them; differences are lowered again."""


def render_covariance(model: CameraModel, setup: ShotSetup, measure: Measure) -> Float | None:
    """Covariance (metrics, metrics) that the render's noise gives to the metrics of a shot; None without a render.

    Parameters
    ----------
    model : CameraModel
    setup : ShotSetup
        A shot with its light and nuisances.
    measure : callable
        Captures of the shot in, its metrics (metrics,) out; nan where one cannot be measured.

    Returns
    -------
    (metrics, metrics) or None
        Mean product of the differences of `DRAWS` draws: as many degrees of freedom, so that a
        standard deviation is known to 35 %.  Rows that cannot be measured are zero.
    """
    if not isinstance(setup.shot.target, RenderedTarget):
        return None
    mean = mean_electrons(model, setup)
    draws = render_draws(model, setup) - mean
    size = float(np.sqrt(np.mean(draws**2)))
    if not size > 0:
        return None
    one_dn = _electrons_of_a_dn(model, setup, mean)
    rise = max(1.0, RISE_DN * one_dn / size)
    base = measure(expose(model, setup, mode="expected", mean=mean))
    out = np.zeros((base.size, base.size))
    for draw in draws:
        moved = measure(expose(model, setup, mode="expected", mean=np.maximum(mean + rise * draw, 0.0)))
        difference = np.nan_to_num((moved - base) / rise)
        out += np.outer(difference, difference) / len(draws)
    return out


def _electrons_of_a_dn(model: CameraModel, setup: ShotSetup, mean: Float) -> float:
    """Electrons that raise the mean code by one, at the level of the shot."""
    from isetval.camera.chain import electronics

    context = make_context(model, setup, mode="expected")
    step = max(1.0, 0.05 * float(mean.mean()))
    low, high = (float(np.mean(electronics(model, m, context))) for m in (mean, mean + step))
    return step / max(high - low, 1e-6)
