"""The laboratories' own pictures, where they are present: what campaign init finds in them, and published numbers."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import isetval

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))
REAL = ROOT.parent / "shared" / "data" / "real"


def _present(name):
    return pytest.mark.skipif(not (REAL / name).exists(), reason=f"the pictures of {name} are not here: {REAL}")


@pytest.mark.slow
@_present("flea3")
def test_the_machine_vision_folder_becomes_two_campaigns_without_an_editor(tmp_path):
    from analyses.flea3 import lens, levels
    from analyses.flea3.common import laboratory

    lab = laboratory(REAL / "flea3", tmp_path)
    assert sum(len(s.files) for s in (*lab.charts.shots, *lab.disks.shots)) == 90
    assert {s.role for s in lab.charts.shots} == {s.role for s in lab.disks.shots} == {"chart", "dark"}
    assert len([s for s in lab.charts.shots if s.role == "chart"]) == len([s for s in lab.disks.shots if s.role == "chart"]) == 35
    lines = {name: levels.linearity(levels.rows_of(part)) for name, part in (("charts", lab.charts), ("disks", lab.disks))}
    a, b = (lines[name]["offset_dn"] for name in ("charts", "disks"))
    assert abs(a[0] - b[0]) < 4 * np.hypot(a[1], b[1])  # one camera, two visits
    assert all(line["offset_dn"][0] < -5 * line["offset_dn"][1] for line in lines.values())
    growth = {band["light"]: band.get("radial_px", 0.0) for band in lens.color_errors(lab.disks)["bands"]}
    assert growth["700nm"] > growth["650nm"] > 1.0  # a lens without achromatic correction in the red


@_present("emva1288_set001")
def test_pattern_of_the_stacks_is_the_published_one():
    from analyses.emva1288_set001 import PUBLISHED, stack_rows

    campaign = isetval.load_campaign(REAL / "emva1288_set001")
    stacks = {s.role: campaign.captures[s.name] for s in campaign.shots if s.frames > 2}
    for row in stack_rows(stacks):
        assert row["value"] == pytest.approx(
            PUBLISHED[row["symbol"]][0], abs=3 * row["sigma"] + 0.0005
        )  # published to three digits


@_present("canon550d_colorchecker.dng")
def test_a_chart_without_exposure_time_becomes_a_campaign_that_its_model_can_shoot(tmp_path):
    from isetval.app.cli import main

    shutil.copyfile(REAL / "canon550d_colorchecker.dng", tmp_path / "chart.dng")
    model = ROOT / "data" / "canon550d" / "camera.toml"
    assert main(["campaign", "init", str(tmp_path), "--camera", str(model), "-q"]) == 0
    campaign = isetval.load_campaign(tmp_path)
    (shot,) = campaign.shots
    assert shot.exposure.time_s == 1.0
    assert len(shot.target.patches) == 24
    plain = isetval.load_model(model)
    green = {}
    for who, part in (("file", campaign), ("model", isetval.simulate(plain, campaign.as_plan(), seed=1))):
        rows = isetval.measure_campaign(part, summaries=False).metrics
        green[who] = {m.patch: m.value for m in rows if m.name == "patch_mean" and m.channel == "Gr"}
    greys = ("white", "neutral 8", "neutral 6.5", "neutral 5")
    ratio = [green["model"][name] / green["file"][name] for name in greys]
    assert ratio == pytest.approx([1.0] * 4, abs=0.15)  # evenness of the light, flare
