"""``isetval effects new NAME``: a file with an effect that works, and its test, to be changed into one's own."""

from __future__ import annotations

import keyword
from pathlib import Path

from isetval.core.errors import InputError
from isetval.core.writing import write_whole

UNIT_OF_STAGE = {"optics": "irradiance", "pixel": "electron", "exposure": "electron", "electronics": "electron", "file": "dn"}
EFFECT = '''"""{title}."""

from __future__ import annotations

from dataclasses import dataclass

from isetval.core.context import Context
from isetval.core.effect import Effect, parameter
from isetval.core.signal import Signal


@dataclass(frozen=True, kw_only=True)
class {cls}(Effect):
    """What it is, in a sentence; where it does not occur; what imitates it."""

    name = "{name}"
    stage = "{stage}"
    acts_on = "{unit}"
    gives = "{unit}"
    order = 50.0  # the place within the stage: isetval effects
    equation = "signal x (1 - a (r / r_corner)^2)"  # replace by yours
    reference = "where the equation comes from"
    must_not_change = ()  # some of dark, flat, edge, chart, illumination

    a: float = parameter(0.0, unit="1", low=0.0, high=1.0, tau=0.02, doc="loss a in the corner of the sensor")

    def apply(self, signal: Signal, context: Context) -> Signal:
        """The signal behind the effect; with a = 0 exactly the signal before it."""
        if not self.a:
            return signal
        x_mm, y_mm = context.xy_mm()
        share = (x_mm**2 + y_mm**2) / context.sensor.half_diagonal_mm**2
        return signal.with_values((signal.values * (1 - self.a * share)).astype(signal.values.dtype))
'''
TEST = '''"""{title}: the battery of all effects, and a closed form."""

import numpy as np
import pytest
from {module} import {cls}

from isetval.core.context import Context
from isetval.core.sensor import Exposure, Sensor, Window
from isetval.core.signal import Signal
from isetval.testing import check_effect

SENSOR = Sensor(rows=3000, cols=4000, pixel_um=2.0, cfa="MONO", black_dn=64, white_dn=4095, bits=12)


def test_battery():
    check_effect({cls}(a=0.05))


def test_middle_and_corner():
    effect = {cls}(a=0.05)
    found = []
    for row, col in ((1500, 2000), (2999, 3999)):
        context = Context(SENSOR, Window(row, col, 1, 1), Exposure(0.01))
        found.append(effect.apply(Signal.of(np.full((1, 1, 1), 100.0), "{unit}"), context).values.item())
    # nothing is lost in the middle, 5 % in the corner; a pixel's center lies half a pixel inside it
    assert found == pytest.approx([100.0, 95.0], abs=0.01)
'''


def scaffold(name: str, *, stage: str, folder: Path, write: bool = True) -> tuple[Path, Path]:
    """Write ``NAME.py`` and ``test_NAME.py``; the two paths.

    Raises
    ------
    InputError
        For a name that is no word or in use, a stage without a template, or a file that exists.
    """
    from isetval.effects import catalogue

    if not name.isidentifier() or keyword.iskeyword(name) or name != name.lower():
        raise InputError(f"{name!r} is no name of an effect; write small letters, digits and _, as warm_side")
    if name in catalogue():
        raise InputError(f"the effect {name!r} exists already (isetval effects {name}); choose another name")
    if stage not in UNIT_OF_STAGE:
        raise InputError(f"--stage is {stage!r}; it needs one of {', '.join(UNIT_OF_STAGE)}")
    if not folder.is_dir():
        raise InputError(f"{folder}: is no folder; make it, or name another with -o")
    words = {
        "name": name,
        "module": name,
        "cls": "".join(part.capitalize() for part in name.split("_")),
        "title": name.replace("_", " ").capitalize(),
        "stage": stage,
        "unit": UNIT_OF_STAGE[stage],
    }
    paths = folder / f"{name}.py", folder / f"test_{name}.py"
    for path in paths:
        if path.exists():
            raise InputError(f"{path}: exists already; nothing was written")
    for path, template in zip(paths, (EFFECT, TEST), strict=True):
        if write:
            write_whole(path, template.format(**words))
    return paths
