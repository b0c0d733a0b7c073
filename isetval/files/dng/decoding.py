"""Samples of a raw image: a plain copy where the file is uncompressed, LibRaw (rawpy) everywhere else."""

from __future__ import annotations

import contextlib
import io
import os
import sys
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError
from isetval.files.dng.refusal import refusal
from isetval.files.dng.structure import RECOPY, Layout
from isetval.files.dng.tags import BROKEN, RawTags

SMALLEST_FOR_LIBRAW = 22
# file descriptor 2 belongs to the whole process: one decoder at a time may hold it
_STDERR = threading.Lock()
Mosaic = NDArray[np.uint16]


def decode(path: object, data: bytes, tags: RawTags, layout: Layout) -> Mosaic:
    """The whole stored frame, margins included, uint16 (rows, cols), exactly as stored.

    Raises
    ------
    InputError
        If the samples cannot be decoded or come back in another shape.
    """
    plain = layout.compression == 1 and layout.bits == 16 and tags.tag(50712) is None
    frame = decode_plain(path, tags) if plain else decode_libraw(path, data, layout)
    if frame.shape != (layout.rows, layout.cols):
        raise refusal(
            path,
            f"the decoder returns {' x '.join(map(str, frame.shape))} pixels",
            f"the {layout.rows} x {layout.cols} that the tags of the raw image state",
            "convert it again, its directories disagree",
        )
    return frame


def decode_plain(path: object, tags: RawTags) -> Mosaic:
    """Uncompressed 16-bit samples, read as they lie in the file."""
    try:
        return np.asarray(tags.raw.asarray(maxworkers=1)).astype(np.uint16, copy=False)
    except BROKEN as error:
        raise refusal(path, f"the samples cannot be read ({error})", "a whole file", RECOPY) from None


def decode_libraw(path: object, data: bytes, layout: Layout) -> Mosaic:
    """Any samples that LibRaw decodes; it supplies nothing else."""
    import rawpy

    if min(layout.rows, layout.cols) < SMALLEST_FOR_LIBRAW:
        raise refusal(
            path,
            f"a compressed or packed raw image of {layout.rows} x {layout.cols} pixels",
            f"at least {SMALLEST_FOR_LIBRAW} x {SMALLEST_FOR_LIBRAW} for its decoder",
            "store it with uncompressed 16-bit samples",
        )
    try:
        with _STDERR, _quiet_stderr(), rawpy.imread(io.BytesIO(data)) as raw:
            if raw.raw_type != rawpy.RawType.Flat:
                raise refusal(path, "the decoder sees several samples a pixel", "one raw mosaic")
            return np.array(raw.raw_image, dtype=np.uint16)
    except InputError:
        raise
    except Exception as error:
        # rawpy's own errors carry bytes; NotSupportedError and friends share no base class but Exception
        raise refusal(path, f"LibRaw cannot decode the samples ({_words(error)})", "samples that are whole", RECOPY) from None


def _words(error: Exception) -> str:
    words: Any = error.args[0] if error.args else type(error).__name__
    return words.decode(errors="replace") if isinstance(words, bytes) else str(words)


@contextlib.contextmanager
def _quiet_stderr() -> Iterator[None]:
    """LibRaw prints to file descriptor 2 what it also raises; keep it from the person's terminal."""
    with contextlib.suppress(Exception):
        sys.stderr.flush()
    try:
        saved = os.dup(2)
    except OSError:
        yield
        return
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
