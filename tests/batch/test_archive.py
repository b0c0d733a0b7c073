"""The archive: every row once, whoever adds it; questions in SQL; planted drifts and outliers found."""

import json
from datetime import datetime, timedelta

import numpy as np
import pytest

pytest.importorskip("duckdb")
pytest.importorskip("pyarrow")

from dng_writing import flat_with_serial

from isetval import InputError
from isetval.app.archive import Archive, trend_of
from isetval.app.archive.rows import COLUMNS
from isetval.app.cli import main


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """Six captures of two bodies, measured into a store and into a result."""
    folder = tmp_path_factory.mktemp("archive")
    for i in range(6):
        body = f"SN{i % 2}"
        date = f"2026:0{1 + i // 2}:01 12:00:00"
        flat_with_serial(folder / "captures" / body / f"c{i}.dng", seed=i, serial=body, date=date)
    assert main(["measure", str(folder / "captures"), "--store", str(folder / "s"), "-q", "-o", str(folder / "m.json")]) == 0
    return folder


@pytest.fixture
def run(capsys):
    def runner(*words):
        code = main([str(w) for w in words])
        said = capsys.readouterr()
        return code, said.out, said.err

    return runner


def test_rows_hold_what_the_result_holds(store, tmp_path):
    archive = Archive(tmp_path / "a")
    records, rows = archive.add([store / "s"])
    result = json.loads((store / "m.json").read_text())
    assert (records, rows) == (6, len(result["metrics"]))
    frame = archive.frame("SELECT * FROM metrics ORDER BY file, row")
    expected = sorted(result["metrics"], key=lambda r: r["file"])
    assert frame["value"].tolist() == [r["value"] for r in expected]
    assert frame["file"].tolist() == [r["file"] for r in expected]
    assert set(frame["serial"]) == set(frame["body"]) == {"SN0", "SN1"}
    assert sorted(set(frame["date"].dt.month)) == [1, 2, 3]
    assert set(frame["iso"]) == {100.0}
    assert json.loads(frame["settings"][0])["black"] == "auto"


def test_adding_again_adds_nothing(store, tmp_path):
    archive = Archive(tmp_path / "a")
    archive.add([store / "s"])
    before = archive.parts()
    assert archive.add([store / "s", store / "s"]) == (0, 0)
    assert archive.parts() == before


def test_shards_side_by_side_and_the_same_record_from_two(store, tmp_path, run):
    """Three shards add their own rows; a fourth adds everything at the same moment: each row is read once."""
    for i in (1, 2, 3):
        run("measure", store / "captures", "--store", tmp_path / f"s{i}", "--shard", f"{i}/3", "-q")
        Archive(tmp_path / "a").add([tmp_path / f"s{i}"])
    assert Archive(tmp_path / "a").query("SELECT count(DISTINCT record) FROM metrics")[1] == [(6,)]
    alone = Archive(tmp_path / "alone")
    alone.add([store / "s"])
    whole = alone.query("SELECT count(*) FROM metrics")[1]
    for path in alone.parts():
        (tmp_path / "a" / path.name).write_bytes(path.read_bytes())  # what a race leaves behind
    assert Archive(tmp_path / "a").query("SELECT count(*) FROM metrics")[1] == whole


def test_results_are_added_too(store, tmp_path):
    archive = Archive(tmp_path / "a")
    assert archive.add([store / "m.json"], body="phone 7")[0] == 6
    assert archive.add([store / "m.json"], body="phone 7") == (0, 0)
    assert archive.query("SELECT DISTINCT body FROM metrics")[1] == [("phone 7",)]


def test_questions_see_the_archive_and_nothing_else(store, tmp_path, run):
    Archive(tmp_path / "a").add([store / "s"])
    code, out, _ = run("archive", "query", tmp_path / "a", "SELECT count(*) AS n FROM metrics WHERE channel = 'R'", "--json")
    assert code == 0
    assert json.loads(out)["rows"][0]["n"] > 0
    (tmp_path / "secret.csv").write_text("a\n1\n")
    for sql in (
        f"SELECT * FROM read_csv('{tmp_path}/secret.csv')",
        f"COPY metrics TO '{tmp_path}/out.csv'",
        "SET enable_external_access=true",
        "SELECT nothing FROM metrics",
        "SELEC",
    ):
        code, _, err = run("archive", "query", tmp_path / "a", sql)
        assert code == 3, sql
        assert "the question cannot be answered" in err
    assert not (tmp_path / "out.csv").exists()
    code, out, _ = run("archive", "query", tmp_path / "a")
    assert "plane_mean" in out


def test_what_is_no_archive_and_no_source(tmp_path, run, store):
    for words in (("query", tmp_path), ("trend", tmp_path, "mtf50")):
        code, _, err = run("archive", *words)
        assert code == 3
        assert "is no archive" in err
    code, _, err = run("archive", "add", tmp_path / "a", tmp_path)
    assert (code, "holds no records" in err) == (3, True)
    (tmp_path / "x.json").write_text('{"kind": "measure", "metrics": [{"name": "a"}]}')
    code, _, err = run("archive", "add", tmp_path / "a", tmp_path / "x.json")
    assert code == 3
    assert "metrics[0]: object missing required field" in err
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "x.parquet").write_bytes(b"PAR1 but not really")
    code, _, err = run("archive", "query", tmp_path / "b")
    assert code == 3
    assert "cannot be read as an archive" in err


def planted(tmp_path, values, *, sigma=0.1, metric="gain", channel="G"):
    """An archive of one series, a capture a day."""
    start = datetime(2026, 1, 1)
    rows = [
        dict.fromkeys(COLUMNS)
        | {"record": f"r{i:04d}", "row": 0, "file": f"c{i}.dng", "date": start + timedelta(days=i), "metric": metric}
        | {"value": float(v), "sigma": sigma, "unit": "DN", "channel": channel, "body": "b"}
        for i, v in enumerate(values)
    ]
    archive = Archive(tmp_path / "planted")
    archive._part(rows)
    return archive


def test_a_planted_drift_and_outlier_are_found(tmp_path):
    """365 days, drift .5 DN a year, noise .1 DN: the slope's error is sigma / (n^.5 sd(t)) = .018; one capture 2 DN off."""
    rng = np.random.default_rng(3)
    days = np.arange(365)
    values = 10 + 0.5 * days / 365.25 + 0.1 * rng.standard_normal(365)
    (quiet,) = trend_of(planted(tmp_path / "1", values), "gain")
    expected = 0.1 / np.sqrt(365) / np.std(days / 365.25)
    assert abs(quiet.drift_per_year.value - 0.5) < 4 * quiet.drift_per_year.sigma
    assert expected < quiet.drift_per_year.sigma < 2.5 * expected  # the drift itself widens the robust spread
    values[200] += 2.0
    (trend,) = trend_of(planted(tmp_path / "2", values), "gain")
    assert 200 in trend.outside
    assert len(trend.outside) <= 1 + 4  # beyond 3 sigma lie .3 % of 365


def test_limits_and_exit_codes(tmp_path, run):
    planted(tmp_path, [1.0, 1.1, 0.9, 1.0, 3.0, 1.05])
    folder = tmp_path / "planted"
    code, out, _ = run("archive", "trend", folder, "gain", "--high", 2)
    assert code == 1
    assert "outside: c4.dng: 3 DN, above 2 by 10.0 of its sigma" in out
    assert run("archive", "trend", folder, "gain", "--high", 4)[0] == 0
    code, out, _ = run("archive", "trend", folder, "gain", "-o", tmp_path / "t.html")
    assert code == 0
    assert "c4.dng" in (tmp_path / "t.html").read_text()
    assert run("archive", "trend", folder, "gain", "-o", tmp_path / "t.png")[0] == 0
    assert (tmp_path / "t.png").read_bytes().startswith(b"\x89PNG")
    code, _, err = run("archive", "trend", folder, "mtf50")
    assert code == 3
    assert "no row of 'mtf50' fits; it holds most of: gain" in err


def test_store_commands(store, tmp_path, run):
    code, out, _ = run("store", "merge", tmp_path / "m", store / "s")
    assert code == 0
    assert "6 records" in out
    code, out, _ = run("store", "show", tmp_path / "m")
    assert "6 records" in out


def test_prompt_quotes_are_no_sql(tmp_path):
    archive = planted(tmp_path, [1.0, 2.0])
    with pytest.raises(InputError, match="no row of"):
        trend_of(archive, "x' OR '1'='1")
