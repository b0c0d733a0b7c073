"""Makes the foreign camera importable and keeps its trials for the session."""

from __future__ import annotations

import multiprocessing
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))


@pytest.fixture(scope="session")
def outcome_of(tmp_path_factory):
    """Outcome of a trial by name on the whole plan, each run once per session."""
    from trials import run_trial

    known = {}

    def outcome(name):
        if name not in known:
            known[name] = run_trial(name, tmp_path_factory.mktemp(name))
        return known[name]

    return outcome


@pytest.fixture(scope="session")
def short_outcomes(request, tmp_path_factory):
    """Outcomes by name of the trials that this run selects, on the short plan, two at a time."""
    from trials import short_trial, strict_worker

    names = [item.callspec.params["name"] for item in request.session.items if "short_outcomes" in item.fixturenames]
    folders = [tmp_path_factory.mktemp(name) for name in names]
    threads = {key: os.environ.get(key) for key in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
    os.environ.update(dict.fromkeys(threads, "1"))  # read by the workers when they start
    try:
        with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn"), initializer=strict_worker) as pool:
            return dict(zip(names, pool.map(short_trial, names, folders), strict=True))
    finally:
        for key, value in threads.items():
            os.environ.pop(key) if value is None else os.environ.update({key: value})
