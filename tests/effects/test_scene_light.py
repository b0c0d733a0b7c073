"""Scene-side effects: what they do to the radiance of planar targets."""

from dataclasses import replace

import numpy as np
import pytest

from isetval.core.scene import ChartTarget, EdgeTarget, Patch, Scene, Spectrum
from isetval.effects.gloss_lobe import GlossLobe
from isetval.effects.scene_light import (
    AmbientLight,
    BlackReflectance,
    ChartTilt,
    Fluorescence,
    Gloss,
    Interreflection,
    LightNonuniformity,
    PositionScale,
    SpdMismatch,
)
from isetval.scenes.planar import planar_radiance

GRID = np.arange(400.0, 701.0, 50.0)
FLAT = Scene(GRID, np.linspace(1, 2, GRID.size))
EDGE = replace(FLAT, target=EdgeTarget("e"))
CHART = replace(
    FLAT,
    target=ChartTarget("c", (Patch("a", (0, 50, 0, 50), Spectrum.flat(0.5)), Patch("b", (0, 50, 60, 110), Spectrum.flat(0.2)))),
)


def radiance(effect, scene, context):
    values = planar_radiance(effect.apply_scene(scene, context), context).values
    return np.broadcast_to(values, (GRID.size, *context.window[2:]))


def test_uneven_light_is_seen_in_flats_and_turns_against_a_turned_camera(place):
    effect = LightNonuniformity(tilt_x=0.1, radial=0.05)
    corner = place(window=(0, 0, 1, 1))
    x, r2 = -2015.5 / 2520, (2015.5**2 + 1511.5**2) / 2520**2
    np.testing.assert_allclose(radiance(effect, FLAT, corner)[:, 0, 0], FLAT.white * (1 + 0.1 * x + 0.05 * r2))
    turned = radiance(effect, FLAT, place(window=(0, 0, 1, 1), rotation_deg=180.0))[:, 0, 0]
    np.testing.assert_allclose(turned, FLAT.white * (1 - 0.1 * x + 0.05 * r2))
    assert effect.apply_scene(CHART, corner) is CHART


def test_a_lamp_beside_the_axis_is_no_tilt_and_radial_part_alone(place):
    """A point over a plane, (1 - 2 q + rho)^(-3/2): its second order is across the radius as well, its third is left."""
    lamp, near2 = np.array([0.8, 0.3]), 0.2**2
    square = near2 / (1 + near2 * lamp @ lamp)  # 1/D^2
    a, b = 3 * square * lamp
    half = 15 / 4 * square**2 * np.array([lamp @ lamp, lamp[0] ** 2 - lamp[1] ** 2, 2 * lamp[0] * lamp[1]])
    whole = LightNonuniformity(tilt_x=a, tilt_y=b, radial=half[0] - 1.5 * square, saddle=half[1], twist=half[2])
    plain = replace(whole, saddle=0.0, twist=0.0)

    def worst(effect):
        errors = []
        for row, col in ((0, 0), (0, 4031), (3023, 4031), (1511, 4031), (0, 2016)):
            x, y = (col - 2015.5) / 2520, (row - 1511.5) / 2520
            true = (1 - 2 * square * (x * lamp[0] + y * lamp[1]) + square * (x * x + y * y)) ** -1.5
            errors.append(radiance(effect, FLAT, place(window=(row, col, 1, 1)))[0, 0, 0] / FLAT.white[0] - true)
        return np.abs(errors).max()

    third = (a * a + b * b) ** 1.5 + 15 / 2 * np.hypot(a, b) / 3 * square  # bound of the terms of third order at the corner
    assert worst(whole) < third
    assert worst(plain) > worst(whole) + 0.8 * np.hypot(half[1], half[2])


def test_a_wrong_spectrum_belongs_to_one_light(place):
    effect = SpdMismatch(light="A", tilt=0.1, spike=0.5, spike_nm=600.0, width_nm=5.0)
    out = radiance(effect, FLAT, place(light="A"))[:, 0, 0]
    line = [0, 0, 0, 0, 0.75, 0, 0]  # half of the mean radiance, which is 1.5
    np.testing.assert_allclose(out, FLAT.white * [0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15] + line, atol=1e-12)
    bent = radiance(SpdMismatch(bow=0.1), FLAT, place())[:, 0, 0] / FLAT.white
    np.testing.assert_allclose(bent, 1 + 0.1 * (np.array([400, 450, 500, 550, 600, 650, 700]) / 100 - 5.5) ** 2, atol=1e-12)
    assert effect.apply_scene(FLAT, place(light="D65")) is FLAT
    assert effect.content() != replace(effect, light="D65").content()


def test_a_line_adds_the_same_light_whatever_the_continuum(place):
    """A share of the mean radiance, not of the radiance at its place, which of a warm lamp is a tenth in the violet."""
    effect = SpdMismatch(spike=0.1, spike_nm=450.0, width_nm=5.0)
    rise = [radiance(effect, s, place())[:, 0, 0] - s.white for s in (FLAT, replace(FLAT, white=FLAT.white[::-1]))]
    np.testing.assert_allclose(rise[0], 0.15 * (GRID == 450), atol=1e-12)
    np.testing.assert_allclose(rise[1], rise[0], atol=1e-12)
    dark = replace(FLAT, white=np.where(GRID == 450, 0.0, FLAT.white))  # a line where the stated spectrum holds no light
    np.testing.assert_allclose(radiance(effect, dark, place())[:, 0, 0] - dark.white, 0.1 * dark.white.mean() * (GRID == 450))


def test_without_a_line_its_place_makes_no_other_light():
    forms = [SpdMismatch(tilt=0.1, spike_nm=nm) for nm in (545.0, 611.0)]
    assert forms[0].content() == forms[1].content()
    assert replace(forms[0], spike=0.1).content() != replace(forms[1], spike=0.1).content()


def test_light_level_by_field_position_leaves_flats_alone(place):
    effect = PositionScale(a=0.1, c=0.2)
    corner = place(window=(3024 - 128, 4032 - 128, 128, 128))
    x, y = (2016 - 64) / 2520, (1512 - 64) / 2520
    scaled = effect.apply_scene(CHART, corner).white / CHART.white
    np.testing.assert_allclose(scaled, 1 + 0.1 * x + 0.2 * (x * x + y * y))
    assert effect.apply_scene(FLAT, corner) is FLAT
    assert effect.apply_scene(EDGE, corner) is EDGE  # another target, which the chart's lamp does not light


def test_black_that_reflects_lifts_the_dark_side_only(place):
    context = place()
    lift = radiance(BlackReflectance(rho_b=0.02), EDGE, context) - radiance(BlackReflectance(), EDGE, context)
    np.testing.assert_allclose(lift[:, 128, 5], 0.02 * FLAT.white)  # left is dark
    np.testing.assert_allclose(lift[:, 128, -5], 0.0, atol=1e-15)


def test_a_tilted_chart_has_a_gradient(place):
    out = radiance(ChartTilt(a=0.1, b=-0.04), CHART, place())
    even = radiance(ChartTilt(), CHART, place())
    np.testing.assert_allclose((out / even)[0, 255, 255], 1 + (0.1 - 0.04) * 127.5 / 128)
    np.testing.assert_allclose((out / even)[0, 0, 0], 1 - (0.1 - 0.04) * 127.5 / 128)
    assert ChartTilt(a=0.1).apply_scene(EDGE, place()) is EDGE  # the light of another target says nothing of the chart's


def test_a_highlight_lies_at_its_place_on_dark_and_bright_patches_alike(place):
    context = place()
    effect = GlossLobe(level=0.03, x0=-0.5, y0=0.25, width=0.3)
    lift = radiance(effect, CHART, context) - radiance(GlossLobe(), CHART, context)
    x, y = (np.arange(256) - 127.5) / 128, (np.arange(256) - 127.5) / 128
    expected = 0.03 * np.exp(-((x[None] + 0.5) ** 2 + (y[:, None] - 0.25) ** 2) / 0.18)
    np.testing.assert_allclose(lift[3], FLAT.white[3] * expected, atol=1e-12)
    assert effect.apply_scene(EDGE, context) is EDGE


def test_gloss_lifts_all_patches_alike(place):
    lift = radiance(Gloss(level=0.01), CHART, place()) - radiance(Gloss(), CHART, place())
    np.testing.assert_allclose(lift[:, 25, 25], 0.01 * FLAT.white)
    np.testing.assert_allclose(lift[:, 25, 85], 0.01 * FLAT.white)


def test_fluorescence_glows_in_its_own_patch_under_violet_light_only(place):
    effect = Fluorescence(patch="a", emission=0.3, peak_nm=450.0, width_nm=10.0)
    glow = radiance(effect, CHART, place()) - radiance(Fluorescence(), CHART, place())
    # yield x radiance at 400 nm, the only violet band
    np.testing.assert_allclose(glow[1, 25, 25], 0.3 * FLAT.white[0], rtol=1e-9)  # the equation, at the peak
    np.testing.assert_allclose(glow[:, 25, 85], 0.0, atol=1e-15)
    no_violet = replace(CHART, white=np.where(GRID < 430, 0.0, CHART.white))
    np.testing.assert_allclose(radiance(effect, no_violet, place()), radiance(Fluorescence(), no_violet, place()))


def test_stray_light_is_added_everywhere_but_behind_the_cap(place):
    effect = AmbientLight(radiance=0.1, tilt=0.2)
    for scene in (FLAT, EDGE, CHART):
        lift = radiance(effect, scene, place(role="chart")) - radiance(AmbientLight(), scene, place(role="chart"))
        np.testing.assert_allclose(lift[:, 3, 4], 0.1 * (1 + 0.2 * (GRID - 550) / 100))
    assert effect.apply_scene(FLAT, place(role="dark")) is FLAT


def test_wall_light_is_handed_to_the_renderer(place):
    assert Interreflection(bounce=0.3).apply_scene(replace(FLAT, bounce=0.1), place()).bounce == pytest.approx(0.4)
