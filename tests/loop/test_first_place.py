"""Where the fit of another model to the same captures starts: where the nominal model's ended, unless that was led astray."""

import pytest

import isetval
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.scene import Spectrum
from isetval.core.sensor import Exposure
from isetval.loop import other_focus
from isetval.loop import prepared as of_prepared
from isetval.loop.derivatives import nuisance_parameters
from isetval.loop.fit import fit
from isetval.loop.prediction import Point
from isetval.loop.prepared import prepare

PRIOR = 0.02


def campaign(model, light):
    """Two flats of one lamp whose level stands ``light`` prior sigmas off what is stated."""
    lamp = Light("lamp", Spectrum.flat(0.004))
    shots = tuple(
        Shot(f"flat {t:g}", "flat", exposure=Exposure(t), frames=3, light="lamp", window=(1464, 1968, 48, 48))
        for t in (0.004, 0.01)
    )
    priors = (Nuisance("light_level", PRIOR, "relative", "measurement session"),)
    plan = Campaign("p", shots, lights={"lamp": lamp}, nuisances=priors, sensor=model.sensor)
    (label,) = (p.label for p in plan.unknowns())
    return isetval.simulate(model, plan, 1, values={label: light * PRIOR}), label


@pytest.mark.parametrize(("light", "there"), [(1.5, True), (5.0, False)])
def test_the_fit_of_another_model_starts_where_the_nominal_one_ended(model, monkeypatch, light, there):
    captures, label = campaign(model, light)
    starts = []

    def watched(problem, start, free, **how):
        starts.append(start.values.get(label, 0.0))
        return fit(problem, start, free, **how)

    for module in (of_prepared, other_focus):
        monkeypatch.setattr(module, "fit", watched)
    with prepare(model, captures) as prepared:
        nominal = prepared.fit_nuisances(model)
        other = model.with_values({"conversion_gain.gain_dn_per_e": 1.01 * model.value("conversion_gain.gain_dn_per_e")})
        found = prepared.fit_nuisances(other)
        problem = prepared.problem_for(other)
        anew = fit(problem, Point(other), nuisance_parameters(problem.plan, other))
    assert nominal.value(label)[0] == pytest.approx(light * PRIOR, rel=0.1)
    assert starts == [0.0, nominal.value(label)[0] if there else 0.0]
    assert found.value(label)[0] == pytest.approx(anew.value(label)[0], abs=0.1 * anew.value(label)[1])
    assert found.chi2 == pytest.approx(anew.chi2, rel=0.02)
