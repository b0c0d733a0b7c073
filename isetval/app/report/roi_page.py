"""``isetval roi``: a page on which edges, patches and lines are drawn into a capture, and downloaded as TOML."""

from __future__ import annotations

import json

import numpy as np

from isetval.app.plots.edges import SHOWN_PX
from isetval.app.plots.thumbnails import data_url
from isetval.app.report.pages import rendered
from isetval.core.capture import Capture
from isetval.measure.edge.edge_finding import working_image


def roi_html(capture: Capture, name: str) -> str:
    """The page as text, one file without server or network."""
    rows, cols = capture.mosaic.shape
    facts = {"name": "".join(c if c.isprintable() else "?" for c in name), "rows": rows, "cols": cols}
    return rendered(
        "roi.html",
        script_name="roi.js",
        title=f"Regions of {facts['name']}",
        name=facts["name"],
        rows=rows,
        cols=cols,
        picture=data_url(_grey(capture)),
        facts=json.dumps(facts).replace("<", "\\u003c"),
    )


def _grey(capture: Capture) -> np.ndarray:
    """The greens between the half-percent ends with a display curve, (rows, cols, 3), at most `SHOWN_PX` a side."""
    image, _ = working_image(capture)
    step = max(1, round(max(image.shape) / SHOWN_PX))
    low, high = np.percentile(image, [0.5, 99.5])
    shown = np.clip((image[::step, ::step] - low) / max(high - low, 1e-9), 0, 1) ** (1 / 2.2)
    return np.repeat(np.rint(255 * shown).astype(np.uint8)[:, :, None], 3, axis=2)
