"""One reader for every kind of picture: by its suffix a DNG, another maker's raw, or an image with a sidecar."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.files import image_file, libraw_file
from isetval.files.dng.optical_black import BlackChoice
from isetval.files.dng.reader import read_dng

DNG_SUFFIX = ".dng"
CAPTURE_SUFFIXES = (DNG_SUFFIX, *libraw_file.SUFFIXES, *image_file.SUFFIXES)


def read_capture(
    path: str | os.PathLike[str],
    *,
    black: BlackChoice = "auto",
    sidecar: Path | str | Mapping[str, Any] | None = None,
    channel: str | None = None,
) -> Capture:
    """Read any picture that isetval knows.

    Parameters
    ----------
    path : path
        ``.dng``, a raw suffix of LibRaw, ``.tif``, ``.tiff``, ``.png`` or ``.npy``, in small or capital letters.
    black : "auto", "tag" or "optical"
        Of a DNG: see `isetval.read_dng`.
    sidecar : path or mapping, optional
        Of the other kinds: see `isetval.read_image`.
    channel : "R", "G" or "B", optional
        Of a demosaiced picture: see `isetval.read_image`.

    Raises
    ------
    InputError
        As the reader of its kind, and for an unknown suffix.
    """
    suffix = Path(path).suffix.lower()
    if suffix == DNG_SUFFIX:
        return read_dng(path, black=black)
    if suffix in image_file.SUFFIXES:
        return image_file.read_image(path, sidecar, channel=channel)
    if suffix in libraw_file.SUFFIXES:
        return libraw_file.read_libraw(path, sidecar)
    known = f".dng, {', '.join(image_file.SUFFIXES)} and the raw suffixes of LibRaw ({', '.join(libraw_file.SUFFIXES[:4])} ...)"
    raise InputError(
        f"{path}: {suffix or 'no suffix'} is no kind of picture that isetval reads; it reads {known}, and headerless raw "
        "whose size is stated (isetval measure --raw-shape ROWSxCOLS --cfa RGGB --bits 12 --black-dn 0)"
    )
