"""Choosing a Mitsuba variant without risking the process."""

import os
import sys

import pytest

from isetval.core.errors import InputError, MissingPartError
from isetval.scenes.rendered import variants
from isetval.scenes.rendered.variants import SCALAR, choose_variant, llvm_libraries, probe_variant

pytestmark = pytest.mark.mitsuba


def test_scalar_is_the_default_and_needs_no_probe(monkeypatch):
    monkeypatch.setattr(variants, "probe_variant", lambda *a, **k: pytest.fail("probed"))
    assert choose_variant().variant == SCALAR
    assert choose_variant("auto", probe=False).variant == SCALAR


def test_a_library_that_is_none_fails_its_probe_and_scalar_is_used(tmp_path, monkeypatch):
    broken = tmp_path / "libLLVM-99.so"
    broken.write_bytes(b"not a library")
    monkeypatch.setattr(variants, "llvm_libraries", lambda: (str(broken),))
    monkeypatch.setattr(variants, "_has_nvidia_driver", lambda: False)
    choice = choose_variant("auto")
    assert choice.variant == SCALAR
    assert choice.cure
    assert [p.passed for p in choice.probes] == [False]
    assert not choice.probes[0].cached
    assert choose_variant("auto").probes[0].cached
    with pytest.raises(MissingPartError, match="libLLVM 19"):
        choose_variant("llvm_ad_spectral")


def test_cuda_that_fails_asks_for_a_driver_and_is_tried_anew(monkeypatch):
    monkeypatch.setattr(variants, "_has_nvidia_driver", lambda: False)
    with pytest.raises(MissingPartError, match=r"no NVIDIA driver found\); CUDA needs"):
        choose_variant("cuda_ad_spectral")
    answers = iter([(False, "exit code 1: Could not initialize OptiX!"), (True, "4 x 4 pixel render succeeded")])
    monkeypatch.setattr(variants, "_has_nvidia_driver", lambda: True)
    monkeypatch.setattr(variants, "_render_in_child", lambda *a: next(answers))
    for _ in range(2):  # the second time from memory
        with pytest.raises(MissingPartError, match=r"\(exit code 1: Could not initialize OptiX!\); CUDA needs"):
            choose_variant("cuda_ad_spectral")
    monkeypatch.setattr(variants, "_FAILED", {})  # as in a new process
    assert choose_variant("cuda_ad_spectral").variant == "cuda_ad_spectral"
    assert choose_variant("cuda_ad_spectral").probes[0].cached


def test_another_driver_is_probed_anew(tmp_path, monkeypatch):
    tried = []
    monkeypatch.setattr(variants, "_render_in_child", lambda *a: (tried.append(a), (True, ""))[1])
    monkeypatch.setattr(variants, "_DRIVER_FILE", tmp_path / "version")
    for version, devices in (("580.1", None), ("580.1", None), ("580.2", None), ("580.2", ""), ("580.2", "0")):
        (tmp_path / "version").write_text(f"{version}\nGCC\n")
        monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
        if devices is not None:
            monkeypatch.setenv("CUDA_VISIBLE_DEVICES", devices)
        probe_variant("cuda_ad_spectral")
    assert len(tried) == 4


def test_the_last_words_of_a_driver_tell_why():
    text = "Traceback\n  File x\nImportError: cuInit() failed.\nTwo causes\n The specific error message was\n  no device\n"
    assert variants._last_words(text, 1) == "exit code 1: ImportError: cuInit() failed. ... no device"
    assert variants._last_words("Traceback\nRuntimeError: no OptiX\n", 1) == "exit code 1: RuntimeError: no OptiX"
    assert variants._last_words("LLVM ERROR: Cannot select\nIn function: f\n", -6).endswith("signal 6: LLVM ERROR: Cannot select")


def test_the_library_that_aborts_the_process_kills_the_child_only():
    library = next((p for p in llvm_libraries() if variants._major(p) in (15, 16)), None)
    if library is None:
        pytest.skip("no libLLVM 15 or 16 on this machine")
    if not variants.mitsuba_version().startswith("3.9"):
        pytest.skip("the abort is one of Mitsuba 3.9")
    probe = probe_variant("llvm_ad_spectral", library)
    assert not probe.passed
    assert "killed by signal" in probe.message


def test_the_environment_names_the_variant(monkeypatch):
    monkeypatch.setenv("ISETVAL_VARIANT", SCALAR)
    assert choose_variant("auto").reason == "ISETVAL_VARIANT"
    monkeypatch.setenv("ISETVAL_VARIANT", "scalar_rgb")
    with pytest.raises(InputError, match="scalar_rgb"):
        choose_variant()


def test_choosing_imports_no_mitsuba():
    import subprocess

    code = (
        "import sys, isetval.scenes.rendered.variants as v\n"
        "v.choose_variant(); v.mitsuba_version(); assert 'mitsuba' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env=dict(os.environ))


def test_a_probe_that_hangs_is_given_up(monkeypatch):
    monkeypatch.setattr(variants.sys, "executable", "/bin/sleep")
    probe = probe_variant("llvm_ad_spectral", "", timeout_s=0.2, use_cache=False)
    assert not probe.passed
