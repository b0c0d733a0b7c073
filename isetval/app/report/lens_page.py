"""A lens audit as one self-contained page: what the file holds, its curves, where it contradicts itself."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isetval.app.plots.lens import lens_figures
from isetval.app.plots.sheets import Sheet
from isetval.app.report.measurement import page_of

if TYPE_CHECKING:
    from isetval.lens.audit_report import LensAudit

Table = list[tuple[str, ...]]
TITLES = (
    "Over the field, and focus",
    "Focus",
    "Spots, object at infinity",
    "MTF, object at infinity (full tangential, dashed sagittal)",
    "Depth of field",
)


def lens_html(result: Mapping[str, Any], audit: LensAudit, file: Path) -> str:
    """The page as text; ``result`` is that of ``isetval lens audit`` with its provenance."""
    count = len(audit.flags)
    tables = {TITLES[1]: _conjugates(audit)}
    return page_of(
        result,
        what="isetval lens audit",
        title=f"Lens {audit.name}",
        headline=[("the lens", _numbers(audit)), ("f-number", _f_numbers(audit))],
        sheets=[
            Sheet(title, tables.get(title, ()), (), figure)
            for title, figure in zip(TITLES, lens_figures(file, audit), strict=True)
        ],
        quality=[f"{count or 'no'} contradiction{'' if count == 1 else 's'} found"],
        notes=[f"{f.code.replace('_', ' ')}: {f.found}. Needed: {f.needed}. To do: {f.remedy}." for f in audit.flags],
    )


def _numbers(audit: LensAudit) -> Table:
    low, mean, high = audit.etendue_ratio
    rows = [
        ("focal length", f"{audit.focal_length_mm:.3f} mm"),
        ("entrance pupil radius", f"{audit.entrance_pupil_radius_mm:.3f} mm"),
        ("irradiance over radiance on the axis", f"{audit.irradiance_factor:.5f} sr"),
        ("fall-off at the corner of the sensor", f"{audit.relative_illumination[-1]:.3f}"),
        ("chief ray angle there", f"{audit.chief_ray_angle_deg[-1]:.1f} deg"),
        ("distortion there", f"{audit.distortion_percent[-1]:+.2f} %"),
        ("determinant of the ray map (1 conserves étendue)", f"{low:.3f} to {high:.3f}, mean {mean:.3f}"),
        ("wavelengths", ", ".join(f"{w:g}" for w in audit.wavelengths_nm) + " nm"),
    ]
    return [("of the file", "value"), *rows]


def _f_numbers(audit: LensAudit) -> Table:
    stated = [(name, f"F/{n:.2f}", f"{audit.light_factor[name]:.2f}") for name, n in audit.stated_f_number.items()]
    return [("source", "f-number", "light factor"), ("pass region", f"F/{audit.f_number:.2f}", "1"), *stated]


def _conjugates(audit: LensAudit) -> Table:
    rows = [("infinity" if math.isinf(o) else f"{o:g} m", f"{f:.4f} mm", "traced") for o, f in audit.focus]
    for s in audit.stated_focus:
        rows.append((f"{s.stated_object_m:g} m", f"{s.film_mm:.4f} mm", f"stated; needed {s.needed_film_mm:.4f} mm"))
    return [("object to front vertex", "film to rear vertex", ""), *rows]
