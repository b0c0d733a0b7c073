"""What was found goes into the model, and the error on captures left out is compared: a band, two exposures, the other visit.

The response (offset, bend) is fitted on the charts without 650 nm, .25 s and 2 s; each model is then held against exactly these,
and against the disks of the first visit.  ``diagnose=True`` asks isetval for the missing effect by itself (half an hour).
"""

# %%
from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import isetval
from analyses.flea3.common import Laboratory
from analyses.flea3.levels import Rows, frozen, linearity
from isetval.core.campaign import Campaign
from isetval.effects import catalogue
from isetval.files.chart_parts import PARTS

Say = Callable[[str], None]
HELD_S, HELD_LIGHT = (0.25, 2.0), "650nm"
DISK_S = (0.1, 0.5)
NAMED = "with what was named"


def part(campaign: Campaign, times: tuple[float, ...], *, only: str = "") -> Campaign:
    """The lit shots of some exposures, of one light or all."""
    return campaign.only(
        s.name for s in campaign.shots if s.role != "dark" and s.exposure.time_s in times and only in ("", s.light)
    )


def without(rows: Rows) -> Rows:
    """The rows that the response may be fitted to."""
    keep = ~np.isin(rows.time_s, HELD_S) & (rows.light != rows.lights.index(HELD_LIGHT))
    arrays = {k: getattr(rows, k)[keep] for k in ("light", "channel", "patch", "time_s", "value", "sigma")}
    return replace(rows, **arrays)


def steps(model: isetval.CameraModel, line: dict[str, Any]) -> list[isetval.CameraModel]:
    """The nominal model, with the offset, and with the bend as well."""
    offset = replace(model.with_values({"black_level.offset_dn": line["offset_dn"][0]}), name="with the offset")
    full = model.sensor.white_dn / model.value("conversion_gain.gain_dn_per_e")
    bend = catalogue()["nonlinearity"](a=line["bend"][0], well_e=full)
    return [model, offset, replace(offset.with_effect(bend), name="with offset and bend")]


def of_light(rows: Rows, light: str) -> Rows:
    """The rows of one light."""
    keep = rows.light == rows.lights.index(light)
    return replace(rows, **{k: getattr(rows, k)[keep] for k in ("light", "channel", "patch", "time_s", "value", "sigma")})


def verdict(
    laboratory: Laboratory,
    model: isetval.CameraModel,
    charts: Rows,
    disks: Rows,
    *,
    diagnose: bool,
    say: Say | None = None,
) -> dict[str, Any]:
    """Mean-square z of the steps on what was left out; with ``diagnose`` the catalogue's answer too."""
    line = linearity(without(charts))
    response = {
        "straight": (0.0, 0.0),
        "offset": (line["offset_dn"][0], 0.0),
        "offset and bend": (line["offset_dn"][0], line["bend"][0]),
    }
    parts = {f"charts, {HELD_LIGHT}, all exposures": of_light(charts, HELD_LIGHT), "disks of the other visit": disks}
    models = steps(model, line)
    outside = {
        f"charts, {HELD_LIGHT} at .25 and 2 s": part(laboratory.charts, HELD_S, only=HELD_LIGHT),
        "disks of the other visit": part(laboratory.disks, DISK_S),
    }
    out: dict[str, Any] = {
        "offset_dn": line["offset_dn"],
        "bend": line["bend"],
        "frozen": {where: {name: frozen(own, *r) for name, r in response.items()} for where, own in parts.items()},
        "left_out": {name: ladder(models, campaign, say) for name, campaign in outside.items()},
    }
    if diagnose:
        learn, confirm, judge = (isetval.load_campaign(laboratory.folder / f"campaign_{name}.toml") for name in PARTS)
        found = isetval.diagnose(model, learn, confirm, say=say, with_next_captures=False)
        out["diagnosis"] = found.to_json()
        rungs = [model, replace(found.model, name=NAMED)] if found.effects else [model]
        out["left_out"]["one band and every third exposure of the others"] = ladder(rungs, judge, say)
    return out


def ladder(models: list[isetval.CameraModel], campaign: Campaign, say: Say | None) -> list[dict[str, Any]]:
    """Mean-square z and relative error of each model over all families, nuisances refitted, and whether that fit settled."""
    sampled = [m.sampled_as(campaign.sensor) for m in models]
    found = isetval.compare(sampled, campaign, say=say)
    names = ("model", "family", "n", "mean_square_z", "rms_relative_error")
    unsettled = {m.name for m in sampled for note in found.notes if note.startswith(f"{m.name}: ") and "did not settle" in note}
    rows = [row for row in found.ladder if row.family != "all"]
    return [{k: getattr(row, k) for k in names} | {"settled": row.model not in unsettled} for row in rows]
