"""An effect named first because it answered for two gives way once the second is in the model."""

from types import SimpleNamespace

import numpy as np
import pytest

import isetval
from isetval.core.campaign import Campaign
from isetval.loop.candidates import Signature, candidates_for
from isetval.loop.evidence import log_hessian, refit
from isetval.loop.fit import fit
from isetval.loop.investigation import Investigation
from isetval.loop.prediction import Base, Point
from isetval.loop.problem import Problem
from isetval.loop.replacement import swap
from isetval.loop.score_test import make_frame, score

ROWS = 6
MIXED = np.array([1.0, 1.0, 0.5, 0, 0, 0]) / 1.5
COLUMNS = {
    "dark_current.rate_e_per_s": np.eye(ROWS)[0],
    "temporal_row_noise.sigma_dn": np.eye(ROWS)[1],
    "black_level.offset_dn": MIXED,
}
UNIT = 0.01  # parameter units per sigma: well within every prior


class LinearCamera:
    """Metrics that are linear in three parameters: predictions in closed form."""

    def __init__(self, plan, nominal):
        self.plan, self.nominal = plan, nominal
        self.table = SimpleNamespace(metrics=())

    def derivative_vectors(self, points, seeds, of_noise=False):
        return [
            sum((self.offset(p.model, key) / UNIT * column for key, column in COLUMNS.items()), np.zeros(ROWS)) for p in points
        ]

    def offset(self, model, key):
        name = key.split(".")[0]
        standing = self.nominal.value(key) if self.nominal.effect(name) is not None else 0.0
        return (model.value(key) if model.effect(name) is not None else standing) - standing


@pytest.fixture
def case():
    model = isetval.load_model(isetval_data() / "camera.toml")
    wanted = {c.name: c for c in candidates_for(model)}
    chosen = [wanted[key.split(".")[0]] for key in COLUMNS]
    plan = Campaign("plan", ())
    measured = 10.0 * np.eye(ROWS)[0] + 6.0 * np.eye(ROWS)[1]
    base = Base(np.zeros(ROWS), np.eye(ROWS), np.zeros((16, ROWS)), np.ones(ROWS))
    problem = Problem(
        LinearCamera(plan, model), Point(model), base, measured, np.arange(ROWS), np.eye(ROWS), np.zeros(ROWS), np.eye(ROWS)
    )
    fitted = fit(problem, Point(model), ())
    signatures = {
        c.name: Signature(c, (column / UNIT)[:, None], np.array([UNIT]))
        for c, column in zip(chosen, COLUMNS.values(), strict=True)
    }
    prepared = SimpleNamespace(model=model)
    return Investigation(prepared, None, problem, fitted, tuple(chosen), signatures, make_frame(fitted))


def isetval_data():
    from isetval.core.toml import data_folder

    return data_folder() / "pixel4a"


def name(case, candidate):
    """Name an effect as the detective does, with all others as the beaten ones."""
    frame = make_frame(case.fitted)
    taken = [r.candidate.name for r in case.named]
    refits = {
        c.name: refit(
            case.problem,
            case.fitted,
            c,
            signature=case.signatures[c.name],
            found=score(frame, case.signatures[c.name].columns),
            null_hessian=log_hessian(case.fitted),
        )
        for c in case.candidates
        if c.name not in taken
    }
    best = refits.pop(candidate)
    case.named.append(best)
    case.runners_up.append(tuple(refits.values()))
    case.equivalent.append(())
    case.rivals.append(())
    case.named_posteriors.append((0.9, 0.9, 0.9))
    case.fitted = best.fitted


def test_the_true_pair_replaces_the_effect_that_answered_for_both(case):
    name(case, "black_level")
    name(case, "temporal_row_noise")
    assert case.fitted.chi2 > 15  # 20 in closed form, less what the priors give
    assert swap(case, lambda _: None)
    assert [r.candidate.name for r in case.named] == ["dark_current", "temporal_row_noise"]
    assert case.fitted.value("dark_current.rate_e_per_s")[0] == pytest.approx(
        case.prepared.model.value("dark_current.rate_e_per_s") + 10 * UNIT, abs=UNIT
    )
    assert case.fitted.chi2 < 5
    assert "gave way" in case.remarks[0]


def test_a_true_first_name_stays(case):
    name(case, "dark_current")
    name(case, "temporal_row_noise")
    assert not swap(case, lambda _: None)
    assert [r.candidate.name for r in case.named] == ["dark_current", "temporal_row_noise"]
