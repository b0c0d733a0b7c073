"""What an effect says it leaves alone, it leaves alone: the whole nominal chain with and without it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isetval.camera.chain import ShotSetup, electronics, make_context, mean_electrons
from isetval.camera.model_file import load_model
from isetval.core.campaign import Light, Shot
from isetval.core.effect import UNTOUCHED
from isetval.core.scene import ChartTarget, EdgeTarget, Patch, Spectrum
from isetval.core.sensor import Exposure
from isetval.effects import catalogue

DATA = Path(__file__).parents[2] / "data" / "pixel4a"
LIGHT = Light("A", Spectrum(np.array([390.0, 710.0]), np.array([0.001, 0.004])))
CORNER = (2700, 3600, 64, 64)
MIDDLE = (1480, 1984, 64, 64)
GREY = ChartTarget("c", (Patch("grey", (16, 48, 16, 48), Spectrum.flat(0.2)),))
SHOTS = {
    "dark": Shot("dark", "dark", exposure=Exposure(time_s=1.0), window=CORNER),
    "flat": Shot("flat", "flat", exposure=Exposure(time_s=0.02), window=CORNER, light="A"),
    "chart": Shot("chart", "chart", exposure=Exposure(time_s=0.02), window=MIDDLE, light="A", target=GREY),
    "edge": Shot("edge", "edge", exposure=Exposure(time_s=0.02), window=CORNER, light="A", target=EdgeTarget("e"), focus_um=4.0),
}
LENS = "isetval:lens/default_lens.json"
CLAIMS = [(name, claim) for name, cls in catalogue().items() for claim in cls.must_not_change]
assert {claim for _, claim in CLAIMS} <= set(UNTOUCHED)


@pytest.fixture(scope="module")
def camera():
    model = load_model(DATA / "camera.toml")
    return model.replace(model.effect("quantization").changed(step_dn=0.0))


def dn(model, shot, mode):
    setup = ShotSetup(shot, LIGHT if shot.light else None)
    return electronics(model, mean_electrons(model, setup), make_context(model, setup, seed=4, sensor_seed=2, mode=mode))


def in_company(camera, cls):
    """The camera without what an effect replaces, and with a lens where it needs one."""
    if cls.needs_chief_ray:
        lens = catalogue()["ray_transfer"](file=LENS)
        camera = replace(camera, effects=(lens, *(e for e in camera.effects if e.name not in lens.replaces)))
    if "aperture" in cls.replaces:
        return replace(camera, effects=(cls(file=LENS), *(e for e in camera.effects if e.name not in cls.replaces)))
    return camera


def with_effect(camera, name):
    """The camera with parameters of one effect moved: by their plausible scales, by a tenth, or the effect taken out."""
    camera = in_company(camera, catalogue()[name])
    standing = camera.effect(name)
    if standing is not None and not standing.candidate:
        moved = {p.name: min(1.1 * standing.values()[p.name], p.high) for p in standing.parameters()}
        return camera.with_effect(standing.changed(**moved)) if moved else camera.without(name)
    effect = standing or catalogue()[name](**{p.name: p.null for p in catalogue()[name].parameters() if not p.shape})
    moved = {p.name: effect.values()[p.name] + p.tau for p in effect.own_parameters() if p.tau is not None and not p.shape}
    return camera.with_effect(effect.changed(**moved))


def fall_off(model):
    """Mean of a flat at the corner over that in the middle."""
    middle = replace(SHOTS["flat"], window=MIDDLE)
    corner, center = (dn(model, shot, "expected").mean() - 64.0 for shot in (SHOTS["flat"], middle))
    return corner / center


def check_edge(camera, changed):
    """The same edge but for level and contrast: after = a + b before, within a thousandth of the contrast."""
    before, after = (dn(model, SHOTS["edge"], "expected")[::2, 1::2] for model in (camera, changed))
    b, a = np.polyfit(before.ravel(), after.ravel(), 1)
    assert np.abs(after - a - b * before).max() < 1e-3 * np.ptp(after)
    assert b > 0.5


@pytest.mark.parametrize(("name", "claim"), CLAIMS, ids=str)
def test_claim(camera, name, claim):
    changed = with_effect(camera, name)
    if claim == "edge":
        check_edge(camera, changed)
        return
    if claim == "illumination":  # a thousandth: what the fall-off of an effect of optics would exceed by far
        assert fall_off(changed) == pytest.approx(fall_off(camera), rel=1e-3)
        return
    if catalogue()[name].stage == "file":  # acts on whole codes
        camera, changed = (model.replace(model.effect("quantization").changed(step_dn=1.0)) for model in (camera, changed))
    before, after = (dn(model, SHOTS[claim], "derivative") for model in (camera, changed))
    np.testing.assert_allclose(after, before, atol=0.01)  # a hundredth of a DN, with all noise


BEHIND_A_PUPIL = [name for name, cls in catalogue().items() if cls.stage == "optics" and cls.acts_on == "irradiance"]


@pytest.mark.parametrize("name", BEHIND_A_PUPIL)
def test_it_moves_the_film_by_what_it_says(name, place, light):
    """Beside the window's middle, where nothing that grows with the field is zero; whatever else it does to the pupil."""
    effect = catalogue()[name]()
    moved = {p.name: p.null + 0.3 * p.tau for p in effect.own_parameters() if p.tau is not None and p.null is not None}
    effect = effect.changed(**{n: min(v, p.high) for p in effect.parameters() for n, v in moved.items() if n == p.name})
    context = place(effect, window=CORNER)
    before = light(shape=CORNER[2:])
    after = effect.apply(before, context)
    assert after.pupil.focus_um - before.pupil.focus_um == pytest.approx(effect.focus_shift_um(context), abs=1e-12)
    if name in ("defocus", "field_curvature", "sensor_tilt"):
        assert abs(effect.focus_shift_um(context)) > 0.1


@pytest.mark.parametrize("mode", ["capture", "derivative"])
@pytest.mark.parametrize("name", sorted(set(catalogue()) - {"cfa"}))  # without colour filters there is no mosaic
def test_bits_do_not_depend_on_how_many_blocks_of_rows_are_seen_at_once(name, mode, camera, monkeypatch):
    """The corner lies on two blocks, each with streams of its own."""
    changed = with_effect(camera, name)
    together = [dn(changed, SHOTS[role], mode) for role in ("dark", "flat")]
    monkeypatch.setattr("isetval.camera.chain.RUN_PX", 1)
    for role, found in zip(("dark", "flat"), together, strict=True):
        np.testing.assert_array_equal(found, dn(changed, SHOTS[role], mode))
