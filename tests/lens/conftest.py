"""The published lens, where it is at hand."""

from __future__ import annotations

from pathlib import Path

import pytest

from isetval.lens.ray_transfer import RayTransferLens
from isetval.lens.transfer_file import load_lens

PIXEL4A = Path(__file__).resolve().parents[3] / "shared" / "data" / "pixel4a"


@pytest.fixture(scope="session")
def pixel4a_folder() -> Path:
    """Published Pixel 4a data beside the checkout (not part of the repository)."""
    if not PIXEL4A.is_dir():
        pytest.skip("the published Pixel 4a data are not beside the checkout (../shared/data/pixel4a)")
    return PIXEL4A


@pytest.fixture(scope="session")
def pixel4a(pixel4a_folder: Path) -> RayTransferLens:
    return load_lens(pixel4a_folder / "rtf_pixel4a_rear_ellipse_poly4.json")
