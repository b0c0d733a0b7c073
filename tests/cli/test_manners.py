"""Completion, dry runs, cache, scaffolds, plugins, control characters, Ctrl-C."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import isetval
from isetval.app.cli import main
from isetval.app.cli.console import harmless, understands_escapes
from isetval.app.demo import chosen_hidden
from isetval.camera.plugins import plugins_allowed
from isetval.core.toml import data_folder
from isetval.effects import catalogue
from isetval.scenes.edge_truth import EdgeBlur, EdgeTruth, edge_capture

LENS = data_folder() / "lens" / "default_lens.json"
CAMERA = data_folder() / "pixel4a" / "camera.toml"
ESC = "\x1b"


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion_knows_commands_and_options(run, shell):
    code, out, _ = run("completion", shell)
    assert code == 0
    for word in ("diagnose", "dry-run", "campaign"):
        assert word in out


def test_the_bash_script_is_one_that_bash_accepts(run, tmp_path):
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("no bash")
    assert run("completion", "bash", "-o", tmp_path / "c.sh")[0] == 0
    words = 'COMP_WORDS=(isetval dia); COMP_CWORD=1; _shtab_isetval; echo "${COMPREPLY[@]}"'
    done = subprocess.run([bash, "-c", f". {tmp_path}/c.sh; {words}"], capture_output=True, text=True, check=True)
    assert "diagnose" in done.stdout


def test_a_dry_run_tells_and_writes_nothing(run, run_json, lab, tmp_path):
    before = sorted(tmp_path.iterdir())
    code, result, _ = run_json("compare", CAMERA, lab, "--dry-run", "-o", tmp_path / "c.json")
    assert code == 0
    assert any("4 shots" in line and "12 frames" in line for line in result["would"])
    code, out, _ = run("measure", lab, "--role", "flat", "--dry-run", "-o", tmp_path / "m.html")
    assert code == 0
    assert "would measure 12 files" in out
    assert "m.html" in out
    code, _, err = run("simulate", "nothing.toml", lab, "--dry-run")
    assert code == 3
    assert "does not exist" in err
    assert run("effects", "new", "warm_side", "--dry-run")[0] == 0
    assert sorted(tmp_path.iterdir()) == before
    assert not Path("warm_side.py").exists()


def test_the_cache_is_shown_and_cleared(run, run_json, tmp_path, monkeypatch):
    monkeypatch.setenv("ISETVAL_CACHE", str(tmp_path / "cache"))
    assert run_json("cache")[1]["bytes"] == 0
    (tmp_path / "cache" / "renders").mkdir(parents=True)
    for i in range(3):
        (tmp_path / "cache" / "renders" / f"{i}.npz").write_bytes(bytes(1_000_000))
        os.utime(tmp_path / "cache" / "renders" / f"{i}.npz", (i, i))
    assert run_json("cache")[1]["parts"] == {"renders": {"bytes": 3_000_000, "files": 3}}
    assert run_json("cache", "clear", "--keep-mb", 1)[1]["freed_bytes"] == 2_000_000
    assert [p.name for p in (tmp_path / "cache" / "renders").iterdir()] == ["2.npz"]  # the one used last
    assert run("cache", "clear", "--dry-run")[0] == 0
    assert run_json("cache")[1]["bytes"] == 1_000_000


@pytest.fixture
def plugged(tmp_path, monkeypatch):
    """A folder with a scaffolded effect, a model that names it, and a clean catalogue afterwards."""
    import isetval.effects

    monkeypatch.chdir(tmp_path)
    before, path = dict(isetval.effects._plugged), list(sys.path)
    yield tmp_path
    isetval.effects._plugged.clear()
    isetval.effects._plugged.update(before)
    catalogue.cache_clear()
    sys.path[:] = path
    sys.modules.pop("corner_loss", None)


def _model_with_plugin(folder):
    shutil.copy(CAMERA.parent / "qe.csv", folder / "qe.csv")
    text = 'plugin = "corner_loss.py"\n' + CAMERA.read_text()
    head, found, tail = text.partition('[[effect]]\nname = "pixel_aperture"')
    assert found, "the camera's file has changed: put the effect elsewhere"
    new = '[[effect]]\nname = "corner_loss"\na = 0.2\n\n'
    (folder / "camera.toml").write_text(head + new + found + tail)
    return folder / "camera.toml"


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])  # workers know the plugin too
def test_a_scaffolded_effect_passes_its_own_test_and_is_used_as_a_plugin_only_when_allowed(run, run_json, plugged, lab, jobs):
    assert run("effects", "new", "corner_loss", "--stage", "optics")[0] == 0
    assert run("effects", "new", "corner_loss")[0] == 3  # nothing is overwritten
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_corner_loss.py"], capture_output=True, check=False
    )
    assert done.returncode == 0, done.stdout
    model = _model_with_plugin(plugged)
    code, _, err = run("compare", model, lab)
    assert code == 3
    assert "--allow-plugin" in err
    assert "corner_loss" not in catalogue()
    code, result, err = run_json("compare", model, lab, "--allow-plugin", "-j", jobs)
    assert code == 0, err
    assert result["models"] == ["pixel4a"]
    with plugins_allowed():
        loaded = isetval.load_model(model)
    shot = isetval.load_campaign(lab).shots[-1]
    plain = loaded.without("corner_loss").expected(shot)
    assert np.all(loaded.expected(shot) <= plain)


def test_a_plugin_that_is_no_effect_or_another_module_is_refused(plugged):
    for name, code, words in (
        ("empty_plugin", "x = 1\n", "holds no effect"),
        ("broken_plugin", "1 / 0\n", "cannot be run"),
        ("json", "", "another module"),
    ):
        (plugged / f"{name}.py").write_text(code)
        (plugged / "camera.toml").write_text(f'plugin = "{name}.py"\n' + CAMERA.read_text())
        with plugins_allowed(), pytest.raises(isetval.InputError, match=words):
            isetval.load_model(plugged / "camera.toml")
    (plugged / "camera.toml").write_text('plugin = "../x.py"\n' + CAMERA.read_text())
    with plugins_allowed(), pytest.raises(isetval.InputError):
        isetval.load_model(plugged / "camera.toml")


def test_control_characters_never_reach_the_terminal_or_a_toml(run, flat_dng, tmp_path):
    folder = tmp_path / "lab"
    folder.mkdir()
    shutil.copy(flat_dng, folder / f"good{ESC}[31m.dng")
    (folder / f"bad{ESC}]0;title\x07\r.dng").write_bytes(b"not a DNG")
    for words in (("measure", folder, "--role", "flat"), ("campaign", "init", folder), ("measure", folder / f"bad{ESC}.dng")):
        _, out, err = run(*words)
        assert out + err
        assert not {ESC, "\x07", "\r"} & set(out + err)
    text = (folder / "campaign.toml").read_text()
    assert not {c for c in text if ord(c) < 32} - {"\n", "\t"}
    assert isetval.load_campaign(folder).shots
    assert harmless(f"a{ESC}[1mb\n\tc ü 中") == "a\\x1b[1mb\n\tc ü 中"


def test_a_name_that_is_no_unicode_loses_no_result(run, flat_dng, tmp_path):
    folder = tmp_path / "lab"
    folder.mkdir()
    try:
        os.rename(flat_dng, os.fsencode(folder) + b"/\xff.dng")
    except OSError:
        pytest.skip("this file system takes Unicode only")
    for suffix in (".json", ".csv", ".html"):
        assert run("measure", folder, "--role", "flat", "-o", tmp_path / f"m{suffix}")[0] == 0
        assert (tmp_path / f"m{suffix}").stat().st_size > 1000
    code, _, err = run("campaign", "init", folder)
    assert code == 3
    assert "rename the file" in err


def test_no_escapes_where_they_are_not_understood(monkeypatch):
    class Terminal:
        def isatty(self):
            return True

    monkeypatch.setenv("TERM", "xterm")
    assert understands_escapes(Terminal())
    monkeypatch.setenv("TERM", "dumb")
    assert not understands_escapes(Terminal())
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr("isetval.app.cli.console.os.name", "nt")
    assert not understands_escapes(Terminal())  # no console of Windows answers here


@pytest.mark.slow
def test_ctrl_c_ends_with_one_line_and_no_traceback_of_workers(lab, tmp_path):
    command = [sys.executable, "-m", "isetval", "diagnose", str(CAMERA), str(lab), "-j", "2", "-o", str(tmp_path / "d.json")]
    child = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        env=os.environ | {"ISETVAL_CACHE": "off"},
    )  # fmt: skip
    time.sleep(8)
    os.killpg(child.pid, signal.SIGINT)  # as a terminal does: to all of them
    out, err = child.communicate(timeout=60)
    assert child.returncode == 130, (out, err)
    assert "Traceback" not in out + err
    assert err.count("interrupted") == 1
    assert not list(tmp_path.iterdir())


def test_the_known_answer_edge_is_what_the_ruler_finds(run_json, tmp_path):
    code, truth, err = run_json("edge", "-o", tmp_path / "e.dng", "--sigma-px", 0.8, "--angle-deg", 7)
    assert code == 0, err
    found = isetval.measure.sfr(isetval.read_dng(tmp_path / "e.dng"), channel="MONO")
    assert found.mtf50_cy_px == pytest.approx(truth["mtf50_cy_px"], rel=2e-3)  # no noise: whole codes, 1 of some thousand
    assert run_json("edge", "-o", tmp_path / "f.dng", "--size", 2)[0] == 3


def test_an_effect_of_ones_own_is_hidden_in_the_demo_only_where_its_program_is_allowed(run, plugged):
    from isetval.app.cli.laboratory_commands import _hidden_of

    assert run("effects", "new", "corner_loss", "--stage", "optics")[0] == 0
    code, _, err = run("demo", "--hide", "corner_loss.py", "-o", "d")
    assert code == 3
    assert "--allow-plugin" in err
    assert not (plugged / "d").exists()
    with plugins_allowed():
        assert _hidden_of("corner_loss.py:a=0.3") == "corner_loss:a=0.3"
    assert "corner_loss" in catalogue()
    assert chosen_hidden(isetval.load_model(CAMERA), "corner_loss:a=0.3").a == 0.3
    assert _hidden_of("vignetting") == "vignetting"


@pytest.mark.parametrize("words", [("measure", "edge.dng", "--role", "edge"), ("roi", "edge.dng"), ("lens", "audit", LENS)])
def test_open_shows_the_page_that_was_written_and_nothing_else_does(tmp_path, monkeypatch, words):
    shown = []
    monkeypatch.setattr("webbrowser.open", shown.append)
    monkeypatch.chdir(tmp_path)
    isetval.write_dng(tmp_path / "edge.dng", edge_capture(EdgeTruth(EdgeBlur(cutoff_cy_px=0.8), angle_deg=5.0), snr_bright=60))
    command = [*map(str, words), "-o", "page é.html", "-q"]
    assert main(command) == 0
    assert shown == []
    assert main([*command, "--open"]) == 0
    assert shown == [(tmp_path / "page é.html").resolve().as_uri()]
