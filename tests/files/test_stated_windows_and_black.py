"""A folder of crops and one with a wrong black tag: drafted, loaded and measured with one place and one black level."""

import numpy as np
import pytest

import isetval
from isetval import Capture, InputError, Sensor, read_dng
from isetval.files.dng import write_dng
from isetval.files.dng.sensor_window import OneBlack
from isetval.files.draft import draft_campaign, write_draft
from isetval.files.loose_files import file_reader, measure_files

SENSOR = Sensor(400, 500, 1.4, "GRBG", 64.0, 1023.0)


def drafted(folder):
    write_draft(draft_campaign(folder), folder)
    return isetval.load_campaign(folder)


def test_crops_of_two_field_points_stay_apart(tmp_path):
    rng = np.random.default_rng(1)
    places = {"flat_a": (11, 20), "flat_b": (301, 420)}
    for name, window in places.items():
        for i in range(2):
            mosaic = (64 + rng.poisson(400, (64, 64))).astype(np.uint16)
            exposure = isetval.Exposure(0.01, 100)
            write_dng(tmp_path / f"{name}_{i}.dng", Capture(mosaic, SENSOR, window, exposure))
    campaign = drafted(tmp_path)
    assert (campaign.sensor.rows, campaign.sensor.cols, campaign.sensor.cfa) == (400, 500, "GRBG")
    assert sorted(tuple(shot.window[:2]) for shot in campaign.shots) == sorted(places.values())
    assert all({c.window for c in campaign.captures[shot.name]} == {tuple(shot.window[:2])} for shot in campaign.shots)


def test_a_plan_without_windows_takes_those_of_its_files(tmp_path):
    mosaic = (64 + np.random.default_rng(2).poisson(400, (64, 64))).astype(np.uint16)
    write_dng(tmp_path / "a.dng", Capture(mosaic, SENSOR, (11, 20), isetval.Exposure(0.01)))
    (tmp_path / "campaign.toml").write_text('[[shot]]\nrole = "flat"\nfiles = ["a.dng"]\n')
    (shot,) = isetval.load_campaign(tmp_path).shots
    assert tuple(shot.window) == (11, 20, 64, 64)


@pytest.fixture
def wrong_tag(tmp_path, make_dng):
    """Two darks whose hidden margin lies 7 DN below the tag, as the Canon 550D's does."""
    for i in range(2):
        rng = np.random.default_rng(i)
        frame = np.round(64 + 3 * rng.standard_normal((200, 180))).astype(np.uint16)
        make_dng(frame, name=f"dark_{i}.dng", t50829=(4, [0, 60, 200, 180]), t50714=(3, [71]), t50717=(4, [4095]))
    return tmp_path


def test_reader_draft_and_campaign_take_one_black_level(wrong_tag):
    alone = [np.mean(read_dng(wrong_tag / f"dark_{i}.dng").sensor.black_dn) for i in range(2)]
    # 96 rows of 34 columns a place: the margin's mean is good to 3/sqrt(4 * 96 * 17)
    assert alone == pytest.approx([64, 64], abs=5 * 3 / np.sqrt(4 * 96 * 17))
    campaign = drafted(wrong_tag)
    table = isetval.measure_campaign(campaign)
    assert np.mean(campaign.sensor.black_dn) == alone[0]
    (shot,) = campaign.shots
    assert len(campaign.captures[shot.name]) == 2
    assert table.metrics


def test_the_true_reason_is_said_where_file_and_campaign_disagree(wrong_tag):
    write_draft(draft_campaign(wrong_tag), wrong_tag)
    toml = wrong_tag / "campaign.toml"
    lines = ["black_dn = 71.0" if line.startswith("black_dn") else line for line in toml.read_text().splitlines()]
    toml.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"none of its 2 files can be used; .*optical_black.*DN apart"):
        isetval.measure_campaign(isetval.load_campaign(wrong_tag))


def test_loose_files_take_the_black_level_of_a_single_one(wrong_tag):
    """A series is not split by the errors of its margins, and several files have the black level of one."""
    paths = sorted(wrong_tag.glob("*.dng"))
    alone = [read_dng(path) for path in paths]
    assert alone[0].sensor != alone[1].sensor
    read = file_reader()
    assert [read(path).sensor for path in paths] == [alone[0].sensor] * 2
    found = measure_files(paths, read=file_reader(), role="dark")
    (level,) = {m.value for _, m in found.metrics if m.name == "black_level_dn" and m.channel == "R"}
    assert level == pytest.approx(64, abs=0.1)
    assert not any("differs_from_tag" in m.reason for _, m in found.metrics)


def test_a_black_level_farther_off_is_kept(tmp_path):
    flat = np.random.default_rng(3).integers(100, 200, (30, 40)).astype(np.uint16)
    near, far = (Capture.from_array(flat, black_dn=black) for black in (64.3, 65.0))
    shared = OneBlack()
    assert shared(Capture.from_array(flat, black_dn=64.0)).sensor == shared(near).sensor
    assert shared(far).sensor == far.sensor
