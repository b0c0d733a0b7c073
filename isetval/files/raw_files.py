"""Which files of a folder are raw data, and what to say where none is."""

from __future__ import annotations

from pathlib import Path

from isetval.files.capture_file import CAPTURE_SUFFIXES
from isetval.files.image_file import SUFFIXES
from isetval.files.sidecar import find_sidecar

# what people have in place of raw pictures, and what to do then
UNUSABLE = {
    (".jpg", ".jpeg", ".heic", ".heif", ".webp", ".mp4", ".mov"): (
        "were processed and compressed, and their numbers are not the light's; let the camera save DNG or its own raw format"
    ),
    (".raw", ".bin"): (
        "have no header; isetval measure FILES --raw-shape ROWSxCOLS --cfa BGGR --bits 12 reads them; for a campaign save "
        "them as .npy beside a sidecar (docs/formats.md)"
    ),
    (
        ".bmp",
        ".jp2",
        ".fits",
        ".fit",
        ".pgm",
    ): "are of no kind that isetval reads; save them as TIFF, PNG or .npy of whole numbers",
}


def nothing_in(folder: Path) -> str:
    """Why nothing of a folder can be measured, and what would help: pictures that lack levels, or nothing at all."""
    lacking = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
    if not lacking:
        return f"{folder}: holds no DNG file at any level, nor another raw picture; {_instead(folder)}"
    return (
        f"{folder}: its {len(lacking)} pictures ({lacking[0].relative_to(folder)} ...) say neither levels nor pattern; write "
        f'cfa = "RGGB" (or "MONO"), black_dn = 0, bits = 8 (or white_dn) and pixel_um into {folder / "images.toml"}: '
        "docs/formats.md shows one that also reads exposure times from file names "
        "(or say them: isetval measure --cfa RGGB --bits 8 --black-dn 0)"
    )


def _instead(folder: Path) -> str:
    """What to do with what a folder without raw pictures holds."""
    held = sorted(path for path in folder.rglob("*") if path.is_file())
    for suffixes, words in UNUSABLE.items():
        if found := [path for path in held if path.suffix.lower() in suffixes]:
            return f"its {len(found)} files like {found[0].relative_to(folder)} {words}"
    return "name files or their folder"


def files_below(folder: Path, *, said: bool = False) -> list[Path]:
    """The raw files of a folder and of all folders in it, by name; hidden files and folders are left alone.

    TIFF, PNG and NumPy files are raw data only where a sidecar states their levels (or somebody ``said`` them): others are
    anybody's pictures.
    """

    def usable(path: Path) -> bool:
        suffix = path.suffix.lower()
        return (
            suffix in CAPTURE_SUFFIXES and path.is_file() and (suffix not in SUFFIXES or said or find_sidecar(path) is not None)
        )

    hidden = (".", "__MACOSX")
    return sorted(
        path
        for path in folder.rglob("*")
        if usable(path) and not any(part.startswith(hidden) for part in path.relative_to(folder).parts)
    )
