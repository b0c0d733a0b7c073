"""Raw files of other makers through LibRaw: samples, levels and pattern as it states them."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.cache import bytes_hash
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.sensor import BAYER_PATTERNS, Black, Exposure, Sensor, black_at, pattern_at
from isetval.files.picture_file import Remark, check_not_constant, read_bytes, refusal
from isetval.files.picture_quality import clipping, clipping_remarks, line_remarks
from isetval.files.sidecar import read_sidecar

# raw suffixes that LibRaw documents and that are no DNG
SUFFIXES = (
    ".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".erf", ".fff", ".iiq", ".k25", ".kdc", ".mef", ".mos", ".mrw", ".nef",
    ".nrw", ".orf", ".pef", ".raf", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f",
)  # fmt: skip
UNKNOWN_PITCH_UM = 1.0  # as the DNG reader
REMEDY = "convert it to a DNG, whose tags say more"


def read_libraw(path: str | os.PathLike[str], sidecar: Path | str | Mapping[str, Any] | None = None) -> Capture:
    """Read the visible area of a raw file that LibRaw knows.

    Black, white and pattern are LibRaw's: black in whole DN and one number a color, which maker notes may have moved; what a
    sidecar says stands in their place.  A DNG is better read by `isetval.read_dng`, from its tags.

    Parameters
    ----------
    path : path
    sidecar : path or mapping, optional
        See `isetval.files.sidecar`.

    Returns
    -------
    Capture
        ``provenance`` holds ``file``, ``sha256``, ``kind``, ``black_used``, ``levels_from``, ``libraw`` and ``warnings``.

    Raises
    ------
    InputError
        If LibRaw cannot decode the file, or it holds no Bayer or one-channel mosaic.
    """
    path = Path(path)
    data = read_bytes(path, kind="a raw file")
    mosaic, cfa, black_dn, white_dn, exposure, version = _decoded(path, data)
    check_not_constant(path, mosaic, white=white_dn)
    about = read_sidecar(path, sidecar)
    window = about.window or (0, 0)
    shape = about.sensor or (window[0] + mosaic.shape[0], window[1] + mosaic.shape[1])
    white_dn = about.white_dn or white_dn
    sensor = Sensor(
        rows=shape[0],
        cols=shape[1],
        pixel_um=about.pixel_um or UNKNOWN_PITCH_UM,
        cfa=about.cfa or pattern_at(cfa, window),
        black_dn=about.black_2x2 if about.black_dn else black_at(black_dn, window),
        white_dn=white_dn,
        bits=about.bits or max(8, int(white_dn).bit_length()),
    )
    capture = Capture(mosaic, sensor, window, _exposure(exposure, about.exposure))
    words = "black, white and pattern are LibRaw's: whole DN, one black a color; a sidecar may correct them"
    pitch = "" if about.pixel_um else "; no pixel_um is said, so it is set to 1 um"
    remarks = [Remark("levels_from_libraw", words + pitch), *clipping_remarks(clipping(capture)), *line_remarks(mosaic)]
    provenance = {
        "file": path.name,
        "sha256": bytes_hash(data),
        "kind": "raw",
        "libraw": version,
        "sidecar": about.source or None,
        "levels_from": "sidecar over LibRaw" if about.source else "LibRaw",
        "black_used": "sidecar" if about.black_dn else "libraw",
        "window_stated": about.window is not None,
        "labels": dict(about.labels),
        "wavelength_nm": about.wavelength_nm,
        "warnings": tuple(asdict(r) for r in remarks),
    }
    return Capture(mosaic, sensor, window, capture.exposure, provenance)


def _decoded(path: Path, data: bytes) -> tuple[NDArray[np.uint16], str, Black, float, Exposure, str]:
    """Samples of the visible area, pattern and black of its first 2x2 pixels, white, exposure, LibRaw's version."""
    import rawpy

    try:
        with rawpy.imread(io.BytesIO(data)) as raw:
            if raw.raw_type != rawpy.RawType.Flat:
                raise refusal(path, "LibRaw sees several samples a pixel", "one raw mosaic", REMEDY)
            mosaic = np.array(raw.raw_image_visible, dtype=np.uint16)
            cfa, black_dn = _pattern(path, raw)
            exposure = _stated_exposure(getattr(raw, "other", None))
            return mosaic, cfa, black_dn, float(raw.white_level), exposure, ".".join(map(str, rawpy.libraw_version))
    except InputError:
        raise
    except Exception as error:  # rawpy's errors share no base class but Exception, and carry bytes
        words = error.args[0] if error.args else type(error).__name__
        found = words.decode(errors="replace") if isinstance(words, bytes) else str(words)
        raise refusal(path, f"LibRaw cannot decode it ({found})", "a raw file of a camera that LibRaw knows", REMEDY) from None


def _pattern(path: Path, raw: Any) -> tuple[str, Black]:
    """Pattern of the first 2x2 visible pixels and LibRaw's black at each of them."""
    if raw.num_colors == 1:
        return "MONO", ((float(raw.black_level_per_channel[0]),) * 2,) * 2
    if raw.raw_pattern is None or raw.raw_pattern.shape != (2, 2):
        raise refusal(path, "its color pattern is not 2 x 2 (X-Trans?)", "a Bayer mosaic or one channel", REMEDY)
    numbers = np.asarray(raw.raw_colors_visible[:2, :2])
    names = raw.color_desc.decode()
    cfa = "".join(names[int(n)] for n in numbers.ravel())
    if cfa not in BAYER_PATTERNS:
        raise refusal(path, f"its color pattern is {cfa}", "a Bayer mosaic or one channel", REMEDY)
    a, b, c, d = (float(raw.black_level_per_channel[int(n)]) for n in numbers.ravel())
    return cfa, ((a, b), (c, d))


def _stated_exposure(other: Any) -> Exposure:
    """Time, ISO and f-number; LibRaw says 0 for what is absent, and 1 s at f/1 where Exif holds zeros: then ISO is 0 too."""
    iso, time_s, f_number = (float(getattr(other, name, 0.0) or 0.0) for name in ("iso_speed", "shutter_speed", "aperture"))
    if not 0 < iso < np.inf:
        return Exposure()
    known = [value if 0 < value < np.inf else None for value in (time_s, iso, f_number)]
    return Exposure(*known)


def _exposure(found: Exposure, said: Exposure) -> Exposure:
    pairs = {name: getattr(said, name) or getattr(found, name) for name in ("time_s", "iso", "f_number", "focus_m")}
    return Exposure(**pairs)
