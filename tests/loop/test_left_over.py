"""Patterns without physics that stand out of what is left over."""

from types import SimpleNamespace

import numpy as np
import pytest

from isetval.core.metric import Metric
from isetval.loop.score_test import Frame
from isetval.loop.unknown import findings, patterns_of

N = 40
RADIUS_MM = np.linspace(0.0, 3.0, N)


def problem():
    metrics = [Metric("mean", 100.0, 1.0, "DN", family="flat_mean", field_x_mm=float(r), field_y_mm=0.0) for r in RADIUS_MM]
    return SimpleNamespace(
        predictor=SimpleNamespace(table=SimpleNamespace(metrics=metrics)),
        base=SimpleNamespace(mean=np.full(N, 100.0), covariance=np.eye(N)),
        covariance=np.eye(N),
        keep=np.arange(N),
        whitened=lambda vector: vector,
    )


def slope(gain):
    """A residual along the field radius whose chi2 falls by ``gain`` when it is explained."""
    t = RADIUS_MM - RADIUS_MM.mean()
    return np.sqrt(gain) * t / np.linalg.norm(t)


@pytest.mark.parametrize(("gain", "named"), [(20.0, True), (2.0, False)])
def test_a_slope_has_to_pass_the_look_elsewhere_correction(gain, named):
    # 20: p about 1e-4 after a dozen patterns
    found = findings(problem(), Frame(slope(gain), np.zeros((N, 0)), N))
    assert any("field radius" in f.words for f in found) == named


def test_radial_fringes_are_described_as_ripples():
    wave = np.sin(2 * np.pi * 2 * RADIUS_MM / RADIUS_MM[-1])
    frame = Frame(np.sqrt(60.0) * wave / np.linalg.norm(wave), np.zeros((N, 0)), N)
    assert findings(problem(), frame)[0].words == "flat_mean ripples along field radius, 2 periods (sine)"


def test_patterns_are_whitened_columns_with_words_and_family():
    found = patterns_of(problem())
    assert found.white.shape == (N, len(found.words))
    assert len(set(found.words)) == len(found.words)
    assert set(found.families) == {"flat_mean"}
    slopes = found.white[:, found.words.index("flat_mean changes along field radius")]
    assert slopes == pytest.approx(100 * (RADIUS_MM - 1.5) / 1.5)
