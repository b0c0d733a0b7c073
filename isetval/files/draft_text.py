"""The text of a drafted ``campaign.toml``: what nobody can know at its top, and a comment on every number that was found."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from textwrap import wrap

from isetval.core.errors import InputError
from isetval.files.draft_types import Draft, DraftLight, DraftPrior, DraftShot, DraftTarget

WIDTH = 118
ILLUMINANTS = "isetval:spectra/illuminants.csv"
LIGHT_CHOICES = (
    'Published spectra that come with isetval (radiance = "isetval:spectra/illuminants.csv" and column): A tungsten at 2856 K; '
    "D50, D65 daylight; F2 cool white, F7 daylight fluorescent; E equal energy. Their scale is in W/(sr m2 nm) per unit."
)


def draft_text(draft: Draft) -> str:
    """The whole file."""
    parts: list[str] = [*_head(draft), *_unknown(draft), *_found(draft), *_camera(draft)]
    for light in draft.lights:
        parts += _light(light)
    for prior in draft.priors:
        parts += _prior(prior)
    for target in draft.targets:
        parts += _target(target)
    with_camera = any(light.level_known for light in draft.lights)
    for shot in draft.shots:
        parts += _shot(shot, draft_camera=with_camera)
    parts += _left_out(draft)
    return "\n".join(parts) + "\n"


def comment(text: str, *, indent: str = "# ") -> list[str]:
    """Text as comment lines; line breaks and control characters that came out of a file's tags stay inside the comment."""
    plain = "".join(c if c.isprintable() else " " for c in text)
    return [f"{indent}{line}".rstrip() for line in wrap(" ".join(plain.split()), WIDTH, subsequent_indent="  ")]


def quoted(text: str) -> str:
    """A TOML string: JSON's escapes are TOML's, but for the control character that JSON leaves as it is.

    Raises
    ------
    InputError
        For the name of a file that is no Unicode: TOML cannot hold it.
    """
    if any("\ud800" <= c <= "\udfff" for c in text):
        shown = text.encode("utf-8", "backslashreplace").decode()
        raise InputError(f"{shown}: the name is not UTF-8, and a campaign.toml cannot name it; rename the file")
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def value(item: object) -> str:
    """A TOML value."""
    if isinstance(item, str):
        return quoted(item)
    if isinstance(item, bool):
        return str(item).lower()
    if isinstance(item, Mapping):
        return "{ " + ", ".join(f"{_key(str(key))} = {value(part)}" for key, part in item.items()) + " }"
    if isinstance(item, list | tuple):
        return "[" + ", ".join(value(part) for part in item) + "]"
    return repr(float(item)) if isinstance(item, float) else str(item)


def _table(head: str, entries: Mapping[str, object]) -> list[str]:
    return [head, *(f"{key} = {value(item)}" for key, item in entries.items() if item is not None and item != "")]


def _head(draft: Draft) -> list[str]:
    about = (
        "Drafted by `isetval campaign init`: groups, set-ups, poses and levels were read off the files. It runs as it is with "
        "isetval measure, compare and diagnose; what was found stands in campaign.html as pictures. After a change, "
        "`isetval campaign check` says what would be measured."
    )
    camera = f"Camera of the files: {draft.maker or 'unknown'}."
    return [*comment(about), *comment(camera), f"name = {quoted(draft.name)}", ""]


def _unknown(draft: Draft) -> list[str]:
    out = ["# ---- CHECK: what the files cannot say " + "-" * 60]
    for what, needs, without in draft.unknown:
        out += comment(f"{what}: {needs}  Without it: {without}")
    return [*out, *comment(LIGHT_CHOICES), "# " + "-" * 98, ""]


def _found(draft: Draft) -> list[str]:
    if not draft.found:
        return []
    lines = ["# What the darks say (isetval measure):"]
    for sentence in draft.found:
        lines += comment(sentence, indent="#   ")
    return [*lines, ""]


def _camera(draft: Draft) -> list[str]:
    named = [f"camera = {quoted(draft.camera)}", ""] if draft.camera else []
    if named and not draft.resampled:
        return named
    s = draft.sensor
    entries: dict[str, object] = {
        "rows": s.rows, "cols": s.cols, "pixel_um": float(s.pixel_um), "cfa": s.cfa,
        "black_dn": [[float(v) for v in row] for row in s.black_dn], "white_dn": float(s.white_dn), "bits": s.bits,
    }  # fmt: skip
    words = "the pictures' own pixels: larger than the camera's, on the same sensor" if draft.resampled else ""
    return [*named, *comment(words), *_table("[sensor]", entries), ""]


def _light(light: DraftLight) -> list[str]:
    known = "scaled to what the camera model sees" if light.level_known else "its scale is a guess: no camera model was given"
    entries: dict[str, object] = {"radiance": light.file or ILLUMINANTS, "column": light.column}
    if light.band_nm is not None:
        entries = {"peak_nm": light.band_nm[0], "width_nm": light.band_nm[1]}
    if light.within_nm is not None:
        known += "; beyond within_nm its table scatters by more than half of its values, so that it is cut there"
        entries["within_nm"] = list(light.within_nm)
    entries["scale"] = float(f"{light.scale:.6g}")
    return [*comment(f"CHECK: {light.name}: {known}"), *_table(f"[light.{_key(light.name)}]", entries), ""]


def _key(name: str) -> str:
    return name if name.replace("_", "").replace("-", "").isalnum() and name.isascii() else quoted(name)


def _prior(prior: DraftPrior) -> list[str]:
    entries: dict[str, object] = {
        "parameter": prior.parameter, "sigma": float(f"{prior.sigma:.4g}"), "unit": prior.unit, "scope": prior.scope,
        "roles": list(prior.roles) or None, "lights": list(prior.lights) or None,
    }  # fmt: skip
    return [*comment(prior.comment), *_table("[[nuisance]]", entries), ""]


def _target(target: DraftTarget) -> list[str]:
    out = [*comment(target.comment), *_table(f"[target.{_key(target.name)}]", target.table)]
    if target.patches:
        rows = [
            f"  {{ name = {quoted(name)}, box = {value(list(box))}, reflectance = {value(reflectance)} }},"
            for name, box, reflectance in target.patches
        ]
        out += ["patch = [", *rows, "]"]
    return [*out, ""]


def _shot(shot: DraftShot, *, draft_camera: bool = False) -> list[str]:
    fact, words = shot.group.first, shot.group.words
    entries: dict[str, object] = {
        "name": shot.name,
        "role": shot.role,
        "measurement_session": shot.group.session,
        "setup": shot.setup,
        "light": shot.light,
        "light_level": float(f"{shot.light_level:.6g}") if shot.light or shot.light_level != 1 else None,
        "exposure_s": fact.exposure.time_s or (1.0 if draft_camera else None),
        "iso": fact.exposure.iso,
        "rotation_deg": fact.rotation_deg or None,
        "target": shot.target,
        "focus_um": words.focus_um,
        "distance_m": words.distance_m,
        "window": list(shot.window),
        "repeat_of": shot.repeat_of,
        "levels_only": fact.levels_only or None,
        "files": list(shot.group.files),
    }
    if draft_camera and fact.exposure.time_s is None:
        told_time = ["CHECK: its file states no exposure time; 1 s goes with the light's scale"]
    else:
        told_time = []
    mean = 100 * shot.group.level_dn / fact.span_dn
    told = [f"mean {mean:.2f} % of the range", *([f"position {words.position}"] if words.position else []), *told_time]
    return [*comment(f"{shot.comment}; {', '.join(told)}"), *_table("[[shot]]", entries), ""]


def _left_out(draft: Draft) -> list[str]:
    lines: list[str] = []
    for one in draft.seen:
        if not one.shots:
            lines += comment(f"not used: {', '.join(one.group.files)}: {one.content.role}: {one.content.why}")
    for file, reason in draft.skipped:
        lines += comment(f"left out: {file}: {reason}")
    lines += [line for note in draft.notes for line in comment(f"note: {note}")]
    return lines


def sentences(rows: Iterable[tuple[str, str, str]]) -> list[str]:
    """The unknowns in words, for the terminal."""
    return [f"{what}: {needs} Without it: {without}" for what, needs, without in rows]
