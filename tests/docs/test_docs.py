"""The documentation site and the schemas of the file formats."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from isetval.effects import catalogue

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs"))
from make_schemas import schemas  # noqa: E402

EXAMPLES = [
    *sorted((ROOT / "data").glob("*/camera.toml")),
    *sorted((ROOT / "data").glob("*/plan.toml")),
]


def _schema_of(path):
    return schemas()["camera.schema.json" if path.name == "camera.toml" else "campaign.schema.json"]


def test_the_schema_of_cameras_knows_every_effect():
    effects = schemas()["camera.schema.json"]["properties"]["effect"]["items"]["anyOf"]
    assert {e["properties"]["name"]["const"] for e in effects} == set(catalogue())


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: f"{p.parent.name}-{p.stem}")
def test_files_of_the_project_fit_and_mistakes_do_not(path):
    jsonschema = pytest.importorskip("jsonschema")
    schema, content = _schema_of(path), tomllib.loads(path.read_text())
    jsonschema.validate(content, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(content | {"sensro": 1}, schema)


@pytest.mark.slow
def test_the_site_is_built_without_warnings(tmp_path):
    for name in ("sphinx", "numpydoc", "sphinx_gallery", "myst_parser"):
        pytest.importorskip(name)
    command = [sys.executable, "-m", "sphinx", "-W", "-q", "-b", "html", str(ROOT / "docs"), str(tmp_path / "site")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    pages = {p.stem for p in (tmp_path / "site" / "effects_by_name").glob("*.html")}
    assert set(catalogue()) <= pages
