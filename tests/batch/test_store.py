"""The store: whole or absent, never trusted blindly, merged by copying."""

import json

import pytest

from isetval import InputError
from isetval.app.batch.store import Record, ResultStore, Seen


def record(key, value=1.0, **more):
    return Record(key, {"metrics": [["⟦0⟧", {"value": value}]]}, **more)


def test_what_is_written_is_found_by_another_store(tmp_path):
    seen = Seen("/lab/a.dng", 100, 5)
    ResultStore(tmp_path).write([record("a", 1 / 3, seen=(seen,), prints=("p",)), record("b")])
    again = ResultStore(tmp_path)
    assert again.keys() == ["a", "b"]
    assert again.get("a") == {"metrics": [["⟦0⟧", {"value": 1 / 3}]]}
    assert again.keys_of([seen]) == ["a"]
    assert again.keys_of([Seen("/lab/a.dng", 100, 6)]) == ()
    assert again.knows_print("p")
    assert not again.knows_print("q")


def test_the_same_records_are_one_segment(tmp_path):
    for _ in range(2):
        ResultStore(tmp_path).write([record("a"), record("b")])
    assert len(ResultStore(tmp_path).segments()) == 1


def test_a_changed_byte_makes_its_record_absent_and_no_other(tmp_path):
    ResultStore(tmp_path).write([record("a", 1.0), record("b", 2.0)])
    (segment,) = ResultStore(tmp_path).segments()
    data = bytearray(segment.read_bytes())
    data[-3] ^= 1  # of b, which comes last
    segment.write_bytes(data)
    store = ResultStore(tmp_path)
    assert store.get("b") is None
    assert "b" not in store
    assert store.get("a") is not None
    ResultStore(tmp_path).write([record("b", 2.0)])
    assert ResultStore(tmp_path).get("b") == record("b", 2.0).content


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"x",
        b"[]\n",
        b'{"format": 1}\n',
        b'{"format": 1, "records": [[1]]}\n',
        b'{"format": 9, "records": []}\n',
        b"[" * 100_000,
    ],
)
def test_what_is_no_segment_is_passed_over(tmp_path, data):
    (tmp_path / "ab").mkdir()
    (tmp_path / "ab" / "abc.rows").write_bytes(data)
    assert len(ResultStore(tmp_path)) == 0


def test_a_cut_segment_holds_what_is_whole(tmp_path):
    ResultStore(tmp_path).write([record("a", 1.0), record("b", 2.0)])
    (segment,) = ResultStore(tmp_path).segments()
    segment.write_bytes(segment.read_bytes()[:-5])
    store = ResultStore(tmp_path)
    assert store.get("a") is not None
    assert store.get("b") is None


def test_merging_two_shards(tmp_path):
    ResultStore(tmp_path / "1").write([record("a"), record("b")])
    ResultStore(tmp_path / "2").write([record("b"), record("c")])
    whole = ResultStore(tmp_path / "whole")
    assert whole.merge([tmp_path / "1", tmp_path / "2"]) == 2
    assert whole.merge([tmp_path / "1"]) == 0
    assert [key for key, _ in whole.records()] == ["a", "b", "c"]
    with pytest.raises(InputError, match="is no store of measurements"):
        whole.merge([tmp_path / "nothing"])


def test_not_a_number_is_never_stored(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        ResultStore(tmp_path).write([record("a", float("nan"))])
    assert json.dumps(ResultStore(tmp_path).keys()) == "[]"
