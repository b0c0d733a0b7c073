"""What all tests share: pytest's own tester, for the plugin's tests, and a plan that is shot in a second."""

from dataclasses import replace

import numpy as np
import pytest

from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure

pytest_plugins = ["pytester"]
WINDOW = (1464, 1968, 32, 32)


@pytest.fixture(scope="session")
def small_plan():
    """Two darks and two flats of three frames in the middle of a sensor; ``small_plan(sensor, **what is other)``."""

    def made(sensor, **more):
        light = Light("sphere", Spectrum(np.array([390.0, 550.0, 710.0]), np.array([0.0004, 0.001, 0.0008])))
        shots = [Shot(f"dark{i}", "dark", exposure=Exposure(t), frames=3, window=WINDOW) for i, t in enumerate((0.001, 0.5))]
        shots += [
            Shot(f"flat{i}", "flat", setup="series", exposure=Exposure(t), frames=3, window=WINDOW, light="sphere")
            for i, t in enumerate((0.004, 0.03))
        ]
        priors = (Nuisance("light_level", 0.02, "relative", "set-up", roles=("flat",)),)
        return replace(Campaign("small", tuple(shots), lights={"sphere": light}, nuisances=priors, sensor=sensor), **more)

    return made
