"""Stored metrics in tests: a pytest plugin that knows sigma (entry point ``pytest11``).

The fixture ``metric_check`` compares a number with the stored one of the same test and fails outside the
stored error bars, in words; ``--isetval-update "why"`` stores the present numbers with the reason.
Stored numbers lie in ``stored_metrics/<test file>.json`` beside the test, by the test's node id within its file
(``TestLens::test_sharpness[left]``); tests that run at the same time in several processes store one after the other.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

FOLDER = "stored_metrics"
SIGMAS = 4.0
RELATIVE = 1e-9


class MetricCheck:
    """Compares numbers of one test with their stored values."""

    def __init__(self, file: Path, test: str, reason: str | None) -> None:
        self._file, self._test, self._reason = file, test, reason
        self._stored: dict[str, Any] = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
        self._new: dict[str, Any] = {}

    def __call__(
        self, name: str, value: float, sigma: float | None = None, *, unit: str = "1", sigmas: float = SIGMAS, exact: bool = False
    ) -> None:
        """Fail if ``value`` is not what is stored.

        Parameters
        ----------
        name : str
            Of the metric, once per test.
        value, sigma : float
            The number now, and its standard deviation.
        unit : str
        sigmas : float
            How many standard deviations of the *stored* value are allowed.
        exact : bool
            The same capture analyzed again: 1e-9 relative is allowed, whatever sigma is.
        """
        __tracebackhide__ = True  # the failure is in the caller's line
        if name in self._new:
            pytest.fail(f"{name}: checked twice in {self._test}; give each number of a test its own name")
        if not math.isfinite(value):
            pytest.fail(f"{name}: now {value} {unit}; a number is needed")
        self._new[name] = {"value": float(value), "sigma": None if sigma is None else float(sigma), "unit": unit}
        if self._reason is not None:
            return
        stored = self._stored.get(self._test, {}).get(name)
        if stored is None:
            pytest.fail(
                f"{name}: nothing is stored for {self._test}; run pytest --isetval-update 'reason' and look at {self._file}"
            )
        words = _difference(name, self._new[name], stored, sigmas=sigmas, exact=exact)
        if words:
            pytest.fail(words)

    def store(self) -> None:
        """Write the new numbers, if asked to; other tests' numbers stay."""
        if self._reason is None or not self._new:
            return
        from isetval.core.writing import write_whole

        with _alone(self._file):
            content = json.loads(self._file.read_text(encoding="utf-8")) if self._file.is_file() else {}
            content[self._test] = self._new | {"reason": self._reason}
            self._file.parent.mkdir(exist_ok=True)
            write_whole(self._file, json.dumps(content, indent=1, sort_keys=True) + "\n")


@contextlib.contextmanager
def _alone(file: Path) -> Iterator[None]:
    """Other processes wait here for the same file; the lock lies in the system's folder for temporary files."""
    name = hashlib.sha256(str(file.resolve()).encode()).hexdigest()[:16]
    with open(Path(tempfile.gettempdir()) / f"isetval-metrics-{name}.lock", "a+b") as lock:
        try:
            import fcntl
        except ImportError:  # Windows
            import msvcrt

            lock.seek(0)
            msvcrt.locking(lock.fileno(), msvcrt.LK_LOCK, 1)  # type: ignore[attr-defined,unused-ignore]
        else:
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _difference(name: str, now: Mapping[str, Any], stored: Mapping[str, Any], *, sigmas: float, exact: bool) -> str:
    """Empty if equal within what is allowed, else a sentence."""
    if stored["unit"] != now["unit"]:
        return f"{name}: now in {now['unit']}, stored in {stored['unit']}"
    before, value = stored["value"], now["value"]
    allowed = max(RELATIVE * abs(before), 0.0 if exact or stored["sigma"] is None else sigmas * stored["sigma"])
    if abs(value - before) <= allowed:
        return ""
    percent = (
        f"{100 * (value / before - 1):+.3g} %, allowed {100 * allowed / abs(before):.2g} %"
        if before
        else f"allowed {allowed:.3g}"
    )
    return f"{name}: now {value:.6g} {now['unit']}, stored {before:.6g} {now['unit']} ({percent})"


def pytest_addoption(parser: pytest.Parser) -> None:
    """The option that stores numbers."""
    group = parser.getgroup("isetval")
    group.addoption("--isetval-update", metavar="REASON", default=None, help="store the metrics of metric_check, with a reason")


@pytest.fixture
def metric_check(request: pytest.FixtureRequest) -> Iterator[MetricCheck]:
    """Compare a metric with its stored value; see `MetricCheck`."""
    reason = request.config.getoption("--isetval-update")
    if reason is not None and not str(reason).strip():
        raise pytest.UsageError("--isetval-update needs a reason: what changed, and why the new numbers are right")
    path = Path(request.path)
    test = request.node.nodeid.partition("::")[2]
    check = MetricCheck(path.parent / FOLDER / f"{path.stem}.json", test, reason)
    yield check
    check.store()
