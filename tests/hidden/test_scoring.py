"""How trials are drawn, judged, summed up and taken up again after a stop."""

import json
import sys
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

ANALYSES = Path(__file__).resolve().parents[2] / "analyses"
sys.path.insert(0, str(ANALYSES))

import hidden_effects  # noqa: E402
from hidden_trials import draw  # noqa: E402
from hidden_trials.calibrate import common_square, error_of_common_square, law_from  # noqa: E402
from hidden_trials.judge import judged  # noqa: E402
from hidden_trials.nearest import tells_apart  # noqa: E402
from hidden_trials.own_signature import along_signatures  # noqa: E402
from hidden_trials.run import changes_bits  # noqa: E402
from hidden_trials.summary import interval, summary, table_lines  # noqa: E402

from isetval.testing.foreign_camera import strengths  # noqa: E402
from isetval.testing.foreign_camera.strengths import ALL  # noqa: E402


def test_five_hundred_trials_hold_what_the_issue_asks_for():
    drawn = draw.trials(500, seeds="scoring", plan="small")
    counts = Counter(t.kind for t in drawn)
    assert counts == {"null": 150, "single": 200, "pair": 50, "form": 50, "outsider": 50}
    assert Counter(t.level for t in drawn if t.kind == "single") == dict.fromkeys((3.0, 5.0, 8.0, 15.0, "practice"), 40)
    assert len({t.seed for t in drawn}) == 500
    assert {t.seed for t in drawn}.isdisjoint(t.seed for t in draw.trials(500, seeds="development", plan="small"))
    assert {t.lens for t in drawn} == {"open", "stopped"}
    # set strengths are those at which the effect stands out by so many sigmas
    assert all(s == pytest.approx(t.level, abs=0.01) for t in drawn if isinstance(t.level, float) for s in t.expected_s)
    assert all(len({tr["name"] for tr in t.truths}) == 2 for t in drawn if t.kind == "pair")


def test_what_a_signature_sees_of_an_effect_is_what_specimens_have_in_common_along_it():
    """Two of three sigmas along the second form of its name, the noise of each specimen in none of the directions that count."""
    effect = np.array([2.0, 0.0, 1.0, 2.0, 0.0, 0.0, 0.0])
    parts = [effect + 5 * np.eye(7)[4 + i] for i in range(3)]
    bases = {name: np.eye(7)[:, [i]] for name, i in (("coma", 2), ("dust", 1), ("dust (x0 1)", 0), ("blooming", 4))}
    dust = ALL["dust"]
    assert along_signatures(parts, bases, dust) == {"s": 3.0, "own": 2.0, "nearest": "coma", "nearest_s": 1.0}


def test_stored_strengths_are_restated_by_the_laws_of_now():
    """Of a pattern half as deep a quarter shows, its variance; laws that stand say again what is stored."""
    drawn = [t.row() for t in draw.trials(300, seeds="scoring", plan="small")]
    for row in drawn:
        assert draw.restated_s(row) == pytest.approx(row["expected_s"], rel=2e-3)
    row = next(r for r in drawn if "row_bands" in r["hidden"] and r["level"] == 15.0)
    half = row | {"hidden": {"row_bands": {"depth": row["hidden"]["row_bands"]["depth"] / 2}}}
    assert draw.restated_s(half) == pytest.approx([15 / 4], rel=1e-2)


@pytest.mark.parametrize(
    ("key", "nothing_to", "law_holds_from"),
    [("linearization_table", 6.0, 8.0), ("position_scale", 60.0, np.inf), ("vignetting", 0, 0)],
)
def test_codes_and_places_that_stay_what_they_are_end_a_law(key, nothing_to, law_holds_from):
    """Below some strength a table bends no code by half of one, and a place is rounded to that it has."""
    of = lambda strength: np.array([216.0 * strength * (216.0 * strength > nothing_to)])  # noqa: E731
    own = SimpleNamespace(differences=lambda concealed, strength: [of(strength)] * 3)
    assert law_from(own, ALL[key], 216.0) == law_holds_from


def test_noise_denies_no_law():
    """Noise that a change of the light draws anew is as long as the effect itself at few sigmas: only what is clear counts."""
    rng = np.random.default_rng(3)

    def differences(concealed, strength, noise=1.4):
        return [np.r_[size * strength, np.zeros(1699)] + noise * rng.standard_normal(1700) for _ in range(3)]

    size = 216.0
    own = SimpleNamespace(differences=differences)
    assert [law_from(own, ALL["spd_mismatch"], 216.0) for _ in range(20)].count(0.0) >= 18
    products = np.array([common_square(differences(None, 5 / size)) for _ in range(400)])
    stated = error_of_common_square(differences(None, 5 / size))
    assert np.std(products) == pytest.approx(stated, rel=0.2)


def test_a_trial_hides_nothing_below_where_its_law_begins(monkeypatch):
    gain, plan = ALL["digital_gain"], "full/open"
    known = strengths.measured_strengths()
    begun = known | {strengths.LAW_FROM: {plan: {gain.key: 8.0}}}
    monkeypatch.setattr(strengths, "measured_strengths", lambda: begun)
    assert strengths.strength_for(gain, 5.0, "full", "open") is None
    strength = strengths.strength_for(gain, 8.0, "full", "open")
    assert strength == pytest.approx((8 / known[plan][gain.key]) ** (1 / gain.power))
    assert draw._expected(gain, strength, "full", "open") == 8.0
    assert draw._expected(gain, 0.9 * strength, "full", "open") is None


def test_what_follows_no_law_is_hidden_as_met_in_practice_only(monkeypatch):
    gain, plan = ALL["digital_gain"], "full/open"
    known = strengths.measured_strengths()
    assert strengths.strength_for(gain, 8.0, "full", "open") == pytest.approx((8 / known[plan][gain.key]) ** (1 / gain.power))
    lawless = known | {strengths.WITHOUT_LAW: {plan: {gain.key: "whole codes are rounded anew"}}}
    monkeypatch.setattr(strengths, "measured_strengths", lambda: lawless)
    monkeypatch.setattr(draw, "measured_strengths", lambda: lawless)
    assert strengths.strength_for(gain, 8.0, "full", "open") is None
    assert not draw._can(gain, 8.0, "full", "open")
    assert draw._can(gain, "practice", "full", "open")
    assert draw._expected(gain, 1.0, "full", "open") == pytest.approx(known[plan][gain.key], abs=0.01)


def test_an_effect_is_made_by_its_name_or_by_the_id_that_it_has_in_the_rows():
    by_name, by_id = draw.named("diffraction", plan="edges"), draw.named("edges-diffraction", plan="small")
    assert by_name == by_id
    assert by_id.id == "edges-diffraction"
    assert draw.named("small-scoring-0003", plan="full") == draw.trial(3, seeds="scoring", plan="small")


@pytest.mark.parametrize("text", ["nonsense", "full-nonsense", "small-scoring", "small-scoring-x", "small-foo-3"])
def test_what_is_no_trial_is_said_so(text):
    with pytest.raises(SystemExit, match=f"{text}: neither an effect"):
        draw.named(text, plan="edges")


def test_a_folder_that_is_there_is_left_alone(tmp_path):
    mine = tmp_path / "mine.txt"
    mine.write_text("a campaign of mine")
    with pytest.raises(SystemExit, match="there already"):
        hidden_effects.main(["--make", "edges-diffraction", str(tmp_path)])
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


def _row(kind, truths, verdict, effects, **more):
    named = [
        {"name": n, "posterior": p, "equivalent": list(same), "parameters": {"x": {"value": 3.0, "sigma": 0.5}}}
        for n, p, same in effects
    ]
    answer = {"verdict": verdict, "effects": named, "candidates": [], "leftover": None, "ladder": []}
    base = {"id": "t", "kind": kind, "level": 8.0, "hidden": {name: {} for name in truths}, "expected_s": [8.0] * len(truths)}
    base |= {"lens": "open", "other_specimen": False, "cpu_s": 1.0, "error": None, "answer": answer}
    return base | {"truths": [{"name": n, "also": ["b2"] if n == "b" else [], "values": {"x": 2.0}} for n in truths]} | more


@pytest.mark.parametrize(
    ("kind", "truths", "verdict", "effects", "outcome", "right"),
    [
        ("null", [], "consistent", [], "consistent", True),
        ("null", [], "attributed", [("a", 0.98, ())], "named", False),
        ("null", [], "unexplained", [], "flagged", False),
        ("single", ["a"], "attributed", [("a", 0.98, ())], "right", True),
        ("single", ["a"], "ambiguous", [("c", 0.6, ("a",))], "right", True),
        ("single", ["b"], "attributed", [("b2", 0.9, ())], "right", True),
        ("single", ["a"], "attributed", [("c", 0.98, ())], "named wrongly", False),
        ("single", ["a"], "attributed", [("a", 0.98, ()), ("c", 0.9, ())], "right and more", False),
        ("single", ["a"], "consistent", [], "not seen", False),
        ("single", ["a"], "unexplained", [], "flagged without a name", False),
        ("pair", ["a", "b"], "attributed", [("b", 0.9, ()), ("a", 0.9, ())], "right", True),
        ("pair", ["a", "b"], "attributed", [("b", 0.9, ())], "one of two", False),
        ("outsider", [""], "partial", [("c", 0.9, ())], "flagged", True),
        ("outsider", [""], "attributed", [("c", 0.9, ())], "named without a flag", False),
        ("outsider", [""], "consistent", [], "not seen", False),
    ],
)
def test_answers_are_held_against_the_truth(kind, truths, verdict, effects, outcome, right):
    found = judged(_row(kind, truths, verdict, effects))
    assert (found["outcome"], found["right"]) == (outcome, right)


def test_an_answer_that_did_not_come_is_wrong_and_says_why():
    row = _row("single", ["a"], "attributed", []) | {"answer": None, "error": "not done within 3 s"}
    assert not judged(row)["right"]
    assert judged(row)["why"] == "not done within 3 s"
    stopped = _row("single", ["a"], "unfinished", [("a", 0.98, ())])
    stopped["answer"]["not_looked_at"] = ["all that comes after 3 s"]
    assert (judged(stopped)["outcome"], judged(stopped)["why"]) == ("no answer", "all that comes after 3 s")
    found = summary([(row, judged(row))])
    detection = next(t for t in found["targets"] if t["what"] == "detection at s = 8")
    assert (detection["k"], detection["n"]) == (0, 1)


def test_pulls_are_of_effects_named_by_their_own_name():
    found = judged(_row("single", ["a"], "attributed", [("a", 0.98, ())]))
    assert found["pulls"] == {"a.x": pytest.approx((3.0 - 2.0) / 0.5)}
    assert judged(_row("single", ["b"], "attributed", [("b2", 0.98, ())]))["pulls"] == {}


def test_intervals_are_wilsons():
    """Wilson 1927: none of n gives z^2/(n + z^2) as the upper end; halves are symmetric."""
    assert interval(0, 150) == (0.0, pytest.approx(1.96**2 / (150 + 1.96**2)))
    low, high = interval(10, 20)
    assert low + high == pytest.approx(1.0)
    for k, n in ((k, total) for total in range(1, 60) for k in range(total + 1)):
        low, high = interval(k, n)
        assert 0 <= low <= k / n <= high <= 1  # a bar of an interval has no negative length, by rounding neither


def test_sums_and_table_hold_all_kinds():
    rows = [
        _row("null", [], "consistent", []),
        _row("single", ["a"], "attributed", [("a", 0.995, ())]),
        _row("single", ["a"], "attributed", [("c", 0.97, ())]),
    ]
    found = summary([(r, judged(r)) for r in rows])
    assert [b["share"] for b in found["reliability"]["bins"]] == [0.0, 1.0]
    assert found["reliability"]["brier"] == pytest.approx((0.005**2 + 0.97**2) / 2)
    assert {"hidden": "a", "said": "c", "n": 1} in found["confusion"]
    assert [w["outcome"] for w in found["wrong"]] == ["named wrongly"]
    assert any("false attribution on nulls" in line and "0.0 %" in line for line in table_lines(found))


def test_a_run_is_taken_up_where_it_stopped(tmp_path, capsys):
    """A trial over its time leaves a row that says so; the next run leaves done ones alone and passes over half a line."""
    words = ["--n", "1", "--plan", "small", "--kinds", "null", "--seeds", "development", "--limit-s", "0.3"]
    words += ["--rows", str(tmp_path / "rows.jsonl"), "--report", str(tmp_path / "page.html")]
    assert hidden_effects.main(words) == 0
    first = (tmp_path / "rows.jsonl").read_text()
    assert json.loads(first)["error"] == "not done within 0.3 s"
    assert len(json.loads(first)["commit"].rstrip("+")) == 12
    with pytest.raises(SystemExit, match="--resume"):
        hidden_effects.main(words)
    (tmp_path / "rows.jsonl").write_text(first + '{"id": "half')
    assert hidden_effects.main([*words, "--resume"]) == 0
    assert "1 trials, 1 of them done" in capsys.readouterr().out
    assert hidden_effects.main(["--table", "--report", str(tmp_path / "page.html")]) == 0
    assert "nulls answered" in capsys.readouterr().out
    assert "Every wrong answer" in (tmp_path / "page.html").read_text()


@pytest.mark.parametrize(("log", "changes"), [(0.0023, False), (0.02, True)])
@pytest.mark.parametrize("beside", [{}, {"black_level": {"offset_dn": 0.5}}])
def test_an_effect_without_a_changed_bit_is_known_as_such(log, changes, beside):
    """A converter table that moves no code by a half, and one that moves some by two; beside one that moves most of them."""
    row = {"plan": "small", "lens": "open", "seed": 3, "hidden": {"linearization_table": {"log": log}, **beside}}
    assert changes_bits(row) is changes


def test_what_specimens_have_in_common_holds_no_noise_of_each():
    """Three vectors of length 20 along one direction, in noise whose own length is 30."""
    rng, common = np.random.default_rng(3), 20.0 * np.eye(900)[0]
    found = [common_square([common + rng.normal(size=900) for _ in range(3)]) for _ in range(50)]
    assert np.mean(found) == pytest.approx(400.0, abs=4 * np.std(found) / np.sqrt(50))
    assert np.std(found) < 60


def test_a_stranger_is_asked_for_where_the_plan_tells_it_from_every_effect(tmp_path):
    stored = tmp_path / "nearest.json"
    stored.write_text(json.dumps({"small/open": {"twin": {"left": 0.1}, "stranger": {"left": 0.7}}}), encoding="utf-8")
    row = {"plan": "small", "lens": "open", "hidden": {"stranger": {}}, "expected_s": [8.0]}
    assert tells_apart(row, path=stored)
    assert not tells_apart(row | {"expected_s": [7.0]}, path=stored)
    assert not tells_apart(row | {"hidden": {"twin": {}}}, path=stored)
    assert tells_apart(row | {"plan": "full"}, path=stored) is None  # never measured
