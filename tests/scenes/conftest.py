"""Shared parts of the rendering tests: a cache folder of their own, and plain scenes."""

import pytest


@pytest.fixture(autouse=True)
def cache_folder(tmp_path_factory, monkeypatch):
    folder = tmp_path_factory.mktemp("cache")
    monkeypatch.setenv("ISETVAL_CACHE", str(folder))
    monkeypatch.delenv("ISETVAL_VARIANT", raising=False)
    return folder


@pytest.fixture(scope="session")
def fast_variant(tmp_path_factory):
    """A wavefront variant that works here, or a skip."""
    import os

    from isetval.scenes.rendered.variants import SCALAR, choose_variant

    kept = {name: os.environ.pop(name, None) for name in ("ISETVAL_VARIANT", "ISETVAL_CACHE")}
    os.environ["ISETVAL_CACHE"] = str(tmp_path_factory.mktemp("variants"))
    try:
        choice = choose_variant("auto")
    finally:
        for name, value in kept.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value
    if choice.variant == SCALAR:
        pytest.skip("no LLVM or CUDA variant passes its probe render here")
    return choice.variant
