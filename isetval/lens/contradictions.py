"""The contradictions an audit looks for, one function each."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from isetval.lens.consistency import axis_roundness, direction_length_error, entrance_pupil, parity_error
from isetval.lens.known_lenses import StatedFacts
from isetval.lens.polynomials import FloatArray
from isetval.lens.tracing import TracedLens

F_NUMBER_TOLERANCE = 0.05
PIXEL_MM = 0.0014
ETENDUE_TOLERANCE = 0.005
ROUND_TOLERANCE = 0.001
UNCLIPPED_TOLERANCE = 0.03


@dataclass(frozen=True)
class Flag:
    """One contradiction: what was found, what would be needed, and what to do about it."""

    code: str
    found: str
    needed: str
    remedy: str


@dataclass(frozen=True, eq=False)
class Findings:
    """What the checks share; ``stated_focus`` rows are film mm, stated object m, found object m, needed film mm."""

    lens: TracedLens
    f_number: float
    facts: StatedFacts
    corner_mm: float
    focal_length_mm: float
    determinant: FloatArray
    stated_focus: tuple[tuple[float, float, float, float], ...]


def find_flags(f: Findings) -> tuple[Flag, ...]:
    """Every contradiction of a lens, gravest first."""
    checks = (
        _f_number,
        _sampled_pupil,
        _focus,
        _focal_length,
        _etendue,
        _table_end,
        _output_plane,
        _direction_length,
        _parity,
        _one_wavelength,
    )
    return tuple(flag for check in checks for flag in check(f))


def _f_number(f: Findings) -> Iterator[Flag]:
    """The pass region's f-number against each stated one."""
    diameter = 2 * entrance_pupil(f.lens).mean_radius_mm
    for name, stated in f.facts.f_number.items():
        ratio = f.f_number / stated
        if abs(ratio - 1) <= F_NUMBER_TOLERANCE:
            continue
        half = " (the pupil was sampled at half its diameter)" if abs(ratio - 2) < 0.05 else ""
        brighter = "darker" if ratio > 1 else "brighter"
        yield Flag(
            code="f_number",
            found=f"F/{f.f_number:.2f} from the pass region; entrance beam {diameter:.3f} mm wide for a focal length of "
            f"{f.focal_length_mm:.2f} mm, F/{f.focal_length_mm / diameter:.2f}",
            needed=f"F/{stated:.2f} ({name}): the file is {max(ratio, 1 / ratio) ** 2:.2f} times {brighter}, its defocus blur "
            f"{ratio:.2f} times too {'small' if ratio > 1 else 'large'}{half}",
            remedy=f"put a light factor of {ratio**2:.2f} into the model as a named effect and report it; do not enlarge the "
            "pass region (the polynomials hold only inside it) and do not hide it in a free gain",
        )


def _sampled_pupil(f: Findings) -> Iterator[Flag]:
    """Signs that the pass region is the rim of the sampling, not of the lens."""
    round_ = axis_roundness(f.lens.table())
    pupil = entrance_pupil(f.lens)
    unclipped = pupil.spread < UNCLIPPED_TOLERANCE
    askew = round_ is not None and max(round_) > ROUND_TOLERANCE
    if not (unclipped and askew) or round_ is None:
        return
    yield Flag(
        code="sampled_pupil",
        found=f"at all field heights the rim is the same circle in the entrance pupil, {pupil.mean_radius_mm:.3f} mm within "
        f"{pupil.spread:.1%}: no element clips anything; on the axis the region is {round_[0]:.2%} of its radius off center and "
        f"{round_[1]:.2%} out of round, as an ellipse through sampled points is and the rim of a round stop is not",
        needed="a region whose rim is that of the lens's stop and elements: centered and round on the axis",
        remedy="treat the region as the edge of the pupil that was sampled when the rays were made; the true pupil may be "
        "larger, so state its f-number from another source and use a named light factor",
    )


def _focus(f: Findings) -> Iterator[Flag]:
    """Stated film distances that do not focus the stated objects."""
    tolerance = PIXEL_MM * f.f_number
    for film, stated, found, needed in f.stated_focus:
        if abs(film - needed) <= tolerance:
            continue
        if math.isnan(needed):
            yield _no_focus(film, stated)
            continue
        blur = abs(film - needed) / f.f_number * 1e3
        yield Flag(
            code="focus_not_conjugate",
            found=f"film at {film:.5f} mm focuses {_metres(found)}",
            needed=f"film at {needed:.3f} mm for the stated {_metres(stated)} ({(film - needed) * 1e3:+.0f} um off, a disc of "
            f"{blur:.1f} um at F/{f.f_number:.2f})",
            remedy=f"set the film to {needed:.4f} mm, or state {_metres(found)} as the focus; with a pupil of the wrong size an "
            "agreeing MTF50 proves neither: compare the shape of the MTF too",
        )


def _no_focus(film: float, stated: float) -> Flag:
    """A stated object distance that no film distance focuses."""
    return Flag(
        code="focus_not_conjugate",
        found=f"no film distance near the file's image plane focuses an object at {_metres(stated)}",
        needed=f"a focus at film {film:.5f} mm, as stated",
        remedy="check the unit of the film distance and that the lens forms an image at all",
    )


def _metres(distance: float) -> str:
    """A distance in words."""
    return "infinity" if math.isinf(distance) else f"{distance:.3g} m"


def _focal_length(f: Findings) -> Iterator[Flag]:
    """A stated focal length against that of the rays."""
    stated = f.facts.focal_length_mm
    if stated is not None and abs(f.focal_length_mm / stated - 1) > 0.02:
        yield Flag(
            code="focal_length",
            found=f"{f.focal_length_mm:.3f} mm from rays parallel to the axis",
            needed=f"{stated:.3f} mm (stated)",
            remedy="check that file and statement belong to the same lens and unit",
        )


def _etendue(f: Findings) -> Iterator[Flag]:
    """The ray map must keep étendue."""
    low, mean, high = f.determinant.min(), f.determinant.mean(), f.determinant.max()
    if abs(mean - 1) > ETENDUE_TOLERANCE or max(abs(low - 1), abs(high - 1)) > 4 * ETENDUE_TOLERANCE:
        yield Flag(
            code="etendue",
            found=f"determinant of the ray map {low:.3f} to {high:.3f}, mean {mean:.3f}",
            needed="1.000 everywhere (air on both sides)",
            remedy="take the irradiance from the film side (pass region), where this error does not enter, and expect "
            f"{abs(mean - 1):.1%} between film-side and scene-side light; a fit of odd degree with imposed symmetry lowers it",
        )


def _table_end(f: Findings) -> Iterator[Flag]:
    """The table must reach the sensor corner."""
    last = f.lens.table().region.last_position_mm
    if last < f.corner_mm - 1e-9:
        yield Flag(
            code="table_ends_before_corner",
            found=f"last field height {last:.3f} mm",
            needed=f"{f.corner_mm:.3f} mm, the sensor corner",
            remedy="isetval holds the last pass region beyond the table and marks those rays (beyond_table); readers that block "
            "them make black corners",
        )


def _output_plane(f: Findings) -> Iterator[Flag]:
    """The fitted output height must be that of the header."""
    for table in f.lens.tables:
        z = table.polynomials.output_plane_mm
        header = f.lens.thickness_mm + f.lens.plane_offset_output_mm
        if z is not None and abs(z - header) > 1e-3:
            yield Flag(
                code="output_plane",
                found=f"outz is {z:.5f} mm above the rear vertex ({table.wavelength_nm:g} nm)",
                needed=f"thickness + planeoffsetoutput = {header:.5f} mm",
                remedy=f"isetval uses outz; a reader that uses the header is {abs(z - header) * 1e3:.1f} um off along the axis, "
                "which matters only for objects within centimetres",
            )


def _direction_length(f: Findings) -> Iterator[Flag]:
    """The fitted outdz must give unit directions."""
    error = direction_length_error(f.lens)
    if error > 1e-3:
        yield Flag(
            code="direction_length",
            found=f"fitted outdz differs from sqrt(1 - outdx^2 - outdy^2) by up to {error:.4f}",
            needed="unit directions",
            remedy="isetval computes dz from dx and dy; a reader that uses outdz must normalise",
        )


def _parity(f: Findings) -> Iterator[Flag]:
    """Terms that a rotationally symmetric lens cannot have."""
    shift_um, tilt_mrad = parity_error(f.lens)
    if shift_um > 0.05 or tilt_mrad > 0.02:
        yield Flag(
            code="mirror_symmetry",
            found=f"terms that break the mirror symmetry about the meridian move rays by up to {shift_um:.2f} um and "
            f"{tilt_mrad:.3f} mrad",
            needed="none in a rotationally symmetric lens",
            remedy="use lens.without_wrong_parity(), or state that the file's terms were kept",
        )


def _one_wavelength(f: Findings) -> Iterator[Flag]:
    """Chromatic aberration needs several tables."""
    if len(f.lens.tables) == 1:
        yield Flag(
            code="one_wavelength",
            found=f"one table, {f.lens.wavelengths_nm[0]:g} nm",
            needed="three or more wavelengths for axial and lateral color",
            remedy="say in reports that the lens has no chromatic aberration, or give one file per wavelength",
        )
