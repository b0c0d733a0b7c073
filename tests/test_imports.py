"""Import discipline: fast, lazy, one direction, no network."""

import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parent.parent
# the design asks for 0.3 s on a quiet machine; CPU seconds are compared, with room for slow test machines
IMPORT_CPU_S = 1.0
HEAVY = ("scipy", "pandas", "matplotlib", "cv2", "rawpy", "mitsuba", "skimage", "jinja2", "tifffile")


def _child(code):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    "statement", ["import isetval", "from isetval.app.cli.parser import build_parser; build_parser().format_help()"]
)
def test_importing_and_help_are_quick_and_load_nothing_heavy(statement):
    code = f"""
import json, sys, time
began = time.process_time()
{statement}
spent = time.process_time() - began
print(json.dumps([spent, sorted(set(m.split('.')[0] for m in sys.modules))]))
"""
    spent, modules = _child(code)
    assert not set(HEAVY) & set(modules), sorted(set(HEAVY) & set(modules))
    assert spent < IMPORT_CPU_S


def test_contracts_of_the_import_linter_hold():
    linter = Path(sys.executable).parent / "lint-imports"
    if not linter.exists():
        pytest.skip("import-linter is not installed (extra: test)")
    done = subprocess.run([str(linter), "--no-cache"], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout[-3000:]


def test_every_public_name_loads():
    code = """
import json, isetval
print(json.dumps([name for name in isetval.__all__ if getattr(isetval, name, None) is None]))
"""
    assert _child(code) == []


def test_no_module_bears_the_name_of_a_public_function():
    import isetval

    rooms = {name for name in isetval.__all__ if isinstance(getattr(isetval, name), ModuleType)}
    functions = {name for name in (*isetval.__all__, *isetval.measure.__all__) if name.islower()} - rooms
    modules = {path.stem for path in (ROOT / "isetval").rglob("*.py")}
    assert not functions & modules


def test_measuring_a_file_opens_no_connection(tmp_path):
    """Sockets are forbidden in the child: the main job needs no network."""
    code = f"""
import json, socket
def refuse(*args, **more):
    raise OSError("no network in this test")
socket.socket = refuse
import numpy as np, isetval
from isetval.app.cli import main
rng = np.random.default_rng(0)
isetval.write_dng({str(tmp_path / "a.dng")!r}, isetval.Capture.from_array(rng.integers(60, 200, (64, 64))))
code = main(["measure", {str(tmp_path / "a.dng")!r}, "--quiet", "-o", {str(tmp_path / "m.json")!r}])
print(json.dumps(code))
"""
    assert _child(code) == 0


def test_completion_shows_what_there_is():
    code = """
import json, isetval
rooms = ("effects", "lens", "measure", "plots", "report", "testing")
shown = [name for name in rooms if name in dir(isetval)]
print(json.dumps([shown, [getattr(isetval, name).__name__ for name in shown], "vignetting" in isetval.effects.catalogue()]))
"""
    shown, modules, known = _child(code)
    assert shown == ["effects", "lens", "measure", "plots", "report", "testing"]
    assert modules == [f"isetval.{'app.' * (name in ('plots', 'report'))}{name}" for name in shown]
    assert known
