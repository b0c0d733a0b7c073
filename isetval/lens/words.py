"""The lens audit in lines of text."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from isetval.lens.auditing import LensAudit

WIDTH = 110


def audit_lines(audit: LensAudit) -> list[str]:
    """An audit as lines of at most 110 characters."""
    wavelengths = ", ".join(f"{w:g}" for w in audit.wavelengths_nm)
    low, mean, high = audit.etendue_ratio
    head = [
        f"lens            {audit.name}  (degree {audit.degree}, {wavelengths} nm)",
        f"f-number        F/{audit.f_number:.2f} from the pass region (E/L {audit.irradiance_factor:.5f} sr on axis, "
        f"film {audit.film_mm:.4f} mm)",
        f"focal length    {audit.focal_length_mm:.3f} mm, entrance pupil radius {audit.entrance_pupil_radius_mm:.3f} mm",
        f"étendue         determinant {low:.3f} ... {high:.3f}, mean {mean:.3f}",
    ]
    for name, number in audit.stated_f_number.items():
        head.append(f"stated          F/{number:.2f} ({name}); light factor {audit.light_factor[name]:.2f}")
    return [*head, "", *_field_table(audit), "", *_focus_table(audit), "", *_flag_lines(audit)]


def _field_table(audit: LensAudit) -> list[str]:
    """Fall-off, chief ray, field angle and distortion over the field."""
    lines = ["height mm   rel. illum.   chief ray deg   field deg   distortion %"]
    for i in range(0, len(audit.r_mm), 3):
        lines.append(
            f"{audit.r_mm[i]:9.3f}   {audit.relative_illumination[i]:11.3f}   {audit.chief_ray_angle_deg[i]:13.1f}"
            f"   {audit.field_angle_deg[i]:9.1f}   {audit.distortion_percent[i]:12.2f}"
        )
    return lines


def _focus_table(audit: LensAudit) -> list[str]:
    """Conjugates, and the stated ones beside what they are."""
    lines = ["object m     film mm"]
    lines += [f"{'infinity' if math.isinf(o) else f'{o:g}':>8}   {f:9.4f}" for o, f in audit.focus]
    for s in audit.stated_focus:
        found = "infinity" if math.isinf(s.found_object_m) else f"{s.found_object_m:.3g} m"
        lines.append(
            f"stated: film {s.film_mm:.5f} mm for {s.stated_object_m:g} m; it focuses {found}, needed {s.needed_film_mm:.4f} mm"
        )
    if audit.axial_color_um:
        lines.append("axial color um: " + ", ".join(f"{w:g} nm {v:+.1f}" for w, v in audit.axial_color_um.items()))
    return lines


def _flag_lines(audit: LensAudit) -> list[str]:
    """The contradictions."""
    if not audit.flags:
        return ["no contradiction found"]
    lines = [f"{len(audit.flags)} contradictions"]
    for flag in audit.flags:
        lines.append(f"[{flag.code}]")
        for label, text in (("found", flag.found), ("needed", flag.needed), ("remedy", flag.remedy)):
            lines += textwrap.wrap(f"{label:>8}  {text}", WIDTH, subsequent_indent=" " * 10, initial_indent="  ")
    return lines
