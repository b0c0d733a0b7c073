"""Given metrics written beside a campaign: the rows as a table in this package's columns, their covariance beside it."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np

from isetval.core.campaign import Shot
from isetval.core.metric import Metric
from isetval.core.writing import write_whole
from isetval.files.campaign_tables import file_stem
from isetval.files.curve_file import COLUMNS

DIGITS = 17  # a float64 comes back to the last bit


def written_metrics(shot: Shot, folder: Path) -> dict[str, Any]:
    """Write a shot's given metrics into ``folder``; returns the keys of its table that name them (none: none)."""
    if shot.given is None:
        return {}
    stem = file_stem(shot.name)
    metrics = shot.given.block.metrics
    write_whole(folder / f"{stem}_metrics.csv", _table(metrics))
    out = {"metrics": f"{stem}_metrics.csv", "method": shot.given.method}
    if shot.given.block.correlation is not None:
        sigma = np.array([m.sigma for m in metrics])
        rows = shot.given.block.correlation * np.outer(sigma, sigma)
        lines = [",".join(f"{v:.{DIGITS}g}" for v in row) for row in rows]
        write_whole(folder / f"{stem}_covariance.csv", "\n".join(lines) + "\n")
        out["covariance"] = f"{stem}_covariance.csv"
    return out


def _table(metrics: tuple[Metric, ...]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows([_cells(m) for m in metrics])
    return text.getvalue()


def _cells(m: Metric) -> dict[str, str]:
    cells = {"name": m.name, "value": f"{m.value:.{DIGITS}g}", "sigma": f"{m.sigma:.{DIGITS}g}", "unit": m.unit}
    cells |= {"channel": m.channel, "patch": m.patch, "region": m.region}
    places = {"frequency_cy_px": m.frequency_cy_px, "radius_mm": m.field_x_mm, "level_dn": m.level}
    axis = next((name for name, at in places.items() if at is not None), "")
    return cells | ({axis: f"{places[axis]:.{DIGITS}g}"} if axis else {})
