"""The place of a crop on its sensor: kept in the file as XMP, and held against the plan.

No tag of DNG says where on the sensor a crop was cut.  TIFF's ImageFullWidth with XPosition would, but is not
allowed in a DNG's first directory.  XMP (ISO 16684-1, tag 700) is: a packet of six numbers in a name space
of its own, which converters keep or pass over.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np

from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.sensor import Position, Sensor, black_at, pattern_at
from isetval.files.dng.tags import RawTags
from isetval.files.dng.tiff_entries import BYTE, Entry
from isetval.files.picture_file import Remark

XMP = 700
NAME_SPACE = "urn:isetval:sensor-window:1"
NAMES = ("WindowRow", "WindowColumn", "WindowRows", "WindowColumns", "SensorRows", "SensorColumns")
LONGEST_PACKET = 65_536  # bytes: a hostile packet must not cost a parser minutes; ours has 400
LARGEST_SIDE = 2**20  # pixels: 50 times the largest sensor made
BLACK_TOLERANCE_DN = 0.5  # rounding of a stated black level to whole DN, and the margin's own error (below .1 DN)


def window_entries(capture: Capture) -> list[Entry]:
    """The tag that keeps a crop's place; none for a whole sensor, whose place is plain."""
    sensor = capture.sensor
    if capture.window == (0, 0) and capture.mosaic.shape == (sensor.rows, sensor.cols):
        return []
    numbers = (*capture.window, *capture.mosaic.shape, sensor.rows, sensor.cols)
    said = " ".join(f'w:{name}="{number}"' for name, number in zip(NAMES, numbers, strict=True))
    packet = (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description rdf:about="" xmlns:w="{NAME_SPACE}" {said}/></rdf:RDF></x:xmpmeta><?xpacket end="r"?>'
    ).encode()
    return [(XMP, BYTE, len(packet), packet)]


def read_window(
    tags: RawTags, *, first: Position, shape: tuple[int, int], stored: tuple[int, int]
) -> tuple[Position, tuple[int, int], tuple[Remark, ...]] | None:
    """Sensor pixel of the picture's first pixel and the sensor's size, as the file states them; None if it does not.

    Parameters
    ----------
    tags : RawTags
    first, shape : (row, col), (rows, cols)
        First pixel of the ActiveArea in the stored frame, and its size.
    stored : (rows, cols)
        Size of the stored frame, whose place is stated.

    Returns
    -------
    (window, sensor_shape, remarks) or None
        With remarks, the statement makes no sense and window and size are those of a picture without it.
    """
    said = _said(tags.value(XMP))
    if said is None:
        return None
    row0, col0, *size, rows, cols = said
    window = (row0 + first[0], col0 + first[1])
    inside = min(said) >= 0 and window[0] + shape[0] <= rows and window[1] + shape[1] <= cols
    if tuple(size) == stored and inside and max(rows, cols) <= LARGEST_SIDE:
        return window, (rows, cols), ()
    found = ", ".join(f"{name} {number}" for name, number in zip(NAMES, said, strict=True))
    words = f"the stated place on the sensor does not fit {stored[0]} x {stored[1]} pixels ({found}) and is passed over"
    return (0, 0), shape, (Remark("window_not_usable", words),)


def _said(packet: object) -> list[int] | None:
    """The numbers of an XMP packet that speaks of a window (-1 for one that is none), None for any other packet."""
    data = packet.encode() if isinstance(packet, str) else packet
    if not isinstance(data, bytes) or NAME_SPACE.encode() not in data or len(data) > LONGEST_PACKET or b"<!" in data:
        return None
    try:
        root = ElementTree.fromstring(data.strip(b"\0 \n"))
    except ElementTree.ParseError:
        return None
    for element in root.iter():
        if f"{{{NAME_SPACE}}}{NAMES[0]}" in element.attrib:
            return [_whole(element.attrib.get(f"{{{NAME_SPACE}}}{name}", "")) for name in NAMES]
    return None


def _whole(text: str) -> int:
    return int(text) if text.isascii() and text.isdigit() and len(text) < 10 else -1


def place_on_sensor(
    capture: Capture,
    sensor: Sensor,
    window: Position = (0, 0),
    *,
    black_tolerance_dn: float = BLACK_TOLERANCE_DN,
) -> Capture:
    """The same pixels as a window of ``sensor``: what a campaign file knows and a foreign crop does not.

    Parameters
    ----------
    capture : Capture
        As read from its file.
    sensor : Sensor
        Full sensor of the campaign; its geometry and levels hold from here on.
    window : (row0, col0)
        Sensor pixel of the capture's first pixel.
    black_tolerance_dn : float
        Largest difference in DN between the black level of the file and of the sensor at any place of
        the 2x2 pattern.

    Returns
    -------
    Capture

    Raises
    ------
    InputError
        If the place that the file states, its color pattern, black level, white level or size contradict
        sensor and window.
    """
    name = capture.provenance.get("file", "capture")
    _check_stated_place(capture, sensor, window, name)
    own, wanted = pattern_at(capture.sensor.cfa, capture.window), pattern_at(sensor.cfa, window)
    if own != wanted:
        raise InputError(
            f"{name}: its color pattern starts {own}, the camera's {sensor.cfa} at window {tuple(window)} needs {wanted}; "
            "correct the window or the camera's cfa"
        )
    rows, cols = capture.mosaic.shape
    if window[0] < 0 or window[1] < 0 or window[0] + rows > sensor.rows or window[1] + cols > sensor.cols:
        raise InputError(
            f"{name}: its {rows} x {cols} pixels at window {tuple(window)} leave the camera's sensor of "
            f"{sensor.rows} x {sensor.cols}; correct the window or the camera's rows and cols"
        )
    if sensor.white_dn != capture.sensor.white_dn:
        raise InputError(
            f"{name}: its white level is {capture.sensor.white_dn:g} DN, the camera's {sensor.white_dn:g}; "
            "correct white_dn of the camera, or leave the file out"
        )
    _check_black(capture, sensor, window, black_tolerance_dn, name)
    return Capture(capture.mosaic, sensor, window, capture.exposure, capture.provenance)


class OneBlack:
    """Captures of one sensor on the black level of the first of them, as a campaign has one.

    Optical black is estimated for every file on its own; frames of a series whose levels lie within the tolerance share
    the first one's.  A capture that lies farther off keeps its own.
    """

    def __init__(self, tolerance_dn: float = BLACK_TOLERANCE_DN) -> None:
        self._tolerance_dn = tolerance_dn
        self._first: dict[Sensor, Sensor] = {}

    def __call__(self, capture: Capture) -> Capture:
        """The same pixels, and the same capture if it is the first of its sensor."""
        own = capture.sensor
        first = self._first.setdefault(replace(own, black_dn=((0.0, 0.0), (0.0, 0.0))), own)
        apart_dn = float(np.abs(np.subtract(own.black_dn, first.black_dn)).max())
        return replace(capture, sensor=first) if 0 < apart_dn <= self._tolerance_dn else capture


def _check_stated_place(capture: Capture, sensor: Sensor, window: Position, name: str) -> None:
    if not capture.provenance.get("window_stated"):
        return
    if tuple(window) != capture.window:
        raise InputError(
            f"{name}: it says that it begins at sensor pixel {capture.window}, the plan at {tuple(window)}; "
            "correct the window of the plan, or leave the file out"
        )
    own = (capture.sensor.rows, capture.sensor.cols)
    rows, cols = capture.mosaic.shape
    # a sensor that just holds its crop is what a capture has whose maker knew the place and not the size
    just_holds = own == (window[0] + rows, window[1] + cols)
    if own != (sensor.rows, sensor.cols) and not just_holds:
        raise InputError(
            f"{name}: it was cut from a sensor of {own[0]} x {own[1]} pixels, the camera has {sensor.rows} x {sensor.cols}; "
            "correct rows and cols of the camera, or leave the file out"
        )


def _check_black(capture: Capture, sensor: Sensor, window: Position, tolerance_dn: float, name: str) -> None:
    blacks = [np.array(black_at(s.black_dn, at)) for s, at in ((capture.sensor, capture.window), (sensor, window))]
    apart_dn = float(np.abs(blacks[0] - blacks[1]).max())
    if apart_dn <= tolerance_dn:
        return
    used = capture.provenance.get("black_used", "its own")
    raise InputError(
        f"{name}: its black level ({used}) is {np.round(blacks[0], 3).tolist()} DN, the camera's {blacks[1].tolist()}, "
        f"{apart_dn:.2f} DN apart and {tolerance_dn:g} allowed; correct black_dn of the camera"
    )
