"""Render passes on an engine: the bits of one process, whoever drew them and in whatever order they came."""

import numpy as np
import pytest

from isetval.core.engine import Here, Processes
from isetval.scenes import cornell_box, wall_camera
from isetval.scenes.rendered import rendering
from isetval.scenes.rendered.accumulation import NoiseTarget
from isetval.scenes.rendered.rendering import passes_on, render

pytestmark = pytest.mark.mitsuba
ASKED = {
    "camera": {**wall_camera(0.4), "rows": 24, "cols": 40, "pixel_um": 1.4 * 126},
    "wavelength_nm": [500.0, 550.0, 600.0],
    "spp": 48,
    "seed": 4,
}


@pytest.fixture(scope="module")
def processes():
    engine = Processes(2)
    yield engine
    engine.close()


@pytest.mark.parametrize("target", [None, NoiseTarget(relative_sd=0.5)])
def test_passes_of_processes_are_those_of_one(processes, monkeypatch, target):
    """Two tiles; with a stop rule the passes that came too many are not counted."""
    monkeypatch.setattr(rendering, "TILE_PX", 24)
    here = render(cornell_box(), cache=False, noise_target=target, **ASKED)
    with passes_on(processes):
        spread = render(cornell_box(), cache=False, noise_target=target, **ASKED)
    for name in ("radiance", "variance", "depth_m", "draws"):
        assert np.array_equal(getattr(spread, name), getattr(here, name))
    done = [tile["passes"] for tile in here.settings["tiles"]]
    assert [tile["passes"] for tile in spread.settings["tiles"]] == done
    assert done == [16, 16] if target is None else max(done) < 16


class Counted(Here):
    """This process, which counts what it is asked for."""

    def __init__(self):
        self.works = 0

    def executor(self, *, broken=False):
        own, count = super().executor(broken=broken), self
        submit = own.submit

        def counted(*args):
            count.works += 1
            return submit(*args)

        own.submit = counted
        return own


def test_kept_passes_are_not_drawn_again():
    engine = Counted()
    for _ in range(2):
        with passes_on(engine):
            render(cornell_box(), **ASKED | {"seed": 5})
    assert engine.works == 16
