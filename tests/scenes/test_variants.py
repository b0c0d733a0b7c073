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
