"""A number of the camera far beyond the tolerance that the laboratory states of it: the effect, not the tolerance, has it."""

import numpy as np
import pytest

from isetval import simulate
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure
from isetval.loop.candidates import candidates_for
from isetval.loop.detective import diagnose
from isetval.loop.prediction import Point
from isetval.loop.prepared import prepare
from isetval.loop.signatures import as_tolerances_do, signatures

OFFSET_DN, TOLERANCE_DN = 0.6, 0.02


@pytest.fixture(scope="module")
def captures(model):
    times = {"dark": (0.001, 0.1, 1.0), "flat": (0.005, 0.01, 0.02)}
    shots = tuple(
        Shot(
            f"{session} {role} {t}", role, f"{session} {role}", exposure=Exposure(t), frames=4, window=(200, 300, 96, 96),
            light="sphere" if role == "flat" else None, measurement_session=session,
        )
        for session in "AB"
        for role, own in times.items()
        for t in own
    )  # fmt: skip
    black = Nuisance("black_level.offset_dn", TOLERANCE_DN, "DN", "measurement session")
    level = Nuisance("light_level", 0.01, "relative", "set-up", roles=("flat",))
    light = {"sphere": Light("sphere", Spectrum.flat(0.004))}
    plan = Campaign("tight", shots, lights=light, nuisances=(black, level), sensor=model.sensor)
    return simulate(model.with_values({"black_level.offset_dn": OFFSET_DN}), plan, 3)


def test_it_is_named(model, captures):
    """Of a file that added an offset to every code only a pull was told."""
    found = diagnose(model, captures, with_next_captures=False)
    assert (found.verdict, [e.name for e in found.effects]) == ("attributed", ["black_level"])
    value = found.effects[0].parameters["offset_dn"]
    assert abs(value.value - OFFSET_DN) < 3 * value.sigma < 0.2


def test_its_signature_is_what_the_tolerance_does(model, captures):
    with prepare(model, captures.session("A")) as ready:
        problem, fitted = ready.settled(model)
        wanted = [c for c in candidates_for(model) if c.name in ("black_level", "read_noise")]
        made = signatures(problem, Point(model), wanted, project=np.zeros((problem.keep.size, 0)))
        black, noise = (as_tolerances_do(problem, s, fitted.free) for s in made)
        (label,) = (f.label for f in fitted.free if f.owner == "black_level")
        np.testing.assert_array_equal(black.columns[:, 0], problem.columns[label].slope)
        np.testing.assert_array_equal(noise.columns, made[1].columns)
