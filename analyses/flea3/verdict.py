"""Compare, diagnose, add, and the error on captures left out: other exposures, another wavelength, the other visit."""

# %%
from __future__ import annotations

from collections.abc import Callable

import isetval
from analyses.flea3.common import Laboratory
from isetval.core.campaign import Campaign

Say = Callable[[str], None]
USED_S, HELD_S = (0.1, 0.5), (0.25, 2.0)  # of seven times: two to learn from, two to confirm on
HELD_LIGHT = "650nm"


def part(campaign: Campaign, times: tuple[float, ...], *, without: str = "", only: str = "") -> Campaign:
    """The lit shots of some exposures, and the darks of all."""
    kept = [
        s.name
        for s in campaign.shots
        if s.role == "dark" or (s.exposure.time_s in times and s.light != without and (not only or s.light == only))
    ]
    return campaign.only(kept)


def verdict(laboratory: Laboratory, model: isetval.CameraModel, *, jobs: int = 2, say: Say | None = None) -> dict[str, object]:
    """The diagnosis of the charts, and mean-square z of the first and last model on what was left out."""
    charts = laboratory.charts
    used, held = part(charts, USED_S), part(charts, HELD_S)
    found = isetval.diagnose(model, used, held, jobs=jobs, say=say, with_next_captures=False)
    better = found.apply() if found.effects else None
    out: dict[str, object] = {"diagnosis": found.to_json(), "used_s": list(USED_S), "held_s": list(HELD_S)}
    outside = {
        "other exposures": held,
        f"another wavelength ({HELD_LIGHT})": part(charts, HELD_S, only=HELD_LIGHT),
        "the other visit (disks)": part(laboratory.disks, HELD_S),
    }
    out["left_out"] = {name: ladder(model, better, campaign, say) for name, campaign in outside.items()}
    return out


def ladder(
    model: isetval.CameraModel, better: isetval.CameraModel | None, campaign: Campaign, say: Say | None
) -> list[dict[str, object]]:
    """Mean-square z and relative error by family of one model or both, nuisances refitted."""
    models = [model.sampled_as(campaign.sensor)]
    if better is not None:
        from dataclasses import replace

        models.append(replace(better, name=f"{model.name} as diagnosed", sensor=models[0].sensor))
    rows = isetval.compare(models, campaign, say=say).ladder
    return [
        {k: getattr(row, k) for k in ("model", "family", "n", "mean_square_z", "rms_relative_error") if hasattr(row, k)}
        for row in rows
    ]
