"""Killed renders, tiles and variants: what must not depend on how a render was run."""

import os
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from isetval.scenes import cornell_box, wall_camera
from isetval.scenes.rendered import rendering
from isetval.scenes.rendered.rendering import render

pytestmark = pytest.mark.mitsuba
BANDS = [500.0, 550.0, 600.0]
CAMERA = {**wall_camera(0.4), "rows": 48, "cols": 64, "pixel_um": 1.4 * 63}
CODE = """
    import os, signal, sys
    from isetval.scenes import cornell_box, render, wall_camera
    camera = {**wall_camera(0.4), "rows": 48, "cols": 64, "pixel_um": 1.4 * 63}

    def progress(done, total, words):
        if done == 5:
            os.kill(os.getpid(), signal.SIGKILL)

    render(cornell_box(), camera=camera, wavelength_nm=[500.0, 550.0, 600.0], spp=48, seed=4, progress=progress)
"""


def test_a_killed_render_ends_with_the_same_bits():
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(CODE)], env=dict(os.environ), check=False)
    assert done.returncode == -signal.SIGKILL
    passes = []
    arguments = {"camera": CAMERA, "wavelength_nm": BANDS, "spp": 48, "seed": 4}
    resumed = render(cornell_box(), progress=lambda *p: passes.append(p[0]), **arguments)
    assert passes == list(range(6, 17))
    whole = render(cornell_box(), cache=False, **arguments)
    for name in ("radiance", "variance", "depth_m"):
        assert np.array_equal(getattr(resumed, name), getattr(whole, name))


def test_tiles_are_independent_of_each_other_and_of_their_order(monkeypatch):
    monkeypatch.setattr(rendering, "TILE_PX", 16)
    arguments = {"camera": CAMERA, "wavelength_nm": BANDS, "spp": 8, "seed": 4, "cache": False}
    whole = render(cornell_box(), crop=(8, 8, 32, 32), **arguments)
    for row, col in ((24, 24), (8, 24), (24, 8), (8, 8)):
        part = render(cornell_box(), crop=(row, col, 16, 16), **arguments)
        assert np.array_equal(part.radiance, whole.radiance[:, row - 8 : row + 8, col - 8 : col + 8])


def test_the_number_of_threads_does_not_change_the_bits():
    code = textwrap.dedent("""
        import sys, hashlib
        import mitsuba, drjit
        drjit.set_thread_count(int(sys.argv[1]))
        from isetval.scenes import cornell_box, render, wall_camera
        camera = {**wall_camera(0.4), "rows": 20, "cols": 24, "pixel_um": 180.0}
        out = render(cornell_box(), camera=camera, wavelength_nm=[500.0, 600.0], spp=8, cache=False)
        print(hashlib.sha256(out.radiance.tobytes()).hexdigest())
    """)
    found = {
        subprocess.run([sys.executable, "-c", code, n], capture_output=True, text=True, check=True).stdout for n in ("1", "4")
    }
    assert len(found) == 1


def test_scalar_and_fast_variants_agree_within_the_render_error(fast_variant):
    arguments = {"camera": CAMERA, "wavelength_nm": BANDS, "spp": 128, "cache": False}
    slow = render(cornell_box(), variant="scalar_spectral", seed=1, **arguments)
    fast = render(cornell_box(), variant=fast_variant, seed=2, **arguments)
    hit = np.isfinite(slow.depth_m) & np.isfinite(fast.depth_m)
    assert np.median(np.abs(slow.depth_m[hit] - fast.depth_m[hit])) < 5e-3  # one random ray a pixel, on slanted walls
    lit = (slow.radiance > 0).all(axis=0) & (fast.radiance > 0).all(axis=0)
    difference = (slow.radiance - fast.radiance)[:, lit].astype(float)
    variance = (slow.variance + fast.variance)[:, lit].astype(float)
    # few pixels see the lamp's border; they alone would set the error of the plain mean
    weight = 1 / np.median(variance / slow.radiance[:, lit] ** 2, axis=0) / slow.radiance[:, lit] ** 2
    mean = (weight * difference).sum(axis=1) / weight.sum(axis=1)
    sigma = np.sqrt((weight**2 * variance).sum(axis=1)) / weight.sum(axis=1)
    assert np.all(np.abs(mean) < 3 * sigma)
    level = (weight * slow.radiance[:, lit]).sum(axis=1) / weight.sum(axis=1)
    assert np.all(sigma < 4e-3 * level)
