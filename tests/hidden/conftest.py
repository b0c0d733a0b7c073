"""Makes the foreign camera importable and keeps its trials for the session."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))


@pytest.fixture(scope="session")
def outcome_of(tmp_path_factory):
    """Outcome of a trial by name, each run once per session."""
    from trials import run_trial

    known = {}

    def outcome(name, *, short=False):
        if (name, short) not in known:
            known[name, short] = run_trial(name, tmp_path_factory.mktemp(name), short=short)
        return known[name, short]

    return outcome
