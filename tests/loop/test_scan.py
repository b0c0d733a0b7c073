"""Shapes with many valleys: the order of a plate, from what metrics do with narrow bands of light."""

from dataclasses import replace

import numpy as np
import pytest

from isetval import load_campaign, load_model, simulate
from isetval.core.toml import data_folder
from isetval.effects.color import ChannelGain
from isetval.effects.optics_field import EtalonRipple
from isetval.loop.candidates import candidates_for
from isetval.loop.detective import _scanned
from isetval.loop.evidence import hypothesis
from isetval.loop.prediction import Point
from isetval.loop.prepared import prepare
from isetval.loop.scan import band_responses, best_place, columns_of
from isetval.loop.score_test import make_frame
from isetval.loop.signatures import signatures
from isetval.testing.foreign_camera import campaign as foreign

ORDER = 21.8  # of 4 um of glass
SHOTS = ("A_chart_mid_tube", "A_chart_side_tube", "A_flat4", "A_field01", "A_field02", "A_field05", "A_field09")


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """A chart in the lines of a lamp and three flats, behind a plate and a darker red filter: problem, fit and signatures."""
    folder = tmp_path_factory.mktemp("plate")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ISETVAL_CACHE", str(folder / "cache"))
        foreign.write_campaign(folder / "plan", data_folder() / "pixel4a", seed=3, sessions=("A",), kind="full", draw=False)
        plan, model = load_campaign(folder / "plan").as_plan(), load_model(folder / "plan" / "camera.toml")
        plan = replace(plan, shots=tuple(s for s in plan.shots if s.name in SHOTS))
        true = model.add(EtalonRipple(amplitude=-0.009, quadrature=0.012, order_550=ORDER)).add(ChannelGain(d_red=-0.05))
        with prepare(model, simulate(true, plan, seed=5)) as prepared:
            problem, fitted = prepared.settled(model)
            wanted = [c for c in candidates_for(model) if c.klass in ("etalon_ripple", "channel_gain")]
            frame = make_frame(fitted)
            made = signatures(problem, Point(model, {}), wanted, project=frame.basis[: frame.rows])
            yield problem, hypothesis(problem, (), fitted), frame, made


def test_narrow_bands_add_up_to_the_ripple(case):
    """Columns from 73 responses against those of the effect simulated in full, at the forms that are asked for anyhow."""
    problem, _, _, made = case
    responses = band_responses(problem)
    plates = [s for s in made if s.candidate.klass == "etalon_ripple"]
    assert len(plates) == 2
    for plate in plates:
        added = columns_of(problem, EtalonRipple.scan, plate.candidate.effect, ["amplitude", "quadrature"], responses)
        for ours, theirs in zip(problem.whitened(added).T, problem.whitened(plate.columns).T, strict=True):
            assert np.linalg.norm(ours - theirs) < 0.02 * np.linalg.norm(theirs)


def test_the_order_is_found_beside_another_effect(case):
    """Alone, another order answers for the darker filter, too."""
    problem, nothing, frame, made = case
    (found,) = _scanned(problem, nothing, frame, made)
    assert found.effect.order_550 == pytest.approx(ORDER, abs=0.15)
    assert found.prior_weight == 1 / 51
    assert found.klass == "etalon_ripple"
    alone = best_place(problem, nothing, [s for s in made if s.candidate.klass == "etalon_ripple"], "etalon_ripple")
    assert alone.effect.order_550 != pytest.approx(ORDER, abs=0.3)


def test_no_order_is_looked_for_where_no_form_shows_anything(case):
    problem, nothing, frame, made = case
    quiet = replace(frame, z=0.0 * frame.z)
    assert _scanned(problem, nothing, quiet, made) == []
