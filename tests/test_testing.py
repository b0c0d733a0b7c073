"""The batteries for users must refuse what they are there to refuse."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from isetval.core.effect import Effect, parameter
from isetval.core.errors import InputError
from isetval.testing import check_effect, check_measurement


@dataclass(frozen=True, kw_only=True)
class Offset(Effect):
    """An offset of the codes: a good effect."""

    name = "my_offset"
    stage = "electronics"
    acts_on = "dn"
    gives = "dn"
    equation = "DN + b"
    reference = "a note"

    b: float = parameter(0.0, unit="DN", low=-10, high=10, tau=1.0, doc="offset")

    def apply(self, signal, context):
        return signal.with_values(signal.values + self.b) if self.b else signal


def variant(**members):
    """The good effect with one thing changed."""
    made = dataclass(frozen=True, kw_only=True)(type("Variant", (Offset,), {"__doc__": "A bad effect.", **members}))
    return made()


def test_a_good_effect_passes():
    check_effect(Offset())
    check_effect(Offset(b=-3.0))


def _writes(self, signal, context):
    signal.layers[0].amplitude[...] += self.b
    return signal


def _draws_globally(self, signal, context):
    return signal.with_values(signal.values + self.b * np.random.standard_normal())  # noqa: NPY002


def _frame_noise(self, signal, context):
    noise = context.rng("frame").standard_normal(context.window[2:], dtype=np.float32)
    return signal.with_values(signal.values + (self.b * noise).astype(signal.values.dtype)) if self.b else signal


def _pattern_by_array(self, signal, context):
    rows, cols = context.window[2:]
    pattern = np.linspace(0, 1, rows * cols).reshape(rows, cols).astype(signal.values.dtype)
    return signal.with_values(signal.values + self.b * pattern)


@pytest.mark.parametrize(
    ("members", "complaint"),
    [
        ({"equation": ""}, "an equation and a reference"),
        ({"stage": "sky"}, "stage is 'sky'"),
        ({"acts_on": "volt"}, "units are"),
        ({"name": ""}, "name is ''"),
        ({"gives": "electron"}, "gives dn, declares electron"),
        ({"apply": lambda self, signal, context: signal}, "changes nothing"),
        ({"apply": lambda self, signal, context: signal.with_values(signal.values + self.b + 1)}, "not the identity"),
        ({"apply": _writes}, "writes into the signal"),
        ({"apply": lambda self, s, context: s.with_values(s.values + np.float64(self.b))}, "single precision becomes"),
        ({"apply": _draws_globally}, "the same seed gives other bits"),
        ({"apply": _frame_noise}, "another frame seed changes it"),
        ({"apply": _frame_noise, "random": "sensor"}, "another frame seed changes it"),
        ({"apply": _frame_noise, "random": "frame"}, "expectation depends on the frame"),
        ({"random": "frame"}, "another frame seed changes it: False"),
        ({"random": "sensor"}, "another sensor has the same pattern"),
        ({"apply": _pattern_by_array}, "a crop differs"),
        ({"b": parameter(0.0, unit="", doc="offset", tau=1.0)}, "needs a unit"),
        ({"__post_init__": lambda self: None}, "is not refused by name"),
    ],
)
def test_a_bad_effect_is_refused(members, complaint):
    if "b" in members:
        members = members | {"__annotations__": {"b": float}}
    with pytest.raises(AssertionError, match=complaint):
        check_effect(variant(**members))


@dataclass(frozen=True, kw_only=True)
class Cloud(Effect):
    """A scene effect that writes into the scene it is given."""

    name = "cloud"
    stage = "scene"
    equation = "L (1 - a)"
    reference = "a note"
    seen: list = field(default_factory=list, compare=False)

    a: float = parameter(0.0, unit="1", tau=0.1, low=0, high=1, doc="loss")

    def apply_scene(self, scene, context):
        scene.white[...] *= 1 - self.a
        return scene


def test_a_scene_effect_that_writes_is_refused():
    with pytest.raises(AssertionError, match=r"writes into the scene|not the same twice"):
        check_effect(Cloud())


def sample(seed):
    return 3.0 + 2.0 * np.random.default_rng(seed).standard_normal(50)


def mean_of(values, bias=0.0, factor=1.0):
    return values.mean() + bias, factor * values.std(ddof=1) / np.sqrt(values.size)


def test_an_honest_measurement_passes_and_reports_its_pulls():
    pulls = check_measurement(mean_of, 3.0, make=sample, trials=60)
    assert pulls.trials == 60
    assert abs(pulls.mean) < 3.3 / np.sqrt(60)
    assert 0.6 < pulls.width < 1.5


@pytest.mark.parametrize(
    ("bias", "factor", "complaint"), [(0.3, 1, "biased"), (0, 0.5, "sigma is wrong"), (0, 2.0, "sigma is wrong")]
)
def test_a_dishonest_measurement_is_refused(bias, factor, complaint):
    with pytest.raises(AssertionError, match=complaint):
        check_measurement(lambda values: mean_of(values, bias, factor), 3.0, make=sample, trials=60)


def test_a_measurement_without_sigma_or_with_too_few_seeds_is_refused():
    with pytest.raises(AssertionError, match="sigma is 0"):
        check_measurement(lambda values: (values.mean(), 0.0), 3.0, make=sample)
    with pytest.raises(InputError, match="at least 8"):
        check_measurement(mean_of, 3.0, make=sample, trials=3)
