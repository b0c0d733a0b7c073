"""Progress: how far, how long; a line that moves on terminals, one now and then in logs."""

import io
import time

import pytest

from isetval.app.cli import console as module
from isetval.app.cli.console import Console, seconds_words


@pytest.fixture
def clock(monkeypatch):
    """A clock that a test moves."""
    now = [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    return now


def test_the_time_left_is_that_of_the_remaining_steps_at_the_pace_so_far(clock):
    console = Console()
    console.progress("flat_01", 0, 40)
    clock[0] += 6
    console.progress("flat_02", 10, 40)
    assert console._line() == "10 of 40 (25 %, 18 s left): flat_02"
    clock[0] += 600
    assert "30 min left" in console._line()  # 606 s for 10, so 1818 s for 30
    console.progress("last", 40, 40)
    assert console._line() == "40 of 40 (100 %): last"


def test_a_new_kind_of_step_starts_its_own_clock(clock):
    console = Console()
    console.progress("a", 5, 10)
    clock[0] += 10
    console.say("fitting")
    assert console._line() == ""
    clock[0] += 3
    assert console._line() == "fitting ... 3 s"
    console.progress("b", 1, 4)
    assert console._line() == ""


@pytest.mark.parametrize(("seconds", "words"), [(3.2, "3 s"), (89, "89 s"), (100, "2 min"), (7200, "2.0 h")])
def test_durations_in_words(seconds, words):
    assert seconds_words(seconds) == words


class Stream(io.StringIO):
    """A terminal, or a log file."""

    def __init__(self, terminal):
        super().__init__()
        self.terminal = terminal

    def isatty(self):
        return self.terminal


@pytest.mark.parametrize("terminal", [True, False])
def test_terminals_get_one_line_and_logs_whole_lines(monkeypatch, terminal):
    stream = Stream(terminal)
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setattr(module, "PATIENCE_S", 0.0)
    monkeypatch.setattr(module, "TICK_S", 0.01)
    monkeypatch.setattr(module, "LOG_S", 0.01)
    with Console() as console:
        console.progress("flat_02", 1, 4)
        time.sleep(0.2)
    written = stream.getvalue()
    assert "1 of 4 (25 %" in written
    assert ("\r" in written) == terminal
    assert written.endswith("\n") != terminal


def test_a_log_gets_a_line_within_half_a_minute_and_what_takes_two_seconds_is_told():
    assert 0 < module.LOG_S <= 30.0
    assert 0 < module.PATIENCE_S <= 2.0
    assert module.TICK_S < 1.0


def test_quiet_says_nothing(monkeypatch):
    stream = Stream(False)
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setattr(module, "PATIENCE_S", 0.0)
    monkeypatch.setattr(module, "LOG_S", 0.01)
    with Console(quiet=True) as console:
        console.progress("flat_02", 1, 4)
        time.sleep(0.05)
    assert stream.getvalue() == ""
