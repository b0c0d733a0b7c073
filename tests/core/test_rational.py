"""Rationals: the simplest fraction of a double, exact whenever 32 bits suffice."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isetval import InputError
from isetval.core.sensor import SIGNED_MAX, UNSIGNED_MAX, as_rational, as_rational_time


@pytest.mark.parametrize(
    ("value", "wanted"),
    [
        (63.9, Fraction(639, 10)),
        (2048.7, Fraction(20487, 10)),
        (1 / 3, Fraction(1, 3)),
        (0.1, Fraction(1, 10)),
        (0.0, Fraction(0)),
        (64.0, Fraction(64)),
        (-0.4986, Fraction(-2493, 5000)),
        (np.pi, Fraction(245850922, 78256779)),
        (UNSIGNED_MAX, Fraction(UNSIGNED_MAX)),
    ],
)
def test_known(value, wanted):
    """Pi: 245850922/78256779 is the convergent that first rounds to the double of pi."""
    assert as_rational(value) == wanted


@given(st.integers(0, 65535), st.integers(1, 65535))
def test_fractions_of_short_numbers_are_exact(numerator, denominator):
    assert as_rational(numerator / denominator) == Fraction(numerator, denominator)


@given(st.floats(1e-6, 1e6))
def test_nearest_of_any_double(value):
    """The next convergent does not fit, so this one errs by less than max(value, 1) / (q 2^32) times the last step."""
    stored = as_rational(value)
    assert max(stored.numerator, stored.denominator) <= UNSIGNED_MAX
    assert abs(stored - Fraction(value)) <= max(Fraction(value), Fraction(1)) / 2**31
    assert as_rational(float(stored)) == stored


def test_signed_parts_fit():
    assert as_rational(-1e9 - 0.3, limit=SIGNED_MAX).numerator >= -SIGNED_MAX


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 5e9, 1e-11])
def test_refused(value):
    with pytest.raises(InputError, match="rational"):
        as_rational(value)


@pytest.mark.parametrize("time_s", [0.0, -1.0, float("nan")])
def test_times_are_positive(time_s):
    with pytest.raises(InputError, match="positive"):
        as_rational_time(time_s)
