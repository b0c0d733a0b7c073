"""Light that a camera would see and that is not simulated: outside the wavelengths of its model."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign
from isetval.core.scene import Spectrum
from isetval.effects.color import QuantumEfficiency

Float = NDArray[np.float64]
TOLD = 1e-3  # share of a channel's electrons from which on it is told: a few error bars of a flat's mean
STEP_NM = 1.0


def light_outside(model: CameraModel, plan: Campaign) -> list[str]:
    """Remarks, one for each light of which more than `TOLD` of some channel's electrons lie outside the model's wavelengths.

    Tables count as far as they reach: what a light or an efficiency is beyond its table nobody has said.
    """
    efficiency = model.effect("quantum_efficiency")
    if not isinstance(efficiency, QuantumEfficiency) or not efficiency.file:
        return []
    low, high = float(model.wavelength_nm[0]), float(model.wavelength_nm[-1])
    out = []
    for name in dict.fromkeys(shot.light for shot in plan.shots if shot.light):
        shares = [_share_outside(plan.lights[name].radiance, curve, low, high) for curve in efficiency.table()]
        if max(shares) > TOLD:
            channel = ("R", "G", "B")[int(np.argmax(shares))] if len(shares) == 3 else "the sensor"
            out.append(
                f"light {name}: {100 * max(shares):.2g} % of what {channel} would see lies outside {low:g} to {high:g} nm, "
                "which is not simulated: cut the tables there as the camera's filters do, or expect that much less signal"
            )
    return out


def _share_outside(light: Spectrum, curve: Spectrum, low_nm: float, high_nm: float) -> float:
    """Share of the electrons outside a range of wavelengths, within both tables."""
    first = max(light.wavelength_nm[0], curve.wavelength_nm[0])
    last = min(light.wavelength_nm[-1], curve.wavelength_nm[-1])
    grid = np.arange(first, last + STEP_NM / 2, STEP_NM)
    if grid.size < 2:
        return 0.0
    electrons = light.at(grid) * curve.at(grid) * grid
    total = float(electrons.sum())
    return float(electrons[(grid < low_nm) | (grid > high_nm)].sum()) / total if total > 0 else 0.0
