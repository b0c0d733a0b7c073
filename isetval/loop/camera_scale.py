"""For which camera the catalogue states charges, numbers and widths of priors, and how much larger they are in another."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from isetval.camera.model import CameraModel
from isetval.core.campaign import Campaign
from isetval.core.effect import Effect, ParameterInfo

UNLIMITED_E = 1e9  # a full well that is none (`isetval.effects.electrons.FullWell`)
FULL_WELL_E, GAIN_DN_PER_E, PIXEL_UM, F_NUMBER, LIGHT = 6000.0, 0.1707, 1.4, 1.73, 1e-3
"""Of the camera for which the catalogue states charges, numbers and their priors, and of its light, W/(sr m2 nm)."""
VISIBLE_NM = np.arange(400.0, 701.0, 10.0)
RATE_E_PER_S = 1.0  # the catalogue's width of a dark current: a camera's own, where it is more, may be wrong by as much as itself


@dataclass(frozen=True)
class Scale:
    """A camera's lens, and how much larger its charges, digital numbers and light are than those the catalogue is stated for.

    A response that loses 2 % at full well, a knee at a third of it, rows that scatter by an electron: of a sensor of 60,000 e-
    these are other numbers than of one of 6,000.  What darkness collects grows with the area of a pixel, and with
    how warm the sensor is: by the width that a phone's glow has, one that a large pixel shows clearly was not observable.
    Light of the room is a part of what laboratories work with, which differs by decades; errors of focus are met that blur by a
    pixel or so.
    """

    charge: float = 1.0
    dn: float = 1.0
    rate: float = 1.0
    light: float = 1.0
    focus: float = 1.0
    focal_mm: float = 0.0  # of its lens, as an effect of the model states it; 0: none does

    @classmethod
    def of(cls, model: CameraModel, brightest: float = LIGHT) -> Scale:
        """That of a model: its full well, or the charge at the converter's end, its conversion gain, the light that it sees."""
        gain = _stated(model, "conversion_gain.gain_dn_per_e", 0.0)
        stated = {effect.name: effect.values()["focal_mm"] for effect in model.effects if effect.values().get("focal_mm")}
        focal_mm = stated.get("cos4") or next(iter(stated.values()), 0.0)  # the first is the distance of the exit pupil
        pixel = model.sensor.pixel_um / PIXEL_UM
        f_number = max((e.values().get("f_number") or 0.0 for e in model.effects), default=0.0) or F_NUMBER
        beside_charge = cls(
            rate=max(pixel**2, _stated(model, "dark_current.rate_e_per_s", 0.0) / RATE_E_PER_S),
            light=brightest / LIGHT,
            focus=f_number / F_NUMBER * pixel,
            focal_mm=focal_mm,
        )
        if gain <= 0:
            return beside_charge
        well_e = _stated(model, "full_well.well_e", UNLIMITED_E)
        end_e = (model.sensor.white_dn - float(np.mean(model.sensor.black_dn))) / gain
        charge_e = well_e if well_e < UNLIMITED_E else end_e
        return replace(beside_charge, charge=charge_e / FULL_WELL_E, dn=gain / GAIN_DN_PER_E)

    def width(self, effect: Effect, info: ParameterInfo) -> ParameterInfo:
        """A parameter with the width of its prior in this camera."""
        by_unit = {"DN": self.dn, "DN/e-": self.dn, "1/e-": 1 / self.charge, "e-/s": self.rate, "e-/s/frame": self.rate}
        by_unit |= {"W/(sr m2 nm)": self.light, "um": self.focus if info.name in effect.of_focus_depth else 1.0}
        factor = self.charge if info.name in effect.of_full_well else by_unit.get(info.unit, 1.0)
        return info if info.tau is None or factor == 1 else replace(info, tau=info.tau * factor)

    def form(self, effect: Effect) -> Effect:
        """An absent effect with this camera's lens, and its shapes that are charges in proportion to this camera's full well."""
        shapes = [p.name for p in effect.parameters() if p.shape]
        known = {name: effect.values()[name] * self.charge for name in shapes if name in effect.of_full_well}
        known |= {"focal_mm": self.focal_mm} if self.focal_mm and "focal_mm" in shapes else {}
        return effect.changed(**known) if known else effect


def _stated(model: CameraModel, key: str, otherwise: float) -> float:
    """A parameter of a model, or what it is where the model has no such effect."""
    return model.value(key) if model.effect(key.partition(".")[0]) is not None else otherwise


def brightest_of(plan: Campaign) -> float:
    """Mean radiance from 400 to 700 nm of a plan's brightest light, W/(sr m2 nm); the catalogue's where it uses none."""
    used = dict.fromkeys(shot.light for shot in plan.shots if shot.light)
    means = [float(np.mean(plan.lights[name].radiance.at(VISIBLE_NM))) for name in used if name in plan.lights]
    return max(means, default=0.0) or LIGHT
