"""Audit of a lens file: its f-number, fall-off, chief rays and focus, and where it contradicts itself or its label."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from isetval.core.cache import file_hash
from isetval.core.errors import InputError
from isetval.lens.audit_report import LensAudit, StatedFocus
from isetval.lens.consistency import entrance_pupil, ray_jacobian
from isetval.lens.contradictions import Findings, find_flags
from isetval.lens.focus import axial_color_um, film_for_object, object_for_film
from isetval.lens.illumination import distortion_percent, effective_f_number, field_angle_deg, focal_length_mm
from isetval.lens.known_lenses import StatedFacts, stated_facts
from isetval.lens.ray_transfer import RayTransferLens
from isetval.lens.transfer_file import load_lens

SENSOR_DIAGONAL_MM = 7.056
OBJECTS_M = (math.inf, 10.0, 3.0, 1.0, 0.5, 0.3, 0.1)


def audit(
    lens: RayTransferLens,
    *,
    stated_f_number: float | Mapping[str, float] | None = None,
    stated_focus: Mapping[float, float] | None = None,
    stated_focal_length_mm: float | None = None,
    sensor_diagonal_mm: float | None = None,
    film_mm: float | None = None,
    use_stored_facts: bool = True,
    file: str = "",
    sha256: str = "",
) -> LensAudit:
    """Examine a lens and list its contradictions.

    Parameters
    ----------
    stated_f_number : float or mapping
        F-number(s) the lens is said to have; added to what its name, description and the stored facts say.
    stated_focus : mapping
        Film distance (mm, film to rear vertex) -> object distance (m, object to front vertex).
    stated_focal_length_mm : float
    sensor_diagonal_mm : float
        Default 7.056 (the sensor of the published model) or what the stored facts say.
    film_mm : float
        Film distance at which the f-number is stated; default the stored fact, else the file's input plane.
    use_stored_facts : bool
        Look the lens's name up in ``data/lens/*_stated.toml``.
    """
    facts = _merged(lens, stated_f_number, stated_focus, stated_focal_length_mm, sensor_diagonal_mm, use_stored_facts)
    if film_mm is not None:
        facts = replace(facts, film_mm=film_mm)
    corner = (facts.sensor_diagonal_mm or SENSOR_DIAGONAL_MM) / 2
    result = _measured(lens, facts, corner, file, sha256)
    _, determinant = ray_jacobian(lens)
    stated = tuple((s.film_mm, s.stated_object_m, s.found_object_m, s.needed_film_mm) for s in result.stated_focus)
    findings = Findings(lens, result.f_number, facts, corner, result.focal_length_mm, determinant, stated)
    spread = (float(determinant.min()), float(determinant.mean()), float(determinant.max()))
    return replace(result, etendue_ratio=spread, flags=find_flags(findings))


def _measured(lens: RayTransferLens, facts: StatedFacts, corner_mm: float, file: str, sha256: str) -> LensAudit:
    """The numbers of an audit, without its flags."""
    r, film = np.linspace(0.0, corner_mm, 22), facts.film_mm
    f_number = float(effective_f_number(lens, film_mm=film))
    return LensAudit(
        file=file,
        sha256=sha256,
        name=lens.name,
        degree=lens.degree,
        wavelengths_nm=lens.wavelengths_nm,
        film_mm=lens.plane_offset_input_mm if film is None else film,
        f_number=f_number,
        irradiance_factor=float(lens.irradiance_factor(0.0, 0.0, film_mm=film)),
        focal_length_mm=focal_length_mm(lens),
        entrance_pupil_radius_mm=entrance_pupil(lens).mean_radius_mm,
        stated_f_number=facts.f_number,
        light_factor={name: (f_number / n) ** 2 for name, n in facts.f_number.items()},
        r_mm=_tuple(r),
        relative_illumination=_tuple(lens.relative_illumination(r, film_mm=film)),
        chief_ray_angle_deg=_tuple(lens.chief_ray_angle_deg(r, film_mm=film)),
        field_angle_deg=_tuple(field_angle_deg(lens, r)),
        distortion_percent=_tuple(distortion_percent(lens, r)),
        focus=_focus(lens),
        stated_focus=_stated_focus(lens, facts.focus_object_m),
        axial_color_um=axial_color_um(lens) if len(lens.tables) > 1 else {},
        etendue_ratio=(1.0, 1.0, 1.0),
        table_end_mm=lens.table().region.last_position_mm,
        sensor_corner_mm=corner_mm,
        stated_source=facts.source,
        flags=(),
    )


def audit_file(path: str | Path, **stated: Any) -> LensAudit:
    """Audit an ISET ray-transfer JSON; keyword arguments as in `audit`."""
    lens = load_lens(path)
    digest = file_hash(path)
    return audit(lens, file=Path(path).name, sha256=digest, **stated)


def _tuple(values: Any) -> tuple[float, ...]:
    """An array as a tuple of floats."""
    return tuple(float(v) for v in values)


def _focus(lens: RayTransferLens) -> tuple[tuple[float, float], ...]:
    """Best film distances for the standard object distances; nan where nothing focuses."""
    return tuple((distance, _film(lens, distance)) for distance in OBJECTS_M)


def _film(lens: RayTransferLens, object_m: float) -> float:
    """Best film distance, nan where there is none."""
    try:
        return film_for_object(lens, object_m)
    except InputError:
        return math.nan


def _stated_focus(lens: RayTransferLens, stated: Mapping[float, float]) -> tuple[StatedFocus, ...]:
    """Each stated pair beside what the rays say."""
    return tuple(
        StatedFocus(film, distance, object_for_film(lens, film), _film(lens, distance)) for film, distance in stated.items()
    )


def _merged(
    lens: RayTransferLens,
    f_number: float | Mapping[str, float] | None,
    focus: Mapping[float, float] | None,
    focal_length_mm: float | None,
    diagonal_mm: float | None,
    use_stored: bool,
) -> StatedFacts:
    """Statements from stored facts, the file's words and the caller, the later ones first in rank."""
    facts = stated_facts(lens.name) if use_stored else StatedFacts()
    numbers = dict(facts.f_number)
    numbers.update({f"the file's words '{text}'": n for text, n in f_numbers_in(f"{lens.name} {lens.description}")})
    if isinstance(f_number, Mapping):
        numbers.update(f_number)
    elif f_number is not None:
        numbers["stated"] = float(f_number)
    bad = {k: v for k, v in numbers.items() if not v > 0}
    if bad:
        raise InputError(f"stated f-number {bad}: positive numbers are needed")
    return StatedFacts(
        f_number=numbers,
        focus_object_m={**facts.focus_object_m, **(focus or {})},
        film_mm=facts.film_mm,
        focal_length_mm=focal_length_mm or facts.focal_length_mm,
        sensor_diagonal_mm=diagonal_mm or facts.sensor_diagonal_mm,
        source=facts.source,
    )


def f_numbers_in(text: str) -> list[tuple[str, float]]:
    """F-numbers that a text names, such as F/1.8, f/2 or F1.73."""
    found = re.findall(r"(?<![A-Za-z0-9])([fF]/\s?\d+(?:\.\d+)?|F\d+\.\d+)(?![\d.]*mm)", text)
    return [(f, float(re.sub(r"[^\d.]", "", f))) for f in found]
