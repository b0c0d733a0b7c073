"""Lateral and axial colour by printed disks: centres and curved-edge SFR of five bands, and where weak channels' light lies."""

# %%
from __future__ import annotations

import numpy as np

import isetval
from analyses.flea3.common import wavelength
from isetval.core.campaign import Campaign, Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.scene import ChartTarget
from isetval.measure.edge.disk_edges import Disk

LEAST_DISKS = 12


def best_disks(campaign: Campaign, light: str, channel: str) -> tuple[Shot, Capture, list[Disk]] | None:
    """The exposure of a band in which a colour shows most disks with the smallest error; None where it shows too few."""
    found = []
    for shot in (s for s in campaign.shots if s.light == light and isinstance(s.target, ChartTarget) and s.target.disks):
        capture = campaign.captures[shot.name][0]
        disks = isetval.measure.disks(capture, shot.target.disks, channel)  # type: ignore[union-attr]
        good = [d for d in disks if d.accepted]
        if len(good) >= LEAST_DISKS:
            error = float(np.median([d.center_sigma_px[0] for d in good])) / np.sqrt(len(good))
            found.append((error, shot.name, shot, capture, disks))
    return min(found)[2:] if found else None


def color_errors(campaign: Campaign) -> dict[str, object]:
    """Growth of the picture against wavelength, sharpness against wavelength, and colours of one band against each other."""
    sensor = campaign.sensor
    lights = sorted({s.light for s in campaign.shots if s.light}, key=wavelength)
    shown = {(light, c): best_disks(campaign, light, c) for light in lights for c in "RGB"}
    main = {}
    for light in lights:
        most = [
            (np.median([d.center_sigma_px[0] for d in shown[light, c][2] if d.accepted]), c) for c in "RGB" if shown[light, c]
        ]
        if most:
            main[light] = min(most)[1]
    reference = "550nm" if "550nm" in main else min(main, key=lambda light: abs(wavelength(light) - 550))
    middle = [(n - 1) / 2 - o for n, o in zip((sensor.rows, sensor.cols), campaign.shots[-1].window[:2], strict=True)]
    bands, within = [], []
    for light, channel in main.items():
        shot, capture, disks = shown[light, channel]
        sfr = isetval.measure.disk_sfr(capture, disks)
        row = {
            "light": light,
            "nm": wavelength(light),
            "channel": channel,
            "exposure_s": shot.exposure.time_s,
            "disks": sfr.disks,
            "blur_px": float(np.median([d.blur_px for d in disks if d.accepted])),
            "mtf50_cy_px": sfr.mtf50_cy_px,
            "mtf50_sigma": sfr.mtf50_sigma,
            "mtf": sfr.mtf.tolist(),
            "mtf_sigma": sfr.mtf_sigma.tolist(),
            "frequency_cy_px": sfr.frequency_cy_px.tolist(),
        }
        if light != reference:
            color = isetval.measure.lateral_color(
                shown[reference, main[reference]][2], disks, center_px=tuple(middle), same_scene=False
            )
            row |= {
                "growth": color.growth,
                "growth_sigma": color.growth_sigma,
                "radial_px": color.radial_px,
                "radial_sigma_px": color.radial_sigma_px,
                "shift_px": list(color.mean_px),
                "radius_px": color.radius_px,
                "chi2_over_dof": color.chi2 / color.dof,
            }
        bands.append(row)
        for other in "RGB":
            if other == channel or not shown[light, other]:
                continue
            try:
                color = isetval.measure.lateral_color(disks, shown[light, other][2], center_px=tuple(middle))
                weak = isetval.measure.disk_sfr(shown[light, other][1], shown[light, other][2])
            except InputError:
                continue
            within.append(
                {
                    "light": light,
                    "channels": f"{other} against {channel}",
                    "disks": color.disks,
                    "mean_px": list(color.mean_px),
                    "sigma_px": list(color.mean_sigma_px),
                    "radial_px": color.radial_px,
                    "radial_sigma_px": color.radial_sigma_px,
                    "mtf50_cy_px": weak.mtf50_cy_px,
                    "mtf50_sigma": weak.mtf50_sigma,
                }
            )
    return {"reference": reference, "bands": bands, "within": within}
