"""One hash: equal content gives equal keys, and nothing else does."""

import dataclasses
import hashlib
from pathlib import Path

import numpy as np
import pytest

from isetval import InputError
from isetval.core.cache import content_hash, file_hash
from isetval.core.toml import inside
from isetval.core.writing import write_whole


@dataclasses.dataclass(frozen=True)
class Thing:
    a: float
    b: object


def test_order_of_keys_and_kind_of_row_do_not_matter():
    assert content_hash({"b": [1, 2.5], "a": np.array([1.0, 2.0])}) == content_hash({"a": np.array([1.0, 2.0]), "b": (1, 2.5)})
    assert content_hash(np.float64(2.5)) == content_hash(2.5)


def test_no_two_contents_look_alike():
    contents = [
        None, 0, 0.0, False, "", "0", b"0", Path("0"), [], [[]], {}, [0, 0], [[0], 0], ["ab"], ["a", "b"], {"a": 1}, ["a", 1],
        np.zeros(2), np.zeros(2, np.float32), np.zeros((2, 1)), np.zeros((1, 2)), Thing(0.0, None), Thing(0.0, 0.0),
    ]  # fmt: skip
    assert len({content_hash(c) for c in contents}) == len(contents)


def test_a_thing_without_content_is_no_key():
    with pytest.raises(TypeError, match="object"):
        content_hash({"a": object()})


def test_file_hash_is_sha256(tmp_path):
    data = bytes(range(256)) * 9000
    (tmp_path / "x").write_bytes(data)
    assert file_hash(tmp_path / "x") == hashlib.sha256(data).hexdigest()
    with pytest.raises(InputError, match="cannot be read"):
        file_hash(tmp_path / "y")


@pytest.mark.parametrize("name", ["../x", "a/../../x", "/etc/passwd", "", "a\0b", "link/x"])
def test_names_from_data_stay_inside(tmp_path, name):
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    with pytest.raises(InputError, match="name"):
        inside(folder, name)
    assert inside(folder, "sub/x.dng") == folder / "sub/x.dng"


def test_written_whole_or_not_at_all(tmp_path):
    file = tmp_path / "x"
    write_whole(file, "old")
    with pytest.raises(InputError, match="folder"):
        write_whole(tmp_path, "new")
    with pytest.raises(InputError, match="cannot be written"):
        write_whole(tmp_path / "no" / "x", "new")
    assert file.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["x"]
