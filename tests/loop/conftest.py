"""What tests of the loop share: the camera that ships."""

import pytest

from isetval import load_model
from isetval.core.toml import data_folder


@pytest.fixture(scope="module")
def model():
    """The embedded camera."""
    return load_model(data_folder() / "pixel4a" / "camera.toml")
