"""Places, light and charge that the effect tests share."""

from dataclasses import replace

import numpy as np
import pytest

from isetval.core.context import Context
from isetval.core.sensor import Exposure, Sensor
from isetval.core.signal import Signal
from isetval.effects.pupil import CircularPupil

SENSOR = Sensor(3024, 4032, pixel_um=1.4, black_dn=((64, 64), (64, 64)), white_dn=1023)


@pytest.fixture
def place():
    """place(effect=None, **changes) -> Context in the middle of a phone sensor."""

    def make(effect=None, **changes):
        context = Context(
            sensor=SENSOR, window=(1384, 1888, 256, 256), exposure=Exposure(time_s=0.1), shot="s", seed=11, sensor_seed=5
        )
        context = replace(context, **changes)
        return context if effect is None else context.for_effect(effect.name, 0)

    return make


@pytest.fixture
def light():
    """light(values (bands,), wavelength_nm) -> even irradiance behind a lens."""

    def make(values=(1.0,), wavelength_nm=(550.0,), shape=(256, 256)):
        even = np.asarray(values, float)[:, None, None]
        signal = Signal.of(even, "irradiance", shape=shape, wavelength_nm=np.asarray(wavelength_nm, float))
        return signal.through(CircularPupil(1.73, 1.4, 1.73))

    return make


@pytest.fixture
def charge():
    """charge(level, unit) -> even mosaic (1, 256, 256)."""

    def make(level, unit="electron", shape=(256, 256)):
        return Signal.of(np.full((1, *shape), float(level)), unit)

    return make
