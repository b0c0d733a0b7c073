"""Every diagnosis ends: at its time limit it says the best statement so far, and what it did not look at."""

from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest

import isetval
from isetval.app.cli.loop_words import diagnosis_lines
from isetval.app.report.content import page_content
from isetval.camera.model_file import load_model
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.errors import InputError
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure
from isetval.core.toml import data_folder
from isetval.effects import catalogue
from isetval.loop import search, telling
from isetval.loop.telling import Deadline, Teller, TimeUp

WHITE = Light("white", Spectrum(np.array([390.0, 710.0]), np.array([0.0016, 0.0016])))
AT, HIDDEN = (1480, 1984, 48, 48), "temporal_row_noise"


def shots(session):
    dark = [Shot(f"{session}d{t:g}", "dark", f"{session}d", session, Exposure(time_s=t), 4, window=AT) for t in (0.01, 0.2)]
    lit = [
        Shot(f"{session}f{t:g}", "flat", f"{session}f", session, Exposure(time_s=t), 2, "white", window=AT) for t in (0.004, 0.03)
    ]
    return (*dark, *lit)


@pytest.fixture(scope="module")
def nominal():
    return load_model(data_folder() / "pixel4a" / "camera.toml")


@pytest.fixture(scope="module")
def captures(nominal):
    """Darks and flats of two sessions, shot by a camera with row noise of a tenth of a code."""
    priors = (Nuisance("light_level", 0.02, "relative", roles=("flat",)),)
    plan = Campaign("row_noise", (*shots("A"), *shots("B")), lights={"white": WHITE}, nuisances=priors, sensor=nominal.sensor)
    return isetval.simulate(nominal.add(catalogue()[HIDDEN](sigma_dn=0.1)), plan, seed=5, draw=True)


@pytest.fixture
def steps(monkeypatch):
    """A clock that moves a second at each look: limits are numbers of steps, whatever the machine."""
    ticks = count()
    monkeypatch.setattr(telling, "monotonic", lambda: float(next(ticks)))
    return ticks


def stopped(nominal, captures, limit_s):
    found = isetval.diagnose(nominal, captures, with_next_captures=False, limit_s=limit_s)
    return found, found.to_json()


def test_words_pass_through_and_the_clock_stops_them(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(telling, "monotonic", lambda: now[0])
    said, counted = [], []
    watch = Deadline(10.0, Teller(said.append, lambda *found: counted.append(found)))
    watch("measuring")
    watch.counted(1, 3)
    now[0] = 11.0
    with pytest.raises(TimeUp):
        watch.counted(2, 3)
    with pytest.raises(TimeUp):
        watch("simulating")
    watch.open = False
    watch("telling")
    assert said == ["measuring", "simulating", "telling"]
    assert counted == [("measuring", 1, 3), ("measuring", 2, 3)]


def test_the_time_of_a_stage_ends_before_all_of_it_and_never_after(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(telling, "monotonic", lambda: now[0])
    watch = Deadline(10.0)
    watch.stage(3.0)
    now[0] = 4.0
    with pytest.raises(TimeUp):
        watch.check()
    assert not watch.is_over
    watch.stage()
    watch.check()
    watch.stage(20.0)
    now[0] = 11.0
    with pytest.raises(TimeUp):
        watch.check()
    assert watch.is_over


def test_a_search_that_came_to_its_end_leaves_all_that_is_left(monkeypatch):
    """A search that ended 14 s before its third was over: the ladder was stopped when it was, with 600 s of 900 left."""
    now = [0.0]
    monkeypatch.setattr(telling, "monotonic", lambda: now[0])
    monkeypatch.setattr(search, "_search", lambda case, watch, seen: now.__setitem__(0, 2.9))
    watch = Deadline(9.0)
    case = SimpleNamespace(standing=SimpleNamespace(names=frozenset(), effects=()))
    assert search.search(case, watch) is None
    now[0] = 4.0
    watch.check()
    now[0] = 9.5
    with pytest.raises(TimeUp):
        watch.check()


def test_wherever_it_is_stopped_it_says_what_is_best_so_far(nominal, captures, steps):
    """The search is cut at ever later steps until it comes to its end; all that it names on the way is what is hidden.

    The search has a third of the time: where it is cut the rest of the time may do for a verdict, or not.
    """
    limit, verdicts, named, told = 2.0, [], [], {"not_looked_at": ["everything"]}
    while told["not_looked_at"]:
        found, told = stopped(nominal, captures, limit)
        verdicts.append(found.verdict)
        named.append([e.name for e in found.effects])
        assert told["not_looked_at"] == list(found.not_looked_at)
        text = "\n".join(diagnosis_lines(told))
        assert ("not looked at: " in text) == bool(found.not_looked_at)
        if found.verdict == "unfinished":
            assert any("stopped" in words or "the search ended" in words for words in found.not_looked_at)
            assert ("the time was over before" in text) == (not found.candidates)
            assert page_content([{"kind": "diagnose", **told}])
        if any("stopped" in words for words in found.not_looked_at):
            assert found.verdict == "unfinished"
            assert all(c.posterior is None for c in found.candidates)  # of sets that nobody fitted
            assert not found.effects or any("hold-out" in words for words in found.not_looked_at)
        elif found.not_looked_at:
            assert any("the search ended" in words for words in found.not_looked_at)
            assert found.verdict != "consistent"
            assert found.leftover or found.effects
            assert found.ladder
        limit *= 1.25
    assert named[-1] == [HIDDEN]
    assert named[0] == []
    assert [HIDDEN] in named[:-1]  # cut after the fit
    assert all(names in ([], [HIDDEN]) for names in named)
    assert len(verdicts) > 4


def test_where_the_search_is_cut_a_verdict_says_what_was_found_by_then(monkeypatch, nominal, captures, steps):
    """With time for all but a search: what stands is weighed and asked of the hold-out, and what is left over is told."""
    monkeypatch.setattr(search, "SEARCH", 1e-5)
    verdicts, named = [], []
    while "attributed" not in verdicts and "partial" not in verdicts:
        found, told = stopped(nominal, captures, 2000.0)
        verdicts.append(found.verdict)
        named.append([e.name for e in found.effects])
        assert found.ladder
        assert told["not_looked_at"][0].startswith("what more may be missing: the search ended while ")
        if not named[-1]:
            assert found.verdict == "unexplained"
            assert found.leftover
        assert "not looked at: " in "\n".join(diagnosis_lines(told))
        search.SEARCH *= 2
    assert named[0] == []
    assert named[-1] == [HIDDEN]
    assert all(names in ([], [HIDDEN]) for names in named)


def test_a_limit_that_is_no_time_is_refused(nominal, captures):
    with pytest.raises(InputError, match="limit_s is 0"):
        isetval.diagnose(nominal, captures, limit_s=0)
