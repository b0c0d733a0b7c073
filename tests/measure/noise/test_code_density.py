"""Widths of codes from their counts, against planted widths."""

import numpy as np
import pytest

from isetval.measure.noise.code_density import code_widths

CODES = 1024


def counts(rng, *, sigma=0.0, repeated=0.0, noise_dn=20.0, level=500.3, pixels=1_000_000):
    """Counts of a flat, and the codes' widths, made without the effect of the catalogue."""
    pattern = rng.standard_normal(16)
    widths = 1 + sigma * rng.standard_normal(CODES) + repeated * np.tile(pattern - pattern.mean(), CODES // 16)
    edges = np.concatenate([[0.0], np.cumsum(widths)])
    edges *= CODES / edges[-1]
    values = rng.normal(level, noise_dn, pixels)
    found = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, CODES - 1)
    return np.bincount(found, minlength=CODES), np.diff(edges)


def test_equal_codes_have_no_variance_and_the_stated_error():
    found = [code_widths(counts(np.random.default_rng(seed), level=400 + 7.3 * seed)[0]) for seed in range(40)]
    for name in ("variance", "repeated"):
        z = np.array([getattr(f, name).value / getattr(f, name).sigma for f in found])
        assert abs(z.mean()) < 4 / np.sqrt(len(z))
        assert 0.7 < z.std() < 1.35


def test_the_widths_of_the_codes_that_are_hit_are_found():
    rng = np.random.default_rng(3)
    hit, widths = counts(rng, sigma=0.08)
    found = code_widths(hit)
    weight = hit.astype(float) ** 2
    planted = float(np.average((widths - np.average(widths, weights=weight)) ** 2, weights=weight))
    assert found.variance.value == pytest.approx(planted, rel=0.15)
    assert found.variance.value > 100 * found.variance.sigma


def test_a_repeated_pattern_is_told_from_codes_of_their_own():
    own = code_widths(counts(np.random.default_rng(5), sigma=0.06, noise_dn=40, pixels=4_000_000)[0])
    again = code_widths(counts(np.random.default_rng(5), repeated=0.06, noise_dn=40, pixels=4_000_000)[0])
    assert again.repeated.value > 0.8 * again.variance.value
    assert own.repeated.value < 0.3 * own.variance.value


@pytest.mark.parametrize("case", [{"noise_dn": 2.0}, {"pixels": 50_000}])
def test_too_few_codes_or_counts_say_nothing(case):
    assert code_widths(counts(np.random.default_rng(1), **case)[0]) is None
