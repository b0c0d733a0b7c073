"""What was measured of a shot is found again by its content, and measured again where anything of it is another."""

from dataclasses import replace

import numpy as np
import pytest

from isetval.core import campaign as plans
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.metric import Block, Differences, Metric
from isetval.measure import campaign as measuring
from isetval.measure.analyses import flat_fields
from isetval.measure.campaign import measure_campaign
from isetval.measure.kept_shots import KeptShots, packed, unpacked

ROWS = ("mean", "temporal_variance")


@pytest.fixture
def store(monkeypatch, tmp_path):
    monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path / "kept"))
    return tmp_path / "kept"


@pytest.fixture
def campaign():
    rng = np.random.default_rng(4)
    frames = tuple(Capture.from_array(rng.integers(90, 110, (32, 32)).astype(np.uint16), sensor_shape=(64, 64)) for _ in range(4))
    shot = plans.Shot("grey", "dark", frames=4, measurement_session="A")
    return plans.Campaign("kept", (shot,), plans.MemoryCaptures({"grey": frames}), frames[0].sensor)


def counted(monkeypatch):
    done, analyze = [], measuring.analyzed_shot
    monkeypatch.setattr(measuring, "analyzed_shot", lambda *asked: done.append(asked[0].name) or analyze(*asked))
    return done


def measured(campaign, asked="nothing"):
    return measure_campaign(campaign, summaries=False, kept=KeptShots(asked))


def test_captures_are_measured_once(campaign, store, monkeypatch):
    done = counted(monkeypatch)
    first, again = measured(campaign), measured(campaign)
    assert done == ["grey"]
    assert again.metrics == first.metrics
    assert again.choices == first.choices
    np.testing.assert_array_equal(again.covariance(), first.covariance())
    assert [list(block.shared) for block in again.blocks] == [list(block.shared) for block in first.blocks]
    assert [block.differences for block in again.blocks] == [block.differences for block in first.blocks]


def with_another_code(campaign):
    frames = campaign.captures.read("grey")
    mosaic = frames[0].mosaic.copy()
    mosaic[3, 5] += 1
    return replace(campaign, captures=plans.MemoryCaptures({"grey": (replace(frames[0], mosaic=mosaic), *frames[1:])}))


def with_another_exposure(campaign):
    return replace(campaign, shots=(replace(campaign.shots[0], exposure=plans.Exposure(time_s=0.5)),))


@pytest.mark.parametrize("changed", [with_another_code, with_another_exposure])
def test_what_is_another_shot_is_measured(changed, campaign, store, monkeypatch):
    done = counted(monkeypatch)
    measured(campaign)
    assert measured(changed(campaign)).metrics
    measured(campaign, asked="other choices")
    assert done == ["grey"] * 3


@pytest.mark.parametrize("content", [b"", b"not a store", None])
def test_damage_is_measured_again(content, campaign, store, monkeypatch):
    done = counted(monkeypatch)
    first = measured(campaign)
    (path,) = (store / "shots").iterdir()
    path.write_bytes(path.read_bytes()[:-40] if content is None else content)
    assert measured(campaign).metrics == first.metrics
    assert done == ["grey"] * 2


def test_a_folder_that_cannot_be_written_loses_nothing(campaign, monkeypatch):
    monkeypatch.setenv("ISETVAL_CACHE", "off")
    done = counted(monkeypatch)
    assert measured(campaign).metrics == measured(campaign).metrics
    assert done == ["grey"] * 2


def test_what_could_not_be_measured_is_tried_again(campaign, store, monkeypatch):
    """A program that ran out of memory says so in a remark, and may have more of it tomorrow."""

    def breaks(*_):
        raise MemoryError

    done = counted(monkeypatch)
    with monkeypatch.context() as short:
        short.setattr(flat_fields, "analyze", breaks)
        with pytest.raises(InputError, match="MemoryError"):
            measured(campaign)
    assert measured(campaign).metrics
    assert done == ["grey"] * 2


def block(choices):
    rows = tuple(Metric(name, np.nan if i else 1 / 3, 0.1, "DN", family=name, frame=i) for i, name in enumerate(ROWS))
    return Block(rows, np.eye(2), {"label": np.array([0.1, 1 / 7])}, choices, Differences(draws=3, one_frame=True))


def test_blocks_come_back_as_they_were():
    choices = {"R": {"order": 1, "light": 0.1 + 0.2}, "patches": [1, 2]}
    ((name, read),) = unpacked(packed([("own", block(choices))]))
    written = block(choices)
    assert (name, read.choices, read.differences) == ("own", written.choices, written.differences)
    assert [m.key() for m in read.metrics] == [m.key() for m in written.metrics]
    np.testing.assert_array_equal([m.value for m in read.metrics], [m.value for m in written.metrics])
    np.testing.assert_array_equal(read.correlation, written.correlation)
    np.testing.assert_array_equal(read.shared["label"], written.shared["label"])


@pytest.mark.parametrize("choices", [{"cut": (1, 2)}, {"level": {3: 0.1}}, {"cut": np.arange(2)}, {"n": np.int64(3)}])
def test_choices_that_a_file_changes_are_not_kept(choices):
    with pytest.raises(TypeError):
        packed([("own", block(choices))])
