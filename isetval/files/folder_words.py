"""What the names of folders say: visit, light, position, distance, focus, repeat."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import PurePosixPath

# lights whose spectrum is published: how laboratories call them -> column of data/spectra/illuminants.csv
PUBLISHED = {
    "a": "A", "illa": "A", "tungsten": "A", "incandescent": "A", "halogen": "A",
    "d50": "D50", "d65": "D65", "daylight": "D65", "day": "D65", "e": "E",
    "f2": "F2", "cwf": "F2", "f7": "F7",
}  # fmt: skip
OTHER_LIGHTS = ("sphere", "lamp", "sky", "tube", "led", "cloudy", "sun", "shade", "flash", "lightbox", "panel")
WHOLE_PARTS_ONLY = ("a", "e")  # one letter says light only where it is the whole name of a folder
POSITION = re.compile(
    r"(?:top|bottom|upper|lower|left|right|cent(?:er|re)|mid(?:dle)?|corner|side|off|axis)+\d*"
    r"|(?:pos(?:ition)?|place|field|loc)\d+"
)
LENGTH = re.compile(r"(\d+(?:[.p]\d+)?)(mm|cm|m)")
UNIT_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
FOCUS = re.compile(r"(?:focus|defocus|f)([-+mp]?\d+(?:\.\d+)?)um")
VISIT = re.compile(r"(?:visit|session|day|run)\w*|\d{4}-?\d{2}-?\d{2}.*")
REPEAT = re.compile(r"(?P<base>.+?)[_\- ]?(?:repeat|again|rep|bis|r)\d*")
ROLE_WORDS = {
    "dark": ("dark", "darks", "cap", "capped", "black", "bias"),
    "flat": ("flat", "flats", "sphere", "uniform", "white"),
    "edge": ("edge", "edges", "slanted", "blade", "knife", "sfr", "mtf"),
    "chart": ("chart", "charts", "macbeth", "colorchecker", "colourchecker", "mcc"),
    "scene": ("scene", "scenes", "box", "cornell"),
}


@dataclass(frozen=True)
class FolderWords:
    """What a folder's name says; None or empty where it says nothing.

    ``number`` is a folder that is a bare number: often a distance, in a unit that nobody wrote down.
    """

    role: str = ""
    light: str = ""
    position: str = ""
    distance_m: float | None = None
    number: str = ""
    focus_um: float | None = None
    visit: str = ""


def read_words(folder: str, file: str = "", *, wavelength_nm: float | None = None) -> FolderWords:
    """The words of a folder's path, the deepest one winning, and the role word of a file's name.

    A stated wavelength is the name of the light, unless a folder names it.
    """
    found: dict[str, object] = {"light": f"{wavelength_nm:g}nm"} if wavelength_nm else {}
    for part in PurePosixPath(folder).parts:
        lower = part.lower()
        if VISIT.fullmatch(lower) and "visit" not in found:
            found["visit"] = part
            continue
        if re.fullmatch(r"\d+(?:\.\d+)?", lower):
            found["number"] = lower
        for token in [lower, *re.split(r"[_\-\s]+", lower)]:
            _take(token, found, whole=token == lower)
        if match := FOCUS.search(lower):
            found["focus_um"] = float(match[1].replace("m", "-").replace("p", ""))
    stem = re.split(r"[_\-\s.\d]+", PurePosixPath(file).stem.lower())
    for token in stem:
        if "role" not in found and (role := role_of(token)):
            found["role"] = role
    return FolderWords(**found)  # type: ignore[arg-type]


def _take(token: str, found: dict[str, object], *, whole: bool) -> None:
    if token in PUBLISHED and (whole or token not in WHOLE_PARTS_ONLY):
        found["light"] = PUBLISHED[token]
    elif token in OTHER_LIGHTS:
        found["light"] = token
    if POSITION.fullmatch(token):
        found["position"] = token
    if match := LENGTH.fullmatch(token):
        found["distance_m"] = round(float(match[1].replace("p", ".")) * UNIT_M[match[2]], 9)
    if role := role_of(token):
        found["role"] = role


def role_of(token: str) -> str:
    """The role that a word stands for, or nothing."""
    return next((role for role, words in ROLE_WORDS.items() if token in words), "")


def repeat_base(folder: str) -> str:
    """The folder that this one repeats by its name (``edge_c_repeat`` of ``edge_c``), or nothing."""
    path = PurePosixPath(folder)
    match = REPEAT.fullmatch(path.name)
    return (path.parent / match["base"]).as_posix() if match else ""
