"""A chart that cannot be measured says why."""

import numpy as np
import pytest

from isetval.core.campaign import Shot
from isetval.core.capture import Capture
from isetval.core.errors import MeasurementError
from isetval.core.scene import ChartTarget, Patch, Spectrum
from isetval.measure.analyses.patches import analyze

PATCH = Patch("p", (4, 28, 4, 28), Spectrum.flat(0.5))


@pytest.mark.parametrize(
    ("patches", "level", "words"),
    [((), 300, "has no patch"), ((PATCH,), 0, "clipped at code 0"), ((PATCH,), 1023, "clipped at code 0 or at white")],
)
def test_nothing_to_measure_is_told_from_nothing_measurable(patches, level, words):
    shot = Shot("c", "chart", target=ChartTarget("c", patches))
    with pytest.raises(MeasurementError, match=words):
        analyze(shot, [Capture.from_array(np.full((32, 32), level))], {})
