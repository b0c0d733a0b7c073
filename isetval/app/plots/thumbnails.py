"""Small pictures inside a page."""

from __future__ import annotations

import base64
import io

import numpy as np
from numpy.typing import NDArray


def data_url(picture: NDArray[np.uint8]) -> str:
    """A picture (rows, cols, 3) as a PNG in a ``data:`` address: a page that holds it needs no other file."""
    from matplotlib.image import imsave

    out = io.BytesIO()
    imsave(out, picture, format="png")
    return "data:image/png;base64," + base64.b64encode(out.getvalue()).decode("ascii")
