"""The result of a lens audit: its numbers, as JSON and in lines of text."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from isetval.lens.contradictions import Flag

WIDTH = 110


@dataclass(frozen=True)
class StatedFocus:
    """A film distance that is said to focus an object, and what the rays say (object to front vertex)."""

    film_mm: float
    stated_object_m: float
    found_object_m: float
    needed_film_mm: float


@dataclass(frozen=True)
class LensAudit:
    """What a lens file holds, and its contradictions.

    Attributes
    ----------
    film_mm : float
        Film to rear vertex for f-number, fall-off and chief rays: stated with the f-number, else the file's input plane.
    f_number : float
        Equivalent f-number of the on-axis pass region, 1/(2 sqrt(E/(pi L))).
    irradiance_factor : float
        E/L on the axis in sr.
    stated_f_number : mapping
        Name of a statement -> f-number (options, the file's own words, stored facts).
    light_factor : mapping
        Name of a statement -> (f_number / stated)^2, by which a model must multiply the light.
    r_mm, relative_illumination, chief_ray_angle_deg, field_angle_deg, distortion_percent : tuple
        Over the field up to the sensor corner.
    focus : tuple
        Pairs (object_m, best film_mm); object to front vertex, film to rear vertex; nan where nothing focuses.
    stated_focus : tuple of StatedFocus
    etendue_ratio : (3,)
        Smallest, mean and largest determinant of the ray map (1 conserves étendue).
    flags : tuple of Flag
    """

    file: str
    sha256: str
    name: str
    degree: int
    wavelengths_nm: tuple[float, ...]
    film_mm: float
    f_number: float
    irradiance_factor: float
    focal_length_mm: float
    entrance_pupil_radius_mm: float
    stated_f_number: Mapping[str, float]
    light_factor: Mapping[str, float]
    r_mm: tuple[float, ...]
    relative_illumination: tuple[float, ...]
    chief_ray_angle_deg: tuple[float, ...]
    field_angle_deg: tuple[float, ...]
    distortion_percent: tuple[float, ...]
    focus: tuple[tuple[float, float], ...]
    stated_focus: tuple[StatedFocus, ...]
    axial_color_um: Mapping[float, float]
    etendue_ratio: tuple[float, float, float]
    table_end_mm: float
    sensor_corner_mm: float
    stated_source: str
    flags: tuple[Flag, ...]

    def to_json(self) -> dict[str, Any]:
        """The audit as plain numbers, lists and words; infinity as the string "infinity", nan as null."""
        plain = asdict(self)
        curves = ("relative_illumination", "chief_ray_angle_deg", "field_angle_deg", "distortion_percent")
        for name in curves:
            plain[name] = {"r_mm": list(self.r_mm), "value": list(getattr(self, name))}
        plain["focus"] = {
            "object_m": [o for o, _ in self.focus],
            "film_mm": [f for _, f in self.focus],
            "stated": plain.pop("stated_focus"),
        }
        plain["axial_color_um"] = {str(k): v for k, v in self.axial_color_um.items()}
        plain.pop("r_mm")
        cleaned: dict[str, Any] = _jsonable(plain)
        return cleaned

    def lines(self) -> list[str]:
        """The audit in words, one line each."""
        return audit_lines(self)


def _jsonable(value: Any) -> Any:
    """Tuples as lists, infinities as words."""
    if isinstance(value, dict):
        return {k: _jsonable(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_jsonable(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "infinity" if value > 0 else None
    return value


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
