"""The error budget: every part is large where it was planted and small where it was not."""

from dataclasses import replace

import numpy as np
import pytest

import isetval
from isetval.app.report.budget_parts import budget
from isetval.core.campaign import Campaign, Shot
from isetval.core.captures import MemoryCaptures
from isetval.core.scene import Patch, RenderedTarget, Spectrum
from isetval.core.sensor import Exposure
from isetval.core.toml import data_folder
from isetval.loop.error_budget import error_budget
from isetval.loop.prepared import prepare

RIM_PX = 4  # of a flat's window, darkened: a border that came into the picture


@pytest.fixture(scope="module")
def model():
    return isetval.load_model("isetval:pixel4a")


@pytest.fixture(scope="module")
def campaign(model):
    """Flats, edges and a repeated set-up, shot by the camera that the model describes."""
    plan = isetval.load_campaign(data_folder() / "demo" / "plan.toml")
    repeated = next(s for s in plan.shots if s.repeat_of and s.role == "flat")
    names = ["A_flat2", "A_flat4", "A_edge_center_v_z0", repeated.name, repeated.repeat_of]
    return isetval.simulate(model, plan.only(names), seed=11)


def _rows(comparison):
    return {row.family: row for row in comparison.budget}


def _shares(row):
    return (row.sampling, row.specimen, row.simulation, row.render, row.color, row.light)


def test_of_a_true_model_nothing_is_beyond_the_error_bars(model, campaign):
    rows = _rows(isetval.compare(model, campaign, regions=True))
    for row in rows.values():
        assert sum(_shares(row)) == pytest.approx(1)
        assert row.render == 0
    # means of squares of normal numbers: sd sqrt(2/n) of the mean, four of them; rows of one shot share their noise (n/4)
    for family in ("flat_mean", "mtf"):
        allowed = 4 * np.sqrt(2 / (rows[family].n / 4))
        assert rows[family].misfit < allowed
        assert abs(rows[family].region) < allowed
    assert rows["flat_mean"].repeat < 4 * np.sqrt(2 / 4)
    assert isetval.compare(model, campaign).budget[0].region is None  # not tried


def test_a_border_in_the_flats_shows_as_a_matter_of_regions(model, campaign):
    def with_rim(capture):
        above = capture.mosaic.astype(float) - 64
        rim = np.ones(above.shape, bool)
        rim[RIM_PX:-RIM_PX, RIM_PX:-RIM_PX] = False
        return replace(capture, mosaic=np.rint(64 + np.where(rim, 0.9, 1.0) * above).astype(np.uint16))

    flats = {s.name for s in campaign.shots if s.role == "flat"}
    captures = {s.name: [with_rim(c) if s.name in flats else c for c in campaign.captures.read(s.name)] for s in campaign.shots}
    rows = _rows(isetval.compare(model, replace(campaign, captures=MemoryCaptures(captures)), regions=True))
    before = _rows(isetval.compare(model, campaign, regions=True))
    for family in ("flat_mean", "flat_fixed_pixel_variance"):
        assert rows[family].region > 20 * max(abs(before[family].region), 0.1)
    assert rows["mtf"].region < 0.05 * rows["flat_mean"].region  # the edge has no border


@pytest.mark.parametrize("of_simulated", [0.5, 1.0, 2.0])
def test_shares_add_to_one_where_the_variance_is_not_the_simulated_one(model, campaign, of_simulated):
    """Rare counts have their own law in place of the simulated one, which may be narrower or wider."""
    with prepare(model, campaign.only(["A_flat2"])) as prepared:
        problem, fitted = prepared.settled(model)
        changed = replace(problem, covariance=of_simulated * problem.covariance)
        rows = error_budget(prepared, changed, fitted, None)
    for row in rows:
        assert sum(_shares(row)) == pytest.approx(1)
        assert min(_shares(row)) >= 0


def test_smaller_regions_are_simulated_once(model, campaign, monkeypatch, tmp_path):
    monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path))
    small = campaign.only(["A_flat2", "A_edge_center_v_z0"])
    told = ([], [])
    first, again = (
        isetval.compare(model, small, regions=True, progress=lambda words, done, total, own=own: own.append(words))
        for own in told
    )
    assert [any("smaller regions" in words for words in own) for own in told] == [True, False]
    assert again.budget == first.budget


def test_a_set_up_that_does_not_repeat_is_not_blamed_on_the_model(model, campaign):
    repeated = next(s for s in campaign.shots if s.repeat_of)
    plan = campaign.as_plan()
    brighter = replace(plan, shots=tuple(replace(s, light_level=1.3 * s.light_level) if s == repeated else s for s in plan.shots))
    shot = isetval.simulate(model, brighter, seed=11).captures.read(repeated.name)
    captures = MemoryCaptures({s.name: campaign.captures.read(s.name) for s in campaign.shots} | {repeated.name: shot})
    comparison = isetval.compare(model, replace(campaign, captures=captures))
    row = _rows(comparison)["flat_temporal_variance"]
    assert row.repeat > 20
    assert row.misfit < row.unexplained
    told = {r["family"]: r for r in budget(comparison.to_json())}
    assert told["flat temporal variance"]["helps"] == "set-ups that repeat better"


def _box(spp, seed):
    """A small rendered scene of which two patches are measured."""
    boxes = {"wall": (4, 20, 4, 28), "high": (4, 40, 36, 60)}
    camera, render = {"front": {"z_m": 0.4}}, {"spp": spp, "halo_px": 4, "bands": 5, "subsample": 1, "seed": seed}
    spec = {"kind": "cornell_box", "parameters": {"bounces": 3}, "camera": camera, "render": render}
    target = RenderedTarget("box", spec, tuple(Patch(name, box, Spectrum.flat(0.5)) for name, box in boxes.items()))
    return Shot("box", "scene", exposure=Exposure(0.002, 55), window=(1500, 2000, 48, 64), target=target)


@pytest.mark.mitsuba
def test_more_rays_lower_the_share_of_the_render(model):
    gains = []
    for seed in (1, 2, 3):
        shares = {}
        for spp in (16, 144):
            plan = Campaign("box", (_box(spp, seed),), sensor=model.sensor)
            comparison = isetval.compare(model, isetval.simulate(model, plan, 3))
            shares[spp] = float(np.mean([row.render / row.sampling for row in comparison.budget]))
        gains.append(shares[16] / shares[144])
    # nine times the rays: a ninth of the variance, known from a few draws to a factor of two; on the jittered grid of rays it
    # falls faster than their number (Mitchell, SIGGRAPH 1996), so that single seeds lie at 12 to 19
    assert 9 / 2 < float(np.exp(np.mean(np.log(gains)))) < 9 * 2
