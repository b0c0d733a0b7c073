"""The notebooks: the quick ones as scripts, all of them built and executed where jupytext and nbclient are installed."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[1] / "analyses" / "notebooks"
SCRIPTS = sorted(FOLDER.glob("[0-9]_*.py"))
QUICK = ("1", "2", "4", "5")  # under 5 s each; 3 and 6 run the detective, 7 starts pytest three times


def test_there_are_seven_and_all_begin_with_a_title():
    assert [path.name[0] for path in SCRIPTS] == list("1234567")
    assert all(path.read_text().startswith("# %% [markdown]\n# # ") for path in SCRIPTS)


@pytest.mark.parametrize("path", [p for p in SCRIPTS if p.name[0] in QUICK], ids=lambda p: p.stem)
def test_quick_ones_run(path, capsys):
    """Their own assertions hold what they claim."""
    runpy.run_path(str(path), run_name="__main__")
    assert "Traceback" not in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("path", SCRIPTS, ids=lambda p: p.stem)
def test_all_are_built_and_executed(path, tmp_path):
    for name in ("jupytext", "nbclient", "ipykernel"):
        pytest.importorskip(name)
    import nbformat

    done = subprocess.run(
        [sys.executable, str(FOLDER / "build.py"), path.name[0], "-o", str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
    cells = nbformat.read(tmp_path / f"{path.stem}.ipynb", as_version=4).cells
    code = [cell for cell in cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in code)
    if path.name[0] in "136":  # their results show themselves
        pictures = [o for cell in code for o in cell.outputs if "data:image/png" in str(o.get("data", {}).get("text/html", ""))]
        assert pictures


@pytest.mark.slow
@pytest.mark.parametrize("path", SCRIPTS, ids=lambda p: p.stem)
def test_all_pass_as_tests_of_their_cells(path, tmp_path):
    """As a laboratory tests notebooks of its own: ``pytest --nbmake`` on what ``build.py --no-run`` wrote."""
    for name in ("jupytext", "ipykernel", "nbmake"):
        pytest.importorskip(name)
    built = [sys.executable, str(FOLDER / "build.py"), path.name[0], "--no-run", "-o", str(tmp_path)]
    assert subprocess.run(built, capture_output=True, check=False).returncode == 0
    asked = [sys.executable, "-m", "pytest", "--nbmake", "--nbmake-timeout=1800", "-q", "-p", "no:cacheprovider", str(tmp_path)]
    done = subprocess.run(asked, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stdout[-3000:]
    assert "1 passed" in done.stdout
