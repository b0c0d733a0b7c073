"""Intervals of centre, tilt and colour shading over 1000 made flats (slow)."""

import numpy as np
import pytest
from flat_fields import Flat

from isetval.measure.shading import relative_illumination


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.01, -0.008)])
def test_68_and_95_percent_intervals_cover_their_share(tilt):
    rng = np.random.default_rng(401)
    pulls = []
    trials = 1000
    for _ in range(trials):
        center = tuple(rng.uniform(-6, 6, 2))
        flat = Flat(rows=252, cols=336, pixel_um=16.8, center_px=center, tilt_per_mm=tilt, level_e=4000)
        result = relative_illumination(flat.capture(rng))
        pulls.append((np.array(result.decenter_px) - center) / result.center_sigma_px)
        if result.choices["geometry"] == "center+tilt":
            pulls.append((np.array(result.tilt_per_mm) - tilt) / result.tilt_sigma_per_mm)
    pulls = np.abs(pulls)
    for share, limit in ((0.6827, 1.0), (0.95, 1.95996)):
        assert abs(np.mean(pulls < limit) - share) < 3 * np.sqrt(share * (1 - share) / pulls.size)
