"""Folders of small captures."""

import pytest
from batch_runs import write_flat


@pytest.fixture(scope="session")
def captures(tmp_path_factory):
    """Twenty-four whole captures."""
    folder = tmp_path_factory.mktemp("captures")
    for i in range(24):
        write_flat(folder / f"capture_{i:03d}.dng", i)
    return folder
