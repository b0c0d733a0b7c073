"""Pictures of raw captures as a person would look at them: half size, white balanced, with a display curve."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from isetval.core.capture import Capture, plane_black_dn, plane_view

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Float = NDArray[np.float64]


def half_size_rgb(capture: Capture) -> Float:
    """One RGB value for each 2 x 2 cell of a Bayer capture, (rows // 2, cols // 2, 3), DN above black; no demosaicing."""
    planes = {}
    for name in ("R", "Gr", "Gb", "B"):
        view, _, _ = plane_view(capture, name)
        planes[name] = view.astype(float) - plane_black_dn(capture, name)
    rows, cols = (min(p.shape[i] for p in planes.values()) for i in (0, 1))
    cut = {name: p[:rows, :cols] for name, p in planes.items()}
    return np.stack([cut["R"], (cut["Gr"] + cut["Gb"]) / 2, cut["B"]], axis=-1)


def display(rgb: Float, *, gains: Sequence[float], white: float) -> Float:
    """Linear RGB as display values 0..1: times the gains, over ``white``, clipped, with the sRGB curve."""
    linear = np.clip(rgb * np.asarray(gains, float) / white, 0, 1)
    return np.asarray(np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055))


def capture_sheet(pictures: Sequence[tuple[str, Float]], *, columns: int = 2, note: str = "") -> Figure:
    """Pictures (title, display RGB) side by side, pixel for pixel, with a note below."""
    from matplotlib.figure import Figure

    rows = -(-len(pictures) // columns)
    figure = Figure(figsize=(6.2 * columns, 4.6 * rows + 0.4), layout="constrained")
    for i, (title, picture) in enumerate(pictures, 1):
        axis = figure.add_subplot(rows, columns, i)
        axis.imshow(picture, interpolation="nearest")
        axis.set_title(title, fontsize=10)
        axis.set_axis_off()
    if note:
        figure.supxlabel(note, fontsize=8)
    return figure
