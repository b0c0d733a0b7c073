"""The documentation site and the schemas of the file formats."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from isetval.effects import catalogue
from isetval.files.sidecar import read_sidecar

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs"))
from make_schemas import schemas  # noqa: E402

INTERFACE = re.findall(r"autofunction:: isetval\.(\S+)", (ROOT / "docs" / "api.rst").read_text(encoding="utf-8"))
EXAMPLES = [
    *sorted((ROOT / "data").glob("*/camera.toml")),
    *sorted((ROOT / "data").glob("*/plan.toml")),
]


def _schema_of(path):
    return schemas()["camera.schema.json" if path.name == "camera.toml" else "campaign.schema.json"]


def test_the_schema_of_cameras_knows_every_effect():
    effects = schemas()["camera.schema.json"]["properties"]["effect"]["items"]["anyOf"]
    assert {e["properties"]["name"]["const"] for e in effects} == set(catalogue())


def test_the_interface_is_reached_by_import_isetval():
    """As a program of its own has it: no module has to be imported first."""
    assert len(INTERFACE) > 15
    ask = f"import isetval, operator; print([n for n in {INTERFACE} if not callable(operator.attrgetter(n)(isetval))])"
    done = subprocess.run([sys.executable, "-c", ask], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: f"{p.parent.name}-{p.stem}")
def test_files_of_the_project_fit_and_mistakes_do_not(path):
    jsonschema = pytest.importorskip("jsonschema")
    schema, content = _schema_of(path), tomllib.loads(path.read_text())
    jsonschema.validate(content, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(content | {"sensro": 1}, schema)


def test_the_sidecar_of_the_documentation_fits_its_schema_and_is_read(tmp_path):
    jsonschema = pytest.importorskip("jsonschema")
    text = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    (block,) = [b for b in re.findall(r"```toml\n(.*?)```", text, re.S) if "name_rule" in b]
    content = tomllib.loads(block)
    schema = schemas()["images.schema.json"]
    jsonschema.validate(content, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(content | {"bitz": 8}, schema)
    (tmp_path / "images.toml").write_text(block, encoding="utf-8")
    said = read_sidecar(tmp_path / "d1_disks32cmV2_550nm_250ms_2019.tif")
    assert (said.cfa, said.bits, said.wavelength_nm, said.exposure.time_s) == ("GBRG", 8, 550.0, 0.25)
    assert (said.window, said.sensor) == ((1364, 1632), (2048, 2448))
    assert read_sidecar(tmp_path / "d2_colorChecker30cm_400nm_100ms_2019.tif").levels_only


def test_the_picture_of_the_readme_shows_the_numbers_that_it_prints():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (picture,) = re.findall(r"!\[[^\]]*\]\(([^)]*)\)", readme)
    drawn = re.findall(r"<text[^>]*>([\d.]+)</text>", (ROOT / picture).read_text(encoding="utf-8"))
    for family in ("all", "dark_mean", "dark_temporal_variance"):
        line = re.search(rf"^  {family} .*$", readme, re.M)[0]
        printed = re.findall(r"\d+\.\d{3}", line)
        assert len(printed) == 2
        assert set(printed) <= set(drawn), family


@pytest.mark.slow
def test_the_site_is_built_without_warnings(tmp_path):
    for name in ("sphinx", "numpydoc", "sphinx_gallery", "myst_parser"):
        pytest.importorskip(name)
    command = [sys.executable, "-m", "sphinx", "-W", "-q", "-b", "html", str(ROOT / "docs"), str(tmp_path / "site")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    pages = {p.stem for p in (tmp_path / "site" / "effects_by_name").glob("*.html")}
    assert set(catalogue()) <= pages
    for name in catalogue():  # a picture of its signature, or why there is none
        text = (tmp_path / "site" / "effects_by_name" / f"{name}.html").read_text(encoding="utf-8")
        assert f'alt="signature of {name}"' in text or "None here:" in text, name
    for example in (ROOT / "docs" / "gallery").glob("plot_*.py"):  # every one shows a figure, made by its code
        assert (tmp_path / "site" / "_images" / f"sphx_glr_{example.stem}_001.png").is_file(), example.stem
