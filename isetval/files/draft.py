"""A first ``campaign.toml`` for a folder of DNGs, from what the files say; a person completes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from isetval.core.capture import Capture, plane_black_dn, plane_view, planes_of
from isetval.core.errors import InputError
from isetval.core.paths import named_file
from isetval.core.sensor import Exposure
from isetval.core.writing import write_whole
from isetval.files.loose_files import RAW_SUFFIXES

ROLE_HINTS = ("dark", "flat", "edge", "chart", "scene")
DARK_LEVEL = 0.004


@dataclass(frozen=True)
class FileFacts:
    """What one file says: exposure, window, signal, guessed role."""

    file: str
    exposure: Exposure
    window: tuple[int, int, int, int]
    signal: float
    role: str
    why: str


@dataclass(frozen=True)
class Draft:
    """A drafted campaign: its text, shots found, and files that could not be read."""

    text: str
    shots: int
    skipped: tuple[tuple[str, str], ...]


def draft_campaign(folder: Path | str, *, role: str | None = None, camera: str = "") -> Draft:
    """A commented ``campaign.toml`` for the DNGs of a folder.

    Files of one exposure, window and guessed role become one shot.

    Raises
    ------
    InputError
        If the folder is missing or holds no DNG that can be read, or ``camera`` lies outside it.
    """
    from isetval.files.dng import read_dng

    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: is no folder; name the folder that holds the DNG files")
    if camera:
        named_file(camera, folder)
    files = sorted(p for p in folder.rglob("*") if p.suffix.lower() in RAW_SUFFIXES and not p.name.startswith("."))
    if not files:
        raise InputError(f"{folder}: holds no DNG file; name the folder that holds them")
    facts, skipped, first = [], [], None
    for path in files:
        try:
            capture = read_dng(path)  # the black level that the campaign will be read with
        except InputError as error:
            skipped.append((path.relative_to(folder).as_posix(), str(error)))
            continue
        first = first or capture
        facts.append(_facts(path.relative_to(folder).as_posix(), capture, role))
    if first is None:
        raise InputError(f"{folder}: none of its {len(files)} DNG files can be read; the first: {skipped[0][1]}")
    groups: dict[Any, list[FileFacts]] = {}
    for fact in facts:
        groups.setdefault((fact.role, fact.window, fact.exposure.time_s, fact.exposure.iso), []).append(fact)
    return Draft(_text(folder, first, list(groups.values()), camera), len(groups), tuple(skipped))


def write_draft(draft: Draft, folder: Path | str) -> Path:
    """Write the draft, unless the folder has a campaign already.

    Raises
    ------
    InputError
        If ``campaign.toml`` exists or cannot be written.
    """
    path = Path(folder) / "campaign.toml"
    if path.exists():
        raise InputError(f"{path}: exists already; rename it first (nothing was written)")
    write_whole(path, draft.text)
    return path


def _facts(file: str, capture: Capture, role: str | None) -> FileFacts:
    span = capture.sensor.white_dn - float(np.mean(capture.sensor.black_dn))
    signal = max(float(np.mean(plane_view(capture, p)[0])) - plane_black_dn(capture, p) for p in planes_of(capture)) / span
    guess, why = (role, "as told") if role else _guess(file, capture, signal)
    window = (*capture.window, capture.mosaic.shape[0], capture.mosaic.shape[1])
    return FileFacts(file, capture.exposure, window, signal, guess, why)


def _guess(file: str, capture: Capture, signal: float) -> tuple[str, str]:
    words = file.lower()
    for role in ROLE_HINTS:
        if role in words:
            return role, f"the name says {role}"
    if abs(signal) < DARK_LEVEL:
        return "dark", f"its mean lies {100 * signal:.2f} % of the range above black"
    view = plane_view(capture, planes_of(capture)[0])[0].astype(float)
    rows, cols = (max(1, n // 16) for n in view.shape)
    blocks = view[: rows * 16, : cols * 16].reshape(16, rows, 16, cols).mean(axis=(1, 3)) if min(view.shape) >= 16 else view
    spread = float(blocks.std() / max(blocks.mean() - plane_black_dn(capture, planes_of(capture)[0]), 1e-9))
    if spread < 0.35:
        return "flat", f"its blocks spread by {100 * spread:.0f} %: check that it is an even field"
    return "chart", f"its blocks spread by {100 * spread:.0f} %: edge, chart or scene; choose one and describe its target"


def _text(folder: Path, first: Capture, groups: Sequence[list[FileFacts]], camera: str) -> str:
    about = first.provenance
    lines = [
        "# Drafted by `isetval campaign init` from what the files say.  Lines marked CHECK need a person;",
        "# everything left out here (targets, spectra, levels, priors) makes a diagnosis weaker or wrong.",
        f"# Camera of the first file: {_comment(about.get('make')) or 'unknown maker'}, "
        f"{_comment(about.get('model')) or 'unknown model'}.",
        f"name = {_quoted(folder.resolve().name)}",
        "",
    ]
    lines += _camera_lines(first, camera) + _light_lines() + _nuisance_lines() + _target_lines(groups)
    for number, group in enumerate(groups, 1):
        lines += _shot_lines(number, group)
    return "\n".join(lines) + "\n"


def _comment(text: Any) -> str:
    """Text of a file's tags for a comment: on one line, whatever it holds."""
    return "".join(c if c.isprintable() else " " for c in str(text or "")).strip()


def _quoted(text: str) -> str:
    """A TOML string (JSON's escapes are TOML's, but for DEL)."""
    import json

    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


def _camera_lines(first: Capture, camera: str) -> list[str]:
    if camera:
        return [f"camera = {_quoted(camera)}", ""]
    s = first.sensor
    return [
        '# camera = "camera.toml"      # CHECK: the nominal model of this camera, needed for compare and diagnose',
        "[sensor]                      # CHECK: the full sensor; crops state their window below",
        f"rows = {s.rows}",
        f"cols = {s.cols}",
        f"pixel_um = {s.pixel_um:g}" + ("                # CHECK: the file does not say it" if s.pixel_um == 1.0 else ""),
        f'cfa = "{s.cfa}"',
        f"black_dn = {[list(row) for row in s.black_dn]}",
        f"white_dn = {s.white_dn:g}",
        f"bits = {s.bits}",
        "",
    ]


def _light_lines() -> list[str]:
    return [
        "[light.sphere]                # CHECK: spectral radiance of what the camera looked at, W/(sr m2 nm)",
        "radiance = 0.01               # a number, or a CSV file with wavelength_nm in its first column",
        "",
    ]


def _nuisance_lines() -> list[str]:
    rows = (
        ("light_level", 0.02, "relative", "set-up", "how well is the level of the light known?"),
        ("light_level", 0.002, "relative", "frame", "how much does it flicker from frame to frame?"),
        ("light_tilt_x", 0.01, "relative", "measurement session", "how even is the field, across?"),
        ("light_tilt_y", 0.01, "relative", "measurement session", "and down?"),
    )
    out = ["# How well the laboratory knows its numbers.  CHECK each; one left out becomes a false discovery."]
    for parameter, sigma, unit, scope, question in rows:
        out += ["[[nuisance]]", f'parameter = "{parameter}"', f"sigma = {sigma}                 # CHECK: {question}"]
        out += [f'unit = "{unit}"', f'scope = "{scope}"', *(['roles = ["flat"]'] if parameter != "light_level" else []), ""]
    return out


def _target_lines(groups: Sequence[list[FileFacts]]) -> list[str]:
    roles = {group[0].role for group in groups}
    out = []
    if "edge" in roles:
        out += ["[target.edge]                 # CHECK: the slanted edge", 'kind = "edge"', "angle_deg = 5.0"]
        out += ['orientation = "vertical"', "dark_reflectance = 0.05", "bright_reflectance = 0.8", ""]
    if "chart" in roles:
        out += ["[target.chart]                # CHECK: boxes [row0, row1, col0, col1] in the window, and reflectances"]
        out += ['kind = "chart"', 'patch = [{ name = "white", box = [0, 32, 0, 32], reflectance = 0.9 }]', ""]
    if "scene" in roles:
        out += ["[target.scene]                # CHECK: grey patches to measure in the picture, and the scene file"]
        out += ['kind = "scene"', 'file = "scene.toml"', ""]
    return out


def _shot_lines(number: int, group: Sequence[FileFacts]) -> list[str]:
    first = group[0]
    mean = 100 * float(np.mean([f.signal for f in group]))
    out = ["[[shot]]", f'name = "{first.role}_{number:02d}"', f'role = "{first.role}"                 # CHECK: {first.why}']
    out += [
        'measurement_session = "A"',
        f'setup = "{first.role}_{number:02d}"        # shots that shared one set-up share its name',
    ]
    if first.role != "dark":
        out += ['light = "sphere"', "light_level = 1.0             # CHECK: relative to the radiance above"]
    if first.exposure.time_s is not None:
        out.append(f"exposure_s = {first.exposure.time_s!r}")
    else:
        out.append("# exposure_s =                # CHECK: the file does not say it")
    if first.exposure.iso is not None:
        out.append(f"iso = {first.exposure.iso:g}")
    if first.role in ("edge", "chart", "scene"):
        out.append(f'target = "{first.role}"')
    out.append(f"window = {list(first.window)}   # CHECK: place of a crop on the sensor; mean {mean:.1f} % of the range")
    names = ", ".join(_quoted(f.file) for f in group)
    return [*out, f"files = [{names}]", ""]
