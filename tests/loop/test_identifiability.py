"""What identify promises: strengths at which an effect is found in half and in nearly all campaigns."""

import numpy as np
import pytest
from scipy.stats import norm

from isetval.loop.identifiability import FALSE_ALARMS, noncentralities


@pytest.mark.parametrize("one_sided", [True, False])
def test_one_parameter_is_found_where_the_normal_law_says(one_sided):
    """One parameter: threshold z of .01/41 (two-sided: half of it), 50 % power there and 95 % 1.64 sigmas beyond."""
    half, nearly = noncentralities(1, 41, one_sided=one_sided)
    threshold = norm.isf(FALSE_ALARMS / 41 / (1 if one_sided else 2))
    # two-sided power counts the far side as well: below 1e-6 at these strengths
    assert half == pytest.approx(threshold, abs=1e-4)
    assert nearly == pytest.approx(threshold + norm.isf(0.05), abs=1e-4)


def test_power_of_three_parameters_is_that_of_drawn_scores():
    """20,000 scores drawn at the strength of 50 %: chi2 of three, one of its normals moved by s."""
    rng = np.random.default_rng(4)
    half, nearly = noncentralities(3, 60)
    from scipy.stats import chi2

    limit = chi2.isf(FALSE_ALARMS / 60, 3)
    for s, power in ((half, 0.5), (nearly, 0.95)):
        score = np.sum((rng.standard_normal((20_000, 3)) + [s, 0, 0]) ** 2, axis=1)
        assert np.mean(score > limit) == pytest.approx(power, abs=4 * np.sqrt(power * (1 - power) / 20_000))
