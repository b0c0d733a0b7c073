"""Damaged JSON and TOML files: a value or one sentence; what campaigns found stays found."""

import json

import numpy as np
import pytest
from text_mutants import SECONDS, Readers, mutant, timed

from isetval import InputError
from isetval.core.json_file import DEEPEST, parse_json
from isetval.core.toml import read_toml
from isetval.files.result_file import read_result

EACH = 12


@pytest.fixture(scope="module")
def readers(tmp_path_factory):
    return Readers(tmp_path_factory.mktemp("mutants"))


def test_whole_files_are_read(readers):
    for name, (_, data, _) in readers.files.items():
        assert timed(readers, name, data)[0] == "read", name


def test_mutants_are_read_or_refused_in_one_sentence(readers):
    rng = np.random.default_rng(20)
    words = set()
    for name, (suffix, data, _) in readers.files.items():
        for _ in range(EACH):
            word, seconds = timed(readers, name, mutant(data, suffix, rng))
            words.add(word)
            assert seconds < SECONDS
    assert words == {"read", "refused"}


def put(content, value, *place):
    """The nest with one part replaced (None as last of the place: dropped)."""
    content = json.loads(json.dumps(content))
    part = content
    for key in place[:-1]:
        part = part[key]
    part[place[-1]] = value
    return content


@pytest.mark.parametrize(
    ("name", "place", "value", "said"),
    [
        ("report diagnosis", ("verdict",), "splendid", "verdict: invalid enum value 'splendid'"),
        ("report diagnosis", ("effects",), {}, "effects: expected `array`, got `object`"),
        ("report diagnosis", ("effects", 0, "posterior"), "x", "effects[0].posterior: expected `float`, got `str`"),
        (
            "report diagnosis",
            ("next_captures", 0, "rho_before"),
            None,
            "next_captures[0].rho_before: expected `float`, got `null`",
        ),
        (
            "report comparison",
            ("ladder", 0, "mean_square_z"),
            [1],
            "ladder[0].mean_square_z: expected `float | null`, got `array`",
        ),
        ("report comparison", ("gate", "mean_square_z"), None, "cannot be drawn"),
        ("report comparison", ("table", 3, "z"), 1e308, "cannot be drawn"),
        ("reveal answer", ("effects", 0, "equivalent"), 7, "effects[0].equivalent: expected `array`, got `int`"),
        ("reveal truth", ("effects", 0, "parameters", "v"), None, "expected `float`, got `null`"),
        ("add from diagnosis", ("effects", 0, "parameters", "v", "sigma"), None, None),
        ("add from diagnosis", ("effects", 0, "parameters", "v", "value"), None, "gives no value for v"),
        ("add from filters", ("matrix", 0, 0), 1e300, "cannot be"),
        ("lens", ("polynomials", 0, "passnopass", "centersX"), [1.0], "'centersX' has 1 numbers"),
        ("imatest", ("sfrResults", "mtf50"), [[1]], "has no list mtf50"),
        ("rerun", ("provenance", "inputs"), {"a": 3}, "expected `object`, got `int`"),
    ],
)
def test_findings(readers, name, place, value, said):
    path = readers.path(name)
    path.write_text(json.dumps(put(json.loads(readers.files[name][1]), value, *place)))
    if said is None:
        readers.files[name][2](path)
        return
    with pytest.raises(InputError) as caught:
        readers.files[name][2](path)
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[sensor]", "nuisance = 1e308\n[sensor]", "nuisance is 1e+308; write each as its own"),
        ("dark_reflectance = 0.05", f'dark_reflectance = "{"x" * 5000}"', "is no file name"),
        ("dark_reflectance = 0.05", "dark_reflectance = inf", "not finite"),
        ("frames = 2", 'frames = 2\nmetrics = "../../etc/passwd"', "leads out of the folder"),
    ],
)
def test_findings_in_plans(readers, old, new, said):
    path = readers.path("target")
    text = readers.files["target"][1].decode()
    if "nuisance" in new:
        text = text[: text.index("[[nuisance]]")] + text[text.index("[light.sphere]") :]
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError) as caught:
        readers.files["target"][2](path)
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 100_000, "nested too deeply"),
        ("[" * (DEEPEST + 1) + "]" * (DEEPEST + 1), f"nested deeper than {DEEPEST} levels"),
        ('{"a": NaN}', "holds the number NaN"),
        ('{"a": 1e999}', "holds the number"),
        ('{"a": ' + "9" * 5000 + "}", "is not JSON"),
        ('{"a": ' + "9" * 400 + "}", "a is a number of 1329 bits"),
        ('{"a": 1', "is not JSON"),
    ],
)
def test_numbers_and_depth_of_json(text, said):
    with pytest.raises(InputError, match=said):
        parse_json(text, "file")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("frames = 12147483648", "frames is 12147483648; a shot has 1 to 100000 frames"),
        ("frames = true", "frames is True"),
        ("frames = 99999999999999999999", "is a number of 67 bits"),
    ],
)
def test_a_plan_of_endless_frames(readers, line, said):
    path = readers.path("target")
    path.write_text(readers.files["target"][1].decode().replace("frames = 2", line))
    with pytest.raises(InputError, match=said):
        readers.files["target"][2](path)


def test_infinite_boxes_and_deep_toml(readers, tmp_path):
    path = readers.path("target")
    path.write_text(readers.files["target"][1].decode().replace("window = [0, 0, 32, 32]", "window = [0, 0, inf, 32]"))
    with pytest.raises(InputError, match="window"):
        readers.files["target"][2](path)
    (tmp_path / "deep.toml").write_text("a = " + "[" * 5000 + "]" * 5000)
    with pytest.raises(InputError, match="nested"):
        read_toml(tmp_path / "deep.toml")


def test_a_sentence_shows_no_control_characters_and_fits_a_screen():
    said = str(InputError("file \x1b[31m\0 name\n" + "x" * 10_000 + " remedy"))
    assert said.isprintable()
    assert len(said) < 1600
    assert said.startswith("file \\x1b[31m\\x00 name\\n")
    assert said.endswith("remedy")


def test_results_of_today_fit_their_schemas(readers, tmp_path):
    path = tmp_path / "m.json"
    path.write_bytes(readers.files["report measurement"][1])
    assert read_result(path) == json.loads(path.read_text())
