"""An effect that is nearly absent does nearly nothing: from its null on it is a continuous function of each parameter."""

import numpy as np
import pytest

from isetval import load_model
from isetval.camera.exposing import expected_dn
from isetval.core.campaign import Light, Shot
from isetval.core.scene import ChartTarget, EdgeTarget, Patch, Spectrum
from isetval.core.sensor import Exposure
from isetval.core.toml import data_folder
from isetval.loop.candidates import candidates_for

NM = np.arange(380.0, 741.0)  # finer than the model's bands: a line of 3 nm meets a slope of 10 nm
LIGHT = Light("lines", Spectrum(NM, 0.004 * (0.1 + 5 * np.exp(-(((NM - 546) / 3) ** 2)) + 2 * np.exp(-(((NM - 408) / 3) ** 2)))))
STEEP = Spectrum(NM, 0.1 + 0.6 / (1 + np.exp(-(NM - 547) / 2)))
PATCHES = tuple(Patch(name, (8, 56, left, left + 24), STEEP) for name, left in (("a", 4), ("b", 36)))
TARGETS = {
    "dark": None,
    "flat": None,
    "edge": EdgeTarget("edge", orientation="vertical", dark_reflectance=Spectrum.flat(0.05), bright_reflectance=STEEP),
    "chart": ChartTarget("chart", PATCHES, surround=STEEP),
}
WHERE = {"exposure": Exposure(0.02), "window": (800, 900, 64, 64)}
SHOTS = tuple(Shot(r, r, r, target=target, light=None if r == "dark" else "lines", **WHERE) for r, target in TARGETS.items())
MODEL = load_model(data_folder() / "pixel4a" / "camera.toml")
EFFECTS = {c.klass: c for c in reversed(candidates_for(MODEL, ["lines"], [0.01]))}


def seen(model) -> list[np.ndarray]:
    return [expected_dn(model, shot, lights={LIGHT.name: LIGHT}) for shot in SHOTS]


@pytest.fixture(scope="module")
def without():
    return seen(MODEL)


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_a_millionth_of_an_effect_moves_no_pixel(name, without):
    candidate = EFFECTS[name]
    for parameter, nominal, tau in zip(candidate.parameters, candidate.nominal, candidate.tau, strict=True):
        step = 1e-6 * float(tau) * (1 if nominal + 1e-6 * tau <= parameter.high else -1)
        nearly = seen(MODEL.with_effect(candidate.effect.changed(**{parameter.name: float(nominal) + step})))
        for shot, there, here in zip(SHOTS, nearly, without, strict=True):
            assert np.abs(there - here).max() < 1e-3, f"{parameter.name}: {shot.role} in DN"
