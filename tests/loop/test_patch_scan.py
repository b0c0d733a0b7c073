"""An effect of one patch of a chart: which it is, from what the effect does to all of them."""

from dataclasses import replace

import numpy as np
import pytest

from isetval import load_campaign, load_model, simulate
from isetval.core.toml import data_folder
from isetval.effects.scene_light import Fluorescence
from isetval.loop.candidates import candidates_for
from isetval.loop.detective import _scanned
from isetval.loop.evidence import hypothesis
from isetval.loop.prediction import Point
from isetval.loop.prepared import prepare
from isetval.loop.score_test import make_frame
from isetval.loop.signatures import signatures
from isetval.testing.foreign_camera import campaign as foreign

SHOTS = ("A_chart_mid_tube", "A_chart_side_tube")


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    folder = tmp_path_factory.mktemp("white") / "plan"
    foreign.write_campaign(folder, data_folder() / "pixel4a", seed=3, sessions=("A",), kind="full", draw=False)
    plan = load_campaign(folder).as_plan()
    return load_model(folder / "camera.toml"), replace(plan, shots=tuple(s for s in plan.shots if s.name in SHOTS))


@pytest.fixture
def scanned(plan):
    """scanned(effect) -> the further forms that are asked for when a camera with it shoots two charts, and their signatures."""
    model, shots = plan

    def found(effect):
        true = model if effect is None else model.add(effect)
        with prepare(model, simulate(true, shots, seed=5)) as prepared:
            problem, fitted = prepared.settled(model)
            wanted = [c for c in candidates_for(model) if c.klass in ("fluorescence", "spd_mismatch", "spectral_crosstalk")]
            frame = make_frame(fitted)
            made = signatures(problem, Point(model, {}), wanted, project=frame.basis[: frame.rows])
            return problem, _scanned(problem, hypothesis(problem, (), fitted), frame, made), made

    return found


def test_paper_with_a_brightener_beside_others_without_is_found(scanned, plan):
    """Of one patch of 24 the form of all of them was a wrong spectrum."""
    patches = [p.name for p in plan[1].shots[0].target.patches]
    problem, (form,), made = scanned(Fluorescence(emission=0.2, patch=patches[18]))
    assert form.name == f"fluorescence (patch {patches[18]})"
    assert form.klass == "fluorescence"
    assert form.prior_weight == pytest.approx(1 / len(patches))
    # its rows are those of the effect simulated in full
    whole = next(s for s in made if s.candidate.name == "fluorescence")
    (own,) = signatures(problem, Point(problem.nominal, {}), [form], project=np.zeros((problem.keep.size, 0)))
    of_patch = np.array([m.patch == patches[18] for m in problem.predictor.table.metrics])
    np.testing.assert_allclose(own.columns[of_patch], whole.columns[of_patch], rtol=0.02, atol=1e-6)


@pytest.mark.parametrize("effect", [None, Fluorescence(emission=0.02)])
def test_no_patch_is_asked_for_where_none_glows_or_all_do(scanned, effect):
    assert scanned(effect)[1] == []
