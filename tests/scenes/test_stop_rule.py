"""Electrons for radiance, and the stop rule on a real render."""

import numpy as np
import pytest

from isetval.core.errors import InputError
from isetval.scenes import below_shot_noise, cornell_box, electrons_per_radiance, render, wall_camera

BANDS = np.array([500.0, 550.0, 600.0])


def test_electrons_of_a_monochromatic_beam():
    # 1 W of 550 nm light is 2.7687e18 photons/s (h c = 1.98644586e-25 J m)
    found = electrons_per_radiance([540.0, 550.0, 560.0], [0.0, 1.0, 0.0], time_s=1.0, pixel_um=1e6, solid_angle_sr=1.0)
    np.testing.assert_allclose(found, [0, 10 * 550e-9 / 1.98644586e-25, 0], rtol=1e-8)


def test_scales_as_time_area_and_solid_angle():
    base = electrons_per_radiance(BANDS, [0.5] * 3, time_s=0.01, pixel_um=1.4, solid_angle_sr=0.26)
    more = electrons_per_radiance(BANDS, [0.5] * 3, time_s=0.02, pixel_um=2.8, solid_angle_sr=0.13)
    np.testing.assert_allclose(more, 4 * base)
    with pytest.raises(InputError, match="3 bands"):
        electrons_per_radiance(BANDS, [0.5] * 2, time_s=0.01, pixel_um=1.4, solid_angle_sr=0.26)


@pytest.mark.mitsuba
def test_a_render_stops_at_the_wanted_share_of_the_shot_noise():
    camera = {**wall_camera(0.4), "rows": 96, "cols": 128, "pixel_um": 1.4 * 31.5}
    electrons = electrons_per_radiance(BANDS, [0.3, 0.6, 0.3], time_s=0.002, pixel_um=1.4, solid_angle_sr=0.26)
    arguments = {"camera": camera, "crop": (36, 66, 12, 12), "wavelength_nm": BANDS, "spp": 3200}
    target = below_shot_noise(electrons, fraction=0.14, minimum_passes=4)
    out = render(cornell_box(charts=()), noise_target=target, **arguments)
    done = out.settings["tiles"][0]
    assert done["noise"] <= 0.14
    assert 800 <= done["spp"] < 3200
    # the measured noise of another render with as many samples agrees with what the stop rule saw
    again = render(cornell_box(charts=()), seed=9, **(arguments | {"spp": done["spp"]}))
    level = np.tensordot(electrons, out.radiance, 1)
    difference = level - np.tensordot(electrons, again.radiance, 1)
    seen = np.sqrt(0.5 * np.mean(difference**2) / level.mean())
    assert seen == pytest.approx(done["noise"], rel=5 / np.sqrt(2 * 144))
