"""Every diagnosis ends: at its time limit it says the best statement so far, and what it did not look at."""

from itertools import count

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
from isetval.loop import telling
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


def test_wherever_it_is_stopped_it_says_what_is_best_so_far(nominal, captures, steps):
    """The search is cut at ever later steps until it comes to its end; all that it names on the way is what is hidden."""
    limit, verdicts, named = 2.0, [], []
    while not verdicts or verdicts[-1] == "unfinished":
        found, told = stopped(nominal, captures, limit)
        verdicts.append(found.verdict)
        named.append([e.name for e in found.effects])
        if found.verdict == "unfinished":
            assert any("stopped" in words for words in found.not_looked_at)
            assert told["not_looked_at"] == list(found.not_looked_at)
            assert all(c.posterior is None for c in found.candidates)  # of sets that nobody fitted
            assert not found.effects or any("hold-out" in words for words in found.not_looked_at)
            text = "\n".join(diagnosis_lines(told))
            assert "not looked at: " in text
            assert ("the time was over before" in text) == (not found.candidates)
            assert page_content([{"kind": "diagnose", **told}])
        limit *= 1.25
    assert named[-1] == [HIDDEN]
    assert named[0] == []
    assert [HIDDEN] in named[:-1]  # cut after the fit, before the hold-out and the ladder
    assert all(names in ([], [HIDDEN]) for names in named)
    assert len(verdicts) > 4


def test_a_limit_that_is_no_time_is_refused(nominal, captures):
    with pytest.raises(InputError, match="limit_s is 0"):
        isetval.diagnose(nominal, captures, limit_s=0)
