"""Rivals in the catalogue's forms: none wins by a freer form that the others were not asked for."""

from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from isetval.loop import shortlist

OWN = {"knee": -411.0, "bent": -430.4, "table": -470.0}  # ln(Z pi) of the trial that this is (a knee of .76 % at 2500 e-)
FREE = {"knee": -400.7, "bent": -407.6, "table": -469.0}


@dataclass(eq=False)
class Found:
    name: str
    value: float
    members: tuple = ()

    @property
    def names(self):
        return frozenset({self.name})


@pytest.mark.parametrize(("seen", "wanted"), [({"bent"}, {"knee", "bent"}), ({"knee"}, {"knee"}), (set(), set())])
def test_what_a_freer_form_put_in_front_does_not_win_by_that(monkeypatch, seen, wanted):
    """What the knee leaves is too little to be seen, what the bent response leaves is not: only the latter was asked."""
    opened = set()

    def in_best_form(case, found, say, *, asked=False, lead=None):
        if not asked and found.name not in seen:
            return found
        opened.add(found.name)
        return Found(found.name, FREE[found.name])

    monkeypatch.setattr(shortlist, "in_best_form", in_best_form)
    fitted = [Found(name, value) for name, value in OWN.items()]
    case = SimpleNamespace(known={f.names: f for f in fitted}, standing=Found("", -524.0), score=lambda h: h.value)
    shortlist._give_forms(case, fitted, print)
    assert opened == wanted
    best = max(case.known.values(), key=case.score)
    assert best.name == "knee"
