"""The fixture for stored metrics: what it stores, what it allows, what it says."""

import json
import multiprocessing

import pytest

from isetval.testing.pytest_plugin import MetricCheck

Failed = pytest.fail.Exception


def check(folder, reason=None):
    return MetricCheck(folder / "stored_metrics" / "test_lens.json", "test_sharpness", reason)


@pytest.fixture
def stored(tmp_path):
    """A folder with a stored value of 0.300 +- 0.002 cy/px."""
    first = check(tmp_path, "first lens")
    first("mtf50", 0.3, 0.002, unit="cy/px")
    first.store()
    return tmp_path


@pytest.mark.parametrize(("value", "allowed"), [(0.3075, True), (0.3085, False), (0.2925, True), (0.2915, False)])
def test_a_number_may_move_by_four_stored_sigmas(stored, value, allowed):
    # the new sigma is ten times larger and must not widen what is allowed
    if allowed:
        check(stored)("mtf50", value, 0.02, unit="cy/px")
    else:
        with pytest.raises(Failed, match="mtf50: now"):
            check(stored)("mtf50", value, 0.02, unit="cy/px")


def test_a_failure_says_both_numbers_and_what_is_allowed(stored):
    with pytest.raises(Failed, match=r"mtf50: now 0.33 cy/px, stored 0.3 cy/px \(\+10 %, allowed 2.7 %\)"):
        check(stored)("mtf50", 0.33, 0.002, unit="cy/px")


def test_exact_numbers_may_not_move(stored):
    check(stored)("mtf50", 0.3, unit="cy/px", exact=True)
    with pytest.raises(Failed):
        check(stored)("mtf50", 0.3001, unit="cy/px", exact=True)


@pytest.mark.parametrize(
    ("value", "unit", "name", "words"),
    [
        (0.3, "cy/mm", "mtf50", "now in cy/mm, stored in cy/px"),
        (float("nan"), "cy/px", "mtf50", "a number is needed"),
        (0.3, "cy/px", "mtf30", "nothing is stored for test_sharpness; run pytest --isetval-update 'reason'"),
    ],
)
def test_what_cannot_be_compared_is_said(stored, value, unit, name, words):
    with pytest.raises(Failed, match=words):
        check(stored)(name, value, 0.002, unit=unit)


def test_storing_keeps_other_tests_numbers(stored):
    other = MetricCheck(stored / "stored_metrics" / "test_lens.json", "test_shading", "second")
    other("corner", 0.5, None)
    other.store()
    content = json.loads((stored / "stored_metrics" / "test_lens.json").read_text())
    assert content["test_sharpness"] == {"mtf50": {"value": 0.3, "sigma": 0.002, "unit": "cy/px"}, "reason": "first lens"}
    assert content["test_shading"]["corner"] == {"value": 0.5, "sigma": None, "unit": "1"}


def test_as_its_users_run_it(pytester):
    pytester.makepyfile(test_lens="def test_sharpness(metric_check):\n    metric_check('mtf50', 0.3, 0.002, unit='cy/px')\n")
    inner = pytester.runpytest_inprocess("-p", "no:cacheprovider", "--isetval-update", "first lens")
    inner.assert_outcomes(passed=1)
    stored = json.loads((pytester.path / "stored_metrics" / "test_lens.json").read_text())
    assert stored["test_sharpness"]["reason"] == "first lens"


TWO_CLASSES = """
import pytest

class TestLeft:
    def test_sharpness(self, metric_check):
        metric_check("mtf50", {left}, 0.002, unit="cy/px")

class TestRight:
    @pytest.mark.parametrize("row", [1, 2])
    def test_sharpness(self, metric_check, row):
        metric_check("mtf50", 0.1 * row, 0.002, unit="cy/px")
"""


def test_tests_of_one_name_in_two_classes_keep_their_own_numbers(pytester):
    pytester.makepyfile(test_lens=TWO_CLASSES.format(left=0.3))
    pytester.runpytest_inprocess("-p", "no:cacheprovider", "--isetval-update", "first").assert_outcomes(passed=3)
    stored = json.loads((pytester.path / "stored_metrics" / "test_lens.json").read_text())
    assert {test: entry["mtf50"]["value"] for test, entry in stored.items()} == {
        "TestLeft::test_sharpness": 0.3,
        "TestRight::test_sharpness[1]": 0.1,
        "TestRight::test_sharpness[2]": 0.2,
    }
    pytester.runpytest_inprocess("-p", "no:cacheprovider").assert_outcomes(passed=3)


def test_a_failure_shows_the_line_of_the_test_and_none_of_the_plugin(pytester):
    pytester.makepyfile(test_lens=TWO_CLASSES.format(left=0.3))
    pytester.runpytest_inprocess("-p", "no:cacheprovider", "--isetval-update", "first")
    pytester.makepyfile(test_lens=TWO_CLASSES.format(left=0.33))
    done = pytester.runpytest_inprocess("-p", "no:cacheprovider")
    done.assert_outcomes(passed=2, failed=1)
    shown = done.stdout.str()
    assert "mtf50: now 0.33 cy/px, stored 0.3 cy/px" in shown
    assert '>       metric_check("mtf50", 0.33' in shown
    assert "pytest_plugin.py" not in shown
    assert "def __call__" not in shown


def test_one_name_twice_in_a_test_is_refused(stored):
    again = check(stored)
    again("mtf50", 0.3, 0.002, unit="cy/px")
    with pytest.raises(Failed, match="mtf50: checked twice in test_sharpness"):
        again("mtf50", 0.3, 0.002, unit="cy/px")


def _store_one(folder, number):
    one = MetricCheck(folder / "stored_metrics" / "test_lens.json", f"test_{number}", "parallel")
    one("value", float(number), None)
    one.store()


def test_processes_that_store_at_the_same_time_lose_nothing(tmp_path):
    (tmp_path / "stored_metrics").mkdir()
    processes = [multiprocessing.get_context("fork").Process(target=_store_one, args=(tmp_path, n)) for n in range(24)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    stored = json.loads((tmp_path / "stored_metrics" / "test_lens.json").read_text())
    assert sorted(stored) == sorted(f"test_{n}" for n in range(24))
