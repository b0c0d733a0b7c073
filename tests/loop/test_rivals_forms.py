"""Rivals in the catalogue's forms: none wins by a freer form that the others were not asked for."""

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest

import isetval
from isetval.loop import search, shortlist
from isetval.loop.candidates import candidates_for
from isetval.loop.forms import other_forms

NOMINAL = Path(__file__).resolve().parents[2] / "data" / "pixel4a" / "camera.toml"

OWN = {"knee": -411.0, "bent": -430.4, "table": -470.0}  # ln(Z pi) of the trial that this is (a knee of .76 % at 2500 e-)
FREE = {"knee": -400.7, "bent": -407.6, "table": -469.0}


@dataclass(eq=False)
class Found:
    """A hypothesis of one effect: its name, ln(Z pi), the effect's class."""

    name: str
    value: float
    klass: str = ""

    @property
    def names(self):
        return frozenset({self.name})

    @property
    def members(self):
        return (SimpleNamespace(name=self.name, klass=self.klass or self.name),)

    @property
    def fitted(self):
        return SimpleNamespace(chi2=-2 * self.value)


def _forms_given(monkeypatch, fitted, in_best_form, nothing=-524.0):
    """What is known after hypotheses were put into the forms that ``in_best_form`` gives them."""
    monkeypatch.setattr(shortlist, "in_best_form", in_best_form)
    case = SimpleNamespace(known={f.names: f for f in fitted}, standing=Found("", nothing), score=lambda h: h.value)
    shortlist._give_forms(case, fitted, print)
    return case.known


@pytest.mark.parametrize(("seen", "wanted"), [({"bent"}, {"knee", "bent"}), ({"knee"}, {"knee"}), (set(), set())])
def test_what_a_freer_form_put_in_front_does_not_win_by_that(monkeypatch, seen, wanted):
    """What the knee leaves is too little to be seen, what the bent response leaves is not: only the latter was asked."""
    opened = set()

    def in_best_form(case, found, say, *, asked=False, left=False, lead=None):
        if not asked and found.name not in seen:
            return found
        opened.add(found.name)
        return Found(found.name, FREE[found.name])

    known = _forms_given(monkeypatch, [Found(name, value) for name, value in OWN.items()], in_best_form)
    assert opened == wanted
    assert max(known.values(), key=lambda h: h.value).name == "knee"


def test_a_rival_that_explains_nearly_as_much_is_asked_though_nothing_is_seen_in_what_it_leaves(monkeypatch):
    """A line asked for at the wrong place, behind filters that moved; one that explains less, or is hardly behind, is not."""
    asked = {}

    def in_best_form(case, found, say, *, left=False, lead=None):
        asked[found.name] = (left, lead)
        return found

    fitted = [Found("filters", -720.0), Found("close", -722.0), Found("line", -738.0), Found("gain", -780.0)]
    _forms_given(monkeypatch, fitted, in_best_form, nothing=-940.0)
    assert asked == {"filters": (False, -720.0), "close": (False, -720.0), "line": (True, -738.0), "gain": (False, -720.0)}


def test_of_forms_of_one_class_the_best_alone_is_asked_for_a_freer_one(monkeypatch):
    """The curve of a line that was asked for at the other end of the spectrum took most of the search's time."""
    asked = []

    def in_best_form(case, found, say, **how):
        asked.append(found.name)
        return found

    fitted = [Found("line at 586", -700.0, "line"), Found("filters", -720.0), Found("line at 436", -770.0, "line")]
    _forms_given(monkeypatch, fitted, in_best_form, nothing=-940.0)
    assert asked == ["line at 586", "filters"]


class Standing:
    """A hypothesis by its names, its log evidence and what the hold-out says of it."""

    def __init__(self, names, log_evidence, word=0.0):
        self.names, self.log_evidence, self.word = frozenset(names), log_evidence, word
        self.members = self.effects = tuple(sorted(names))
        self.fitted = object()


@pytest.mark.parametrize(
    ("curve", "of_what", "wanted"),
    [
        ((-5.0, 16.0), "fall-off", "curve"),  # as likely as the name in both sessions together: no second name
        ((-5.0, 4.0), "fall-off", "name"),  # the second session denies the curve
        ((-5.0, 16.0), "light", "curve"),  # a close rival of what stands bends in its place
        (None, "fall-off", "name"),
    ],
)
def test_a_curve_and_a_further_name_are_both_asked_of_the_hold_out(monkeypatch, curve, of_what, wanted):
    """Of a fall-off linear in the radius a shadow in one window had the hold-out's word; the curve that says as much had none."""
    stands, rival = Standing({"fall-off"}, 0.0), Standing({"light"}, -2.0)
    named = Standing({"fall-off", "dust"}, 4.0, word=15.0)
    shaped = None if curve is None else Standing({of_what}, *curve)
    case = SimpleNamespace(
        standing=stands,
        known={h.names: h for h in (stands, rival, named)},
        rough=set(),
        score=lambda h: h.log_evidence,
        log_prior=lambda members: -9.0 * (len(members) - 1),
    )

    def in_best_form(case, found, say, *, asked, heard):
        return shaped if asked and shaped is not None and shaped.names == found.names else found

    monkeypatch.setattr(search, "in_best_form", in_best_form)
    monkeypatch.setattr(search, "said", lambda case, asked: [h.word for h in asked])
    assert search._form_before_name(case, named, print) is (shaped if wanted == "curve" else named)
    # the same of two names in the place of one: of a shifted fall-off a shadow beside a light's tilt had 41 more in chi2
    exchanged = Standing({"light", "dust"}, 4.0, word=15.0)
    case.known[exchanged.names] = exchanged
    assert search._form_before_name(case, exchanged, print) is (shaped if wanted == "curve" else exchanged)


def test_a_named_effects_forms_show_its_own_first_and_by_name():
    """A line of one lamp is no line of all: both were called 545, and the first of the catalogue stood for what was named."""
    model = isetval.load_model(NOMINAL)
    forms = [c for c in candidates_for(model, ("sky", "tube")) if c.klass == "spd_mismatch"]
    logs = {"spd_mismatch": 3.0, "spd_mismatch (tube)": 20.0, "spd_mismatch (spike_nm 611, tube)": 21.0}
    rows = [SimpleNamespace(name=c.name, log_evidence=logs.get(c.name, 0.0)) for c in forms]
    named = next(c for c in forms if c.name == "spd_mismatch (tube)")
    told = other_forms(SimpleNamespace(rows=rows, candidates=forms), named)
    assert [row.form for row in told[:3]] == ["spike_nm 545, tube", "spike_nm 611, tube", "spike_nm 545"]
    assert [row.log_evidence for row in told[:3]] == [20.0, 21.0, 3.0]
