"""Unknowns of a laboratory as objects: who shares a value, and the labels that results have carried from the start."""

import pytest

from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.errors import InputError
from isetval.core.parameter import Parameter
from isetval.core.scene import Spectrum
from isetval.core.sensor import Roi, Window

SHOTS = (
    Shot("a", "flat", setup="s", light="lamp"),
    Shot("b", "flat", setup="s", light="lamp"),
    Shot("c", "dark", setup="t", measurement_session="B"),
)


def labels(*nuisances):
    plan = Campaign("p", SHOTS, lights={"lamp": Light("lamp", Spectrum.flat(1.0))}, nuisances=nuisances)
    return [p.label for p in plan.unknowns()]


@pytest.mark.parametrize(
    ("nuisance", "expected"),
    [
        (Nuisance("light_level", 0.02, "relative", "campaign"), ["light_level@campaign:"]),
        (Nuisance("light_level", 0.02, "relative", "set-up"), ["light_level@set-up:s", "light_level@set-up:t"]),
        (
            Nuisance("focus_um", 1.0, "um", "measurement session"),
            ["focus_um@measurement session:A", "focus_um@measurement session:B"],
        ),
        (
            Nuisance("light_level", 0.02, "relative", "set-up", roles=("flat",), lights=("lamp",)),
            ["light_level@set-up:s[flat,lamp]"],
        ),
        (Nuisance("read_noise.sigma_e", 0.1, "e-", "campaign"), ["read_noise.sigma_e@campaign:"]),
        (Nuisance("light_level", 0.02, "relative", "frame"), []),
    ],
)
def test_shots_of_one_scope_share_one_value(nuisance, expected):
    assert labels(nuisance) == expected


@pytest.mark.parametrize("only", [{"roles": ("dark",)}, {"lights": ("lamp",)}, {"setups": ("s",)}])
def test_a_tolerance_that_names_some_shots_of_its_scope_is_refused(only):
    key = next(iter(only))
    with pytest.raises(InputError, match=rf"dark_current.rate_e_per_s: {key} is .* leave {key} out"):
        Nuisance("dark_current.rate_e_per_s", 0.1, "e-/s", "campaign", **only)


def test_a_tolerance_and_the_parameter_of_the_model_are_the_same_quantity():
    free = Parameter("sigma_e", "read_noise", prior=0.5)
    tolerance = Nuisance("read_noise.sigma_e", 0.1, "e-", "campaign").unknown()
    assert free.key == tolerance.key
    assert free.label != tolerance.label
    assert (free.is_nuisance, tolerance.is_nuisance) == (False, True)
    assert (free.weight, Parameter("x").weight) == (2.0, 0.0)


def test_bent_and_focus_are_said_where_the_nuisance_is_listed():
    shot = SHOTS[0]
    kinds = {n: Nuisance(n, 1.0, "", "set-up").unknown(shot) for n in ("focus_um", "edge_shift_px", "light_level")}
    assert [(p.curved, p.focus) for p in kinds.values()] == [(True, True), (True, False), (False, False)]


def test_windows_and_regions_are_tuples_with_names():
    window = Shot("a", "flat", window=(4, 6, 10, 20)).window
    assert window == (4, 6, 10, 20)
    assert (window.origin, window.shape, window.part(2, 3)) == ((4, 6), (10, 20), Window(6, 6, 3, 20))
    assert window.fits((14, 26))
    assert not window.fits((13, 26))
    assert Roi(2, 10, 3, 8).shrunk(1) == (3, 9, 4, 7)
    assert Roi.of([2, 10, 3, 8]).shape == (8, 5)
