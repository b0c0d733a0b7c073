"""Numbers of a sensor's data sheet from one photon-transfer series, for given tables; nothing without one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from isetval.core.campaign import Shot
from isetval.core.capture import Capture, planes_of
from isetval.core.metric import Block, Metric
from isetval.measure.noise.emva import EmvaTable, emva1288

ROLES = ("flat",)
SYMBOLS = {"conversion_gain": "K", "temporal_dark_noise": "sigma_d", "dsnu": "DSNU1288", "prnu": "PRNU1288"}
"""Names of the rows, and the symbols of the standard that they stand for."""
GIVES = tuple(SYMBOLS)


def analyze(shot: Shot, captures: Sequence[Capture], choices: Mapping[str, Any]) -> Block:
    """Gain in DN/e-, dark noise and DSNU in e-, PRNU in % after EMVA 1288, by this package's estimators.

    ``captures`` are darks and flats at some levels; a row without a plane is of the first green one.
    """
    if "wanted" not in choices:
        return Block(())
    table = emva1288(captures)
    planes = planes_of(captures[0])
    usual = "Gr" if "Gr" in planes else planes[0]
    rows = (_row(row, table, row.channel or usual) for row in choices["wanted"])
    return Block(tuple(row for row in rows if row is not None))


def _row(row: Metric, table: EmvaTable, plane: str) -> Metric | None:
    try:
        found = table[plane, SYMBOLS[row.name]]
    except KeyError:
        return None
    if not (math.isfinite(found.value) and math.isfinite(found.sigma)):
        return None
    return replace(row, value=found.value, sigma=max(found.sigma, 1e-9))
