"""Files of metrics of other tools: each format in a small file of its own making, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from isetval.core.errors import InputError
from isetval.core.sensor import Sensor
from isetval.files.metric_file import Reading, read_metrics

SENSOR = Sensor(3024, 4032, 1.4, "RGGB", ((64.0, 64.0), (64.0, 64.0)), 1023.0, 10)


def read(folder: Path, name: str, text: str, **how: object):
    (folder / name).write_text(text)
    return read_metrics(folder, name, SENSOR, Reading(**how))  # type: ignore[arg-type]


def values(given) -> list[tuple[str, str, float | None, float]]:
    return [(m.name, m.channel, m.frequency_cy_px, m.value) for m in given.block.metrics]


def test_own_table_keeps_every_condition(tmp_path):
    text = (
        "# measured on a sphere\n"
        "name,value,sigma,unit,channel,patch,radius_mm,frequency_cy_px,level_dn\n"
        "relative_illumination,0.9,0.01,1,G,,1.5,,\n"
        "mtf,0.5,0.02,1,R,,,0.25,\n"
        "noise,6.3,0.1,DN,G,,,,290\n"
        "patch_ratio,1.1,0.01,1,R/G,white,,,\n"
    )
    rows = read(tmp_path, "t.csv", text).block.metrics
    assert [m.name for m in rows] == ["relative_illumination", "mtf", "uniform_patch_noise", "patch_ratio"]
    assert [m.sigma for m in rows] == [0.01, 0.02, 0.1, 0.01]
    assert (rows[0].field_x_mm, rows[0].region) == (1.5, "r 1.5000 mm")
    assert (rows[1].frequency_cy_px, rows[2].level, rows[3].patch, rows[3].channel) == (0.25, 290.0, "white", "R/G")


def test_curve_of_two_columns_with_and_without_header(tmp_path):
    plain = read(tmp_path, "a.csv", "0 1\n1 0.9\n2 0.7\n", metric="relative_illumination", sigma=0.01)
    named = read(tmp_path, "b.csv", "height_mm;ri;other\n0;1;5\n1;0.9;\n2;0.7;5\n", metric="vignetting", column="ri", sigma=0.01)
    assert [(m.field_x_mm, m.value) for m in plain.block.metrics] == [(0.0, 1.0), (1.0, 0.9), (2.0, 0.7)]
    assert [m.key() for m in named.block.metrics] == [m.key() for m in plain.block.metrics]


def test_third_column_that_is_called_sigma_is_one(tmp_path):
    rows = read(tmp_path, "c.csv", "freq_cy_per_mm,mtf,mtf_sigma\n100,0.5,0.03\n", metric="mtf").block.metrics
    assert (rows[0].sigma, rows[0].frequency_cy_px) == (0.03, pytest.approx(0.14))  # 100 cy/mm x 1.4 um


def test_correlation_falls_along_the_axis_within_a_channel(tmp_path):
    text = "name,value,sigma,channel,radius_mm\n" + "".join(
        f"relative_illumination,0.9,0.01,{c},{r}\n" for c in ("R", "G") for r in (0, 1, 3)
    )
    matrix = read(tmp_path, "t.csv", text, correlation_length=0.5).block.correlation
    assert matrix[:3, :3] == pytest.approx(np.exp(-np.array([[0, 2, 6], [2, 0, 4], [6, 4, 0]])))
    assert np.all(matrix[:3, 3:] == 0)


def test_covariance_file_gives_sigma_and_correlation(tmp_path):
    (tmp_path / "cov.csv").write_text("4e-4,1e-4\n1e-4,1e-4\n")
    given = read(tmp_path, "c.csv", "0 1\n1 0.9\n", metric="relative_illumination", covariance="cov.csv")
    assert [m.sigma for m in given.block.metrics] == pytest.approx([0.02, 0.01])
    assert given.block.correlation[0, 1] == pytest.approx(0.5)
    assert given.files == ("c.csv", "cov.csv")


SFRMAT = """,Output from Matlab function sfrmat5.m
,Analysis:  Spatial Frequency Response

,11-Mar-2026
,Image/data evaluated,edge.tif
,Edge fit order,5
,"SFR50, cy/pixel",0.21
,"Frequency, cy/pixel",SFR-r,SFR-g,SFR-b,Lum
,0,1,1,1,1
,0.1,0.9,0.92,0.88,0.91
,0.2,0.6,0.65,0.55,0.63
"""


def test_sfrmat_workbook_saved_as_csv(tmp_path):
    given = read(tmp_path, "s.csv", SFRMAT, sigma=0.01, channel="G")
    assert values(given) == [("mtf", "G", 0.1, 0.92), ("mtf", "G", 0.2, 0.65)]
    assert (given.method, given.source) == ("iso12233:2023", "sfrmat5")


def test_sfrmat_on_a_millimetre_axis_without_quotes(tmp_path):
    text = "Output from Matlab function sfrmat3.m\nFrequency, cy/mm\tSFR\n0\t1\n100\t0.7\n"
    given = read(tmp_path, "s.txt", text, sigma=0.01)
    assert values(given) == [("mtf", "", pytest.approx(0.14), 0.7)]
    assert given.method == "iso12233:2014"


def mapper_line(block: int, *, version: int) -> str:
    curve = [np.exp(-((k / 64) ** 2) * 10) for k in range(64)]
    before = [block, 100.5, 200.5, 5.0, 45.0] + ([30.0] * 8 if version == 2 else [])
    return " ".join(f"{v:.6f}" for v in [*before, *curve])


@pytest.mark.parametrize("version", [1, 2])
def test_mtf_mapper_sfr_steps_by_a_64th(tmp_path, version):
    remark = "" if version == 1 else "# MTF Mapper SFR, output format version 2 \n"
    text = remark + "\n".join(mapper_line(b, version=version) for b in (0, 1)) + "\n"
    rows = read(tmp_path, "edge_sfr_values.txt", text, sigma=0.01, edge=2).block.metrics
    assert len(rows) == 63
    assert (rows[15].frequency_cy_px, rows[15].value) == (0.25, pytest.approx(np.exp(-0.625), abs=1e-6))
    with pytest.raises(InputError, match="holds 2 edges"):
        read(tmp_path, "edge_sfr_values.txt", text, sigma=0.01)


def test_mtf_mapper_mtf50_and_its_units(tmp_path):
    head = "# MTF Mapper MTF summary, output format version 2 \n# column  4: MTF-50 value ({})\n"
    line = "0 100.5 200.5 0.213 90 190 30.0 8.0 60.0\n"
    assert values(read(tmp_path, "m.txt", head.format("c/p") + line, sigma=0.01)) == [("mtf50", "", None, 0.213)]
    with pytest.raises(InputError, match="c/p is needed"):
        read(tmp_path, "m.txt", head.format("lp/mm") + line, sigma=0.01)


IMATEST = """Imatest,5.2.0,Master,SFR

File,edge.jpg
Cy/pxl,LW/PH,MTF(Y),MTF(R),MTF(G),MTF(B)
0,0,1,1,1,1
0.1,600,0.9,0.88,0.91,0.87
0.2,1200,0.6,0.5,0.62,0.49

x (pixels),Edge
"""


def test_imatest_csv_of_one_region(tmp_path):
    given = read(tmp_path, "i_MTF.csv", IMATEST, sigma=0.01, channel="R")
    assert values(given) == [("mtf", "R", 0.1, 0.88), ("mtf", "R", 0.2, 0.5)]
    assert given.method == "iso12233:2017"


def test_imatest_regions_of_csv_and_json(tmp_path):
    text = "Imatest,4.5\n\nN,MTF50 (Cy/Pxl),R1090 (pxl)\n1, 0.2400, 2.3\n2, 0.1750, 3.0\n\n"
    assert values(read(tmp_path, "m.csv", text, sigma=0.01, edge=2)) == [("mtf50", "", None, 0.175)]
    content = json.dumps({"sfrResults": {"mtf50": [0.3, 0.2]}})
    assert values(read(tmp_path, "m.json", content, sigma=0.01, edge=1)) == [("mtf50", "", None, 0.3)]


@pytest.mark.parametrize(
    ("name", "text"),
    [("u.csv", "Imatest,5.2,Uniformity\n\nWorst corner,71.2\n"), ("u.json", '{"uniformityResults": {"worst_corner": [71.2]}}')],
)
def test_imatest_uniformity_is_refused_with_what_to_do(tmp_path, name, text):
    with pytest.raises(InputError, match=r"two columns radius_mm,value .*isetval compare MODEL curve\.csv --as"):
        read(tmp_path, name, text, sigma=0.01)


def test_emva_xml_with_decimal_commas_and_sections(tmp_path):
    text = (
        "<results><sensitivity><K><value>0,28006</value><units>DN/e</units></K><QE><value>45.2</value></QE></sensitivity>"
        "<sigma_d><value>10.92</value></sigma_d><PRNU1288><value>0.433</value></PRNU1288></results>"
    )
    given = read(tmp_path, "e.xml", text, sigma=0.01)
    found = {m.name: (m.value, m.unit) for m in given.block.metrics}
    assert found == {"conversion_gain": (0.28006, "DN/e-"), "temporal_dark_noise": (10.92, "e-"), "prnu": (0.433, "%")}
    assert "left out: QE" in given.source


def test_emva_csv(tmp_path):
    rows = read(tmp_path, "e.csv", "symbol,value,unit\nK,0.1,DN/e-\nmu_e.sat,10000,e-\n", sigma=0.001).block.metrics
    assert [(m.name, m.value) for m in rows] == [("conversion_gain", 0.1)]


@pytest.mark.parametrize(
    ("text", "how", "words"),
    [
        ("0 1\n1 0.9\n", {"metric": "relative_illumination"}, "has no sigma"),
        ("0 1\n1 0.9\n", {"sigma": 0.01}, "say what it is"),
        ("0 1\n9 0.9\n", {"metric": "relative_illumination", "sigma": 0.01}, "outside the sensor"),
        ("0 1\n0 0.9\n", {"metric": "mtf", "sigma": 0.01}, "comes twice"),
        ("r,a,b\n0,1,2\n", {"metric": "mtf", "sigma": 0.01}, "--column"),
        ("r,a\n0,x\n", {"metric": "mtf", "sigma": 0.01}, "need numbers"),
        ("name,value,colour\nmtf,1,red\n", {"sigma": 0.01}, "column 'colour'"),
        ("name,value\nmtf,1\n", {"sigma": 0.01}, "frequency_cy_px"),
        ("name,value,radius_mm\nmtf,1,1\n", {"sigma": 0.01}, "frequency_cy_px"),
        ("name,value\npatch_mean,nan\n", {"sigma": 0.01}, "needs a number"),
        ("0 1\n1 0.9\n", {"metric": "mtf", "sigma": 0.01, "method": "iso 12233"}, "method is"),
        ("0 1\n1 0.9\n", {"metric": "mtf", "sigma": 0.01, "correlation_length": -1.0}, "above 0"),
        ("<results><QE><value>3</value></QE></results>", {"sigma": 0.01}, "one of K, sigma_d"),
        ("<results><K>", {"sigma": 0.01}, "is no XML"),
        ("Output from Matlab function sfrmat5.m\n1,2\n", {"sigma": 0.01}, "save the whole sheet"),
    ],
)
def test_what_is_not_understood_is_refused_in_words(tmp_path, text, how, words):
    with pytest.raises(InputError, match=words):
        read(tmp_path, "x.csv", text, **how)


@pytest.mark.parametrize("name", ["../x.csv", "/etc/passwd", "none.csv"])
def test_files_stay_in_their_folder(tmp_path, name):
    with pytest.raises(InputError, match=r"leads out of the folder|does not exist"):
        read_metrics(tmp_path, name, SENSOR, Reading(metric="mtf", sigma=0.1))


def test_covariance_that_is_none(tmp_path):
    (tmp_path / "cov.csv").write_text("1e-4,2e-4\n2e-4,1e-4\n")
    with pytest.raises(InputError, match="eigenvalue"):
        read(tmp_path, "c.csv", "0 1\n1 0.9\n", metric="relative_illumination", covariance="cov.csv")


def test_workbooks_are_refused(tmp_path):
    (tmp_path / "s.xlsx").write_bytes(b"PK\3\4\0\0\0")
    with pytest.raises(InputError, match="save it as CSV"):
        read_metrics(tmp_path, "s.xlsx", SENSOR, Reading(metric="mtf", sigma=0.1))
