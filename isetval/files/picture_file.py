"""A picture file as bytes: read whole and once, known by its first bytes, refused in one sentence."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError

Buffer = bytes | memoryview
Read = TypeVar("Read", bytes, memoryview)
MAGIC = (
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"\x89PNG\r\n\x1a\n", "a PNG picture"),
    (b"GIF8", "a GIF picture"),
    (b"%PDF", "a PDF document"),
    (b"PK\x03\x04", "a ZIP archive"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"FUJIFILMCCD-RAW", "a Fujifilm RAF raw file"),
    (b"\x00\x00\x00\x0cJXL ", "a JPEG XL picture"),
    (b"II*\x00\x10\x00\x00\x00CR", "a Canon CR2 raw file"),
    (b"II+\x00", "a BigTIFF"),
    (b"MM\x00+", "a BigTIFF"),
)
FEW_PIXELS = 1000  # of a picture, looked at before all of them
REMEDY = "convert it to an uncompressed or losslessly compressed Bayer DNG"


@dataclass(frozen=True)
class Remark:
    """A doubt about a file that does not stop its use: a stable code and a sentence."""

    code: str
    message: str


def refusal(path: object, found: str, needed: str, remedy: str = REMEDY) -> InputError:
    """The error for a file: what was found, what is needed, what to do."""
    return InputError(f"{path}: {found}; isetval needs {needed}; {remedy}")


def read_bytes(path: str | os.PathLike[str], *, kind: str = "a DNG file") -> bytes:
    """The whole file, or one sentence on why there is none.

    Raises
    ------
    InputError
        For a missing file, a directory, an empty or an unreadable file.
    """
    return _read(path, kind, Path.read_bytes)


def read_buffer(path: str | os.PathLike[str], *, kind: str = "a DNG file") -> memoryview:
    """The whole file in an array's memory, whose large pages are had ten times quicker than the small ones of ``bytes``.

    Raises
    ------
    InputError
        As `read_bytes`.
    """
    return _read(path, kind, lambda target: np.fromfile(target, np.uint8).data.toreadonly())


def _read(path: str | os.PathLike[str], kind: str, read: Callable[[Path], Read]) -> Read:
    target = Path(path)
    if target.is_dir():
        raise refusal(target, "this is a directory", kind, "name a file inside it")
    if target.exists() and not target.is_file():
        raise refusal(target, "this is a device or a pipe", kind, "copy its contents into a file first")
    try:
        data = read(target)
    except FileNotFoundError:
        raise refusal(target, "there is no such file", kind, "check the name and the folder") from None
    except OSError as error:
        raise refusal(target, f"the file cannot be read ({error.strerror})", kind, "check its permissions") from None
    if not data:
        raise refusal(target, "the file is empty (0 bytes)", kind, "copy it again from the camera")
    return data


def check_not_constant(path: object, mosaic: NDArray[np.uint16], *, white: float) -> None:
    """Refuse a frame whose pixels are all equal: decoders return it for missing samples.

    Raises
    ------
    InputError
        If the frame of more than one pixel holds one value only; ``white`` in DN.
    """
    value = int(mosaic.flat[0])
    few = mosaic.ravel()[:: max(1, mosaic.size // FEW_PIXELS)]  # settles it for every picture at no cost
    if mosaic.size > 1 and bool((few == value).all()) and bool((mosaic == value).all()):
        if value >= white:
            raise refusal(path, f"every pixel is {value}, the white level", "a picture", "expose it shorter")
        raise refusal(path, f"every pixel is {value}", "a picture", "use the original file, the samples of this one are gone")


def what_is(data: Buffer) -> str:
    """Words for what the first bytes of a file say it is."""
    head = bytes(data[:512])
    for magic, words in MAGIC:
        if head.startswith(magic):
            return words
    if head[4:8] == b"ftyp":
        return "an ISO media file (HEIF, AVIF, CR3 or video)"
    if head[:4] in (b"II*\x00", b"MM\x00*"):
        return "a TIFF"
    if all(byte >= 32 or byte in (9, 10, 13) for byte in head):
        return "a text file"
    return "neither a TIFF nor any other picture known here"
