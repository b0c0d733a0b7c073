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

    def outcome(name):
        if name not in known:
            known[name] = run_trial(name, tmp_path_factory.mktemp(name))
        return known[name]

    return outcome
