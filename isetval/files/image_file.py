"""TIFF, PNG and NumPy pictures as captures: mosaics and single channels, with what they lack from a sidecar."""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.cache import bytes_hash
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.sensor import Sensor
from isetval.files.picture_file import Remark, read_bytes, refusal, what_is
from isetval.files.picture_quality import clipping, clipping_remarks, code_remarks, code_use, line_remarks
from isetval.files.sidecar import Sidecar, read_sidecar

SUFFIXES = (".tif", ".tiff", ".png", ".npy")
MOST_SAMPLES = 2**28  # 268 million: 90 MP of three channels; half a gigabyte
FREE_BYTES, MOST_BYTES_PER_BYTE = 2**26, 100  # decoded: 64 MB whatever the file's size, above that 100 times it
UNKNOWN_PITCH_UM = 1.0  # as the DNG reader: "mm" then mean thousands of pixels, and a remark says so
LINEARIZED_WHITE = 65535  # an sRGB picture is decoded to 16 bits
REMEDY = "save it as an uncompressed TIFF of 8 or 16 bits, or as .npy"


@dataclass(frozen=True)
class _Said:
    """A picture and what is known of it, while a capture is made."""

    path: Path
    samples: NDArray[Any]
    sidecar: Sidecar
    provenance: dict[str, Any]
    remarks: tuple[Remark, ...] = ()


def read_image(
    path: str | os.PathLike[str], sidecar: Path | str | Mapping[str, Any] | None = None, *, channel: str | None = None
) -> Capture:
    """Read a TIFF, PNG or ``.npy`` picture of whole numbers.

    Two dimensions are a raw mosaic or one channel; three (R, G, B, and an alpha that is left out) are a demosaiced picture, of
    which one channel becomes a MONO capture.  Levels, pattern, place and exposure come from the sidecar.

    Parameters
    ----------
    path : path
    sidecar : path or mapping, optional
        TOML file or its content (see `isetval.files.sidecar`); by default the one beside the picture.
    channel : "R", "G" or "B", optional
        Of a demosaiced picture; by default what the sidecar says.

    Returns
    -------
    Capture
        ``provenance`` holds ``file``, ``sha256``, ``kind``, ``sidecar``, ``black_used``, ``channel``, ``encoding``,
        ``window_stated``, ``wavelength_nm``, ``labels``, ``levels_only``, ``notes`` and ``warnings``.

    Raises
    ------
    InputError
        For a picture that cannot be read whole, and for everything that it and its sidecar lack: all of it by name.
    """
    path = Path(path)
    data = read_bytes(path, kind="a TIFF, PNG or .npy picture")
    kind, samples = _decoded(path, data)
    about = read_sidecar(path, sidecar)
    provenance = {
        "file": path.name,
        "sha256": bytes_hash(data),
        "kind": kind,
        "sidecar": about.source or None,
        "black_used": "sidecar",
        "window_stated": about.window is not None,
        "wavelength_nm": about.wavelength_nm,
        "labels": dict(about.labels),
        "levels_only": about.levels_only,
        "notes": about.notes or None,
    }
    said = _Said(path, samples, about, provenance)
    return _capture(_one_channel(said, channel or about.channel) if samples.ndim == 3 else said)


def _decoded(path: Path, data: bytes) -> tuple[str, NDArray[Any]]:
    """What the bytes are, whatever the name says, and the samples: whole numbers, (rows, cols) or (rows, cols, 3)."""
    if data[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        kind, samples = "tiff", _tiff(path, data)
    elif data.startswith(b"\x89PNG\r\n\x1a\n"):
        kind, samples = "png", _png(path, data)
    elif data.startswith(b"\x93NUMPY"):
        kind, samples = "npy", _npy(path, data)
    else:
        raise refusal(path, f"this is {what_is(data)}", "a TIFF, PNG or .npy picture", "convert it to one of them")
    if samples.ndim == 3 and samples.shape[2] in (3, 4):
        samples = samples[..., :3]
    elif samples.ndim != 2:
        shape = " x ".join(map(str, samples.shape))
        raise refusal(path, f"the picture has the shape {shape}", "rows x columns, or rows x columns x 3 (R, G, B)", REMEDY)
    if not samples.size:
        raise refusal(path, "the picture has no pixel", "at least one", REMEDY)
    if samples.dtype.kind not in "ui" and not (kind == "npy" and samples.dtype.kind == "f"):
        raise refusal(path, f"its samples are {samples.dtype}", "whole numbers of 8 or 16 bits", REMEDY)
    return kind, samples


def _check_size(path: Path, samples: int, sample_bytes: int, data: bytes) -> None:
    """Refuse what is too large, and what a few bytes blow up to."""
    if samples > MOST_SAMPLES:
        raise refusal(path, f"the picture has {samples} samples", f"at most {MOST_SAMPLES}", "cut it into parts")
    if samples * sample_bytes > FREE_BYTES + MOST_BYTES_PER_BYTE * len(data):
        found = f"a file of {len(data)} bytes says it holds {samples} samples of {sample_bytes} bytes"
        raise refusal(path, found, f"at most {MOST_BYTES_PER_BYTE} times the file's size", "save it uncompressed")


def _tiff(path: Path, data: bytes) -> NDArray[Any]:
    import tifffile

    from isetval.files.dng.directories import check_directories
    from isetval.files.dng.tags import quiet_parser

    check_directories(path, data)
    try:
        with quiet_parser(), tifffile.TiffFile(io.BytesIO(data)) as file:
            pages = [page for page in file.pages if not int(page.tags.valueof(254) or 0) & 1]
            if len(pages) != 1:
                raise refusal(path, f"the file holds {len(pages)} pictures", "one", "save each as a file of its own")
            _check_page(path, pages[0], data)
            needs_pillow = int(pages[0].compression) == tifffile.COMPRESSION.LZW
            return _pillow(path, data, ".tif") if needs_pillow else np.asarray(pages[0].asarray(maxworkers=1))
    except InputError:
        raise
    except Exception as error:  # a TIFF parser meets any error in a damaged file
        raise refusal(path, f"the TIFF cannot be read ({_short(error)})", "a whole picture", REMEDY) from None


def _check_page(path: Path, page: Any, data: bytes) -> None:
    """Refuse what would be misread without a word: other meanings of a sample, and pieces that are not there."""
    _check_size(path, int(np.prod(page.shape, dtype=float)), page.dtype.itemsize if page.dtype else 2, data)
    if int(page.photometric) == 0:
        raise refusal(path, "0 is white in this TIFF (MinIsWhite)", "0 for black", REMEDY)
    if int(page.photometric) == 3:
        raise refusal(path, "the picture has a palette", "samples that are levels", REMEDY)
    places, sizes = [int(n) for n in page.dataoffsets], [int(n) for n in page.databytecounts]
    wanted = int(np.prod(page.chunked))
    if len(places) != wanted or len(sizes) != wanted:
        raise refusal(path, f"the TIFF lists {len(places)} strips or tiles", f"{wanted}", "copy it again, samples are missing")
    if any(place < 8 or size < 1 or place + size > len(data) for place, size in zip(places, sizes, strict=True)):
        raise refusal(path, f"the file of {len(data)} bytes is cut off", "all its strips or tiles", "copy it again")
    if sum(sizes) > len(data):
        raise refusal(path, "its strips or tiles overlap", "one place in the file for every pixel", "copy it again")


def _png(path: Path, data: bytes) -> NDArray[Any]:
    if len(data) < 33 or data[12:16] != b"IHDR":
        raise refusal(path, "the PNG has no header", "a whole picture", "copy it again")
    cols, rows = int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    bits, kind = data[24], data[25]
    _check_size(path, rows * cols * {0: 1, 2: 3, 6: 4}.get(kind, 2), 1 + bits // 16, data)
    if kind not in (0, 2, 6) or bits not in (8, 16):
        words = {3: "a palette", 4: "gray levels with transparency"}.get(kind, f"{bits} bits a sample")
        raise refusal(path, f"the PNG has {words}", "levels of 8 or 16 bits, gray or RGB", REMEDY)
    if kind != 0 and bits == 16:
        found = "the PNG has three channels of 16 bits, of which its decoder keeps 8"
        raise refusal(path, found, "a 16-bit TIFF, or a PNG of one channel", "save it as a TIFF")
    return _pillow(path, data, ".png")


def _pillow(path: Path, data: bytes, extension: str) -> NDArray[Any]:
    """Decoded by Pillow through imageio, both of which scikit-image brings; 8 bits, or 16 of one channel."""
    import imageio.v3

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow warns of large pictures; the size was checked
            samples = np.asarray(imageio.v3.imread(data, extension=extension, plugin="pillow"))
    except Exception as error:  # Pillow meets any error in a damaged file
        raise refusal(path, f"the picture cannot be decoded ({_short(error)})", "a whole picture", REMEDY) from None
    if samples.ndim == 3 and samples.dtype != np.uint8:
        raise refusal(path, f"three channels of {samples.dtype}", "8 bits, or an uncompressed TIFF", REMEDY)
    return samples


def _npy(path: Path, data: bytes) -> NDArray[Any]:
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, kind = read(stream)
    except Exception as error:  # NumPy parses it as a Python literal, with any error of a parser
        raise refusal(path, f"the .npy header cannot be read ({_short(error)})", "a whole file", "write it again") from None
    number = int(np.prod([int(n) for n in shape], dtype=object)) if shape else 1
    _check_size(path, number, kind.itemsize, data)
    if kind.kind not in "uif" or kind.hasobject:
        raise refusal(path, f"its values are {kind}", "whole numbers", "convert them: array.astype(numpy.uint16)")
    if stream.tell() + number * kind.itemsize > len(data):
        raise refusal(path, f"the file of {len(data)} bytes is cut off", f"{number} values of {kind}", "write it again")
    return np.frombuffer(data, kind, number, stream.tell()).reshape(shape, order="F" if fortran else "C")


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


def _one_channel(said: _Said, channel: str) -> _Said:
    """One channel of a demosaiced picture as linear levels; asked for by name where it is not said which."""
    about = said.sidecar
    missing = [name for name, value in (("channel", channel), ("encoding", about.encoding)) if not value]
    if missing:
        hints = {"channel": 'channel = "G"', "encoding": 'encoding = "linear" or "srgb"'}
        raise _asked_for(said.path, "a demosaiced picture of three channels", [hints[name] for name in missing])
    if channel not in ("R", "G", "B"):
        raise InputError(f"{said.path}: channel is {channel!r}; a demosaiced picture has R, G and B")
    samples = said.samples[..., "RGB".index(channel)]
    provenance = said.provenance | {"channel": f"{channel} of a demosaiced picture", "encoding": about.encoding}
    words = "a channel of a demosaiced picture: half of green and three quarters of red and blue are interpolated"
    remarks = (*said.remarks, Remark("demosaiced", words))
    about = replace(about, cfa="MONO")
    if about.encoding == "srgb":
        samples = _linear_from_srgb(said.path, samples)
        about = replace(about, black_dn=(0.0,), white_dn=float(LINEARIZED_WHITE), bits=16)
        words = "decoded from sRGB to linear light (IEC 61966-2-1), 65535 = white; a camera's tone curve may differ from sRGB's"
        remarks += (Remark("linearized", words),)
    return _Said(said.path, samples, about, provenance, remarks)


def _linear_from_srgb(path: Path, samples: NDArray[Any]) -> NDArray[np.uint16]:
    """Linear light of sRGB codes in 0..65535 (IEC 61966-2-1, 5.2)."""
    if samples.dtype not in (np.uint8, np.uint16):
        raise refusal(path, f"sRGB codes as {samples.dtype}", "8 or 16 bits", REMEDY)
    codes = np.arange(np.iinfo(samples.dtype).max + 1) / np.iinfo(samples.dtype).max
    light = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.round(LINEARIZED_WHITE * light).astype(np.uint16)[samples])


def _capture(said: _Said) -> Capture:
    about, rows, cols = said.sidecar, *said.samples.shape[:2]
    white_dn = about.white_dn if about.white_dn is not None else (2.0**about.bits - 1 if about.bits else None)
    stored = 8 * said.samples.dtype.itemsize if said.samples.dtype.itemsize < 3 else 16
    missing = [
        hint
        for hint, value in (
            ('cfa = "RGGB" (the pattern at sensor pixel (0, 0)) or "MONO"', about.cfa),
            ("black_dn = 0", about.black_dn),
            (f"white_dn = {2**stored - 1} or bits = {stored}", white_dn),
        )
        if not value
    ]
    if missing or white_dn is None:
        error = _asked_for(said.path, "a picture without levels and pattern", missing)
        raise InputError(f"{error}; isetval measure takes them as --cfa, --black-dn and --bits, too")
    window = about.window or (0, 0)
    shape = about.sensor or (window[0] + rows, window[1] + cols)
    try:
        sensor = Sensor(
            rows=shape[0],
            cols=shape[1],
            pixel_um=about.pixel_um or UNKNOWN_PITCH_UM,
            cfa=about.cfa,
            black_dn=about.black_2x2,
            white_dn=white_dn,
            bits=about.bits or max(1, int(white_dn).bit_length()),
        )
        mosaic = Capture.from_array(said.samples, cfa="MONO", black_dn=0, white_dn=65535).mosaic
        capture = Capture(mosaic, sensor, window, about.exposure)
    except InputError as error:
        raise InputError(f"{said.path}: {error} (said by {about.source or 'nobody'})") from None
    top = int(mosaic.max())
    if top >= 2**sensor.bits:
        needed = f"values up to {2**sensor.bits - 1} for {sensor.bits} bits"
        raise refusal(said.path, f"its highest value is {top}", needed, "correct bits or white_dn in its sidecar")
    remarks = [*said.remarks, *_remarks(capture, about)]
    return replace(capture, provenance=said.provenance | {"warnings": tuple(asdict(r) for r in remarks)})


def _remarks(capture: Capture, about: Sidecar) -> list[Remark]:
    remarks = []
    if about.pixel_um is None:
        words = f"no pixel_um is said: the pitch is set to {UNKNOWN_PITCH_UM:g} um, so lengths in mm mean thousands of pixels"
        remarks.append(Remark("no_pixel_pitch", words))
    if about.exposure.time_s is None:
        remarks.append(Remark("no_exposure", "neither the sidecar nor the name says an exposure time: taken as unknown"))
    if about.levels_only:
        remarks.append(
            Remark("levels_only", "noise and sharpness of this picture are not the sensor's; its levels and places are")
        )
    if capture.mosaic.min() == capture.mosaic.max():
        remarks.append(Remark("constant", f"every pixel is {int(capture.mosaic.flat[0])}"))
        return remarks
    return [
        *remarks,
        *clipping_remarks(clipping(capture)),
        *line_remarks(capture.mosaic),
        *code_remarks(code_use(capture.mosaic)),
    ]


def _asked_for(path: Path, what: str, missing: list[str]) -> InputError:
    place = f"{path.with_suffix('.toml').name}, or images.toml for all pictures of the folder"
    return InputError(f"{path}: this is {what}; write {'; '.join(missing)} into {place}")
