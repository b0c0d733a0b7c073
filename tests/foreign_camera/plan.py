"""The laboratory's plan: which shots a session holds, and how well the laboratory knows its numbers."""

from __future__ import annotations

from dataclasses import dataclass

from . import optics
from .scene import Chart, Edge, Place
from .spectra import reflectances

# parameter, sigma, unit, scope, roles
PRIORS = [
    ("light_level", 0.02, "relative", "set-up", ["flat", "edge", "chart"]),
    ("light_level", 0.001, "relative", "frame", ["flat", "edge", "chart"]),
    ("light_tilt_x", 0.005, "relative", "measurement session", ["flat"]),
    ("light_tilt_y", 0.005, "relative", "measurement session", ["flat"]),
    ("light_radial", 0.005, "relative", "measurement session", ["flat"]),
    ("focus_um", 0.5, "um", "measurement session", ["edge"]),
    ("edge_shift_px", 0.5, "px", "set-up", ["edge"]),
    ("edge_angle_deg", 0.2, "deg", "set-up", ["edge"]),
    ("dark_reflectance", 0.002, "reflectance", "measurement session", ["edge"]),
    ("target_tilt_x", 0.005, "relative", "set-up", ["chart"]),
    ("target_tilt_y", 0.005, "relative", "set-up", ["chart"]),
]
CHART_LIGHTS = ("lamp", "sky", "tube")
SPECTRUM_TILT = 0.02
WHITE_E_PER_S = 90_000.0  # green electrons per second of a perfect white on axis, at level 1
CENTER = (1464, 1968)
TIMES_DARK_S = (0.001, 0.1, 0.5, 2.0)
FLAT_E = (60, 150, 400, 900, 1700, 2700, 3800, 6300, 8500)
LEVELS_FIXED_TIME = (0.25, 0.6, 1.2, 2.0)
FIELD_POINTS = [(0.0, 0.0)] + [
    (x, y) for x, y in ((0.4, 0), (-0.4, 0), (0, 0.5), (0, -0.5), (0.5, 0.5), (-0.5, 0.5), (0.5, -0.5), (-0.5, -0.5),
                        (0.95, 0.95), (-0.95, 0.95), (0.95, -0.95), (-0.95, -0.95))
]  # fmt: skip
SHORT_FLATS, SHORT_FIELDS = (0, 2, 4, 6, 8), (0, 2, 6, 9, 12)
DARK_CORNER = (0.9, 0.85)
EDGE_POINTS = {"c": (0.0, 0.0), "m": (0.5, 0.4), "o": (-0.75, -0.8)}
EDGE_ANGLES = {"vertical": 5.2, "horizontal": -4.6}
FOCUS_UM = (-8.0, 0.0, 8.0)
CHART_PLACES = {"mid": (1430, 1890), "side": (420, 600)}


@dataclass(frozen=True)
class Planned:
    """A shot of the plan: its place in nature (unknowns not drawn), frames, set-up and what it repeats."""

    place: Place
    setup: str
    session: str
    frames: int
    repeat_of: str = ""


def window_at(point, size):
    """A window of ``size`` (rows, cols) at a field point (x, y), each -1 to 1, on even rows and columns."""
    x, y = point
    row = (optics.ROWS - size[0]) / 2 * (1 + y)
    col = (optics.COLS - size[1]) / 2 * (1 + x)
    return (2 * round(row / 2), 2 * round(col / 2), *size)


def session(name, *, short=False):
    """All shots of one measurement session, in the order in which they are taken.

    The short plan holds darks and flats only, fewer levels and field points: for quick tests.
    """
    if short:
        return [*_darks(name), *_flats(name, SHORT_FLATS, LEVELS_FIXED_TIME[::2]), *_fields(name, SHORT_FIELDS)]
    rest = [*_edges(name), *_charts(name)]
    return [*_darks(name), *_flats(name, range(len(FLAT_E)), LEVELS_FIXED_TIME), *_fields(name, range(len(FIELD_POINTS))), *rest]


def _darks(session_name):
    windows = [(f"{session_name}_dark{i}", (*CENTER, 96, 96), t) for i, t in enumerate(TIMES_DARK_S)]
    windows.append((f"{session_name}_dark_corner", window_at(DARK_CORNER, (96, 96)), TIMES_DARK_S[-1]))
    return [Planned(Place(name, "dark", window, t), f"{session_name}_dark", session_name, 8) for name, window, t in windows]


def _flats(session_name, numbers, levels):
    window = (*CENTER, 96, 96)
    out = []
    for i in numbers:
        electrons = FLAT_E[i]
        place = Place(f"{session_name}_flat{i}", "flat", window, round(electrons / WHITE_E_PER_S, 7), "sphere")
        out.append(Planned(place, f"{session_name}_series", session_name, 4))
    for i, level in enumerate(levels):
        place = Place(f"{session_name}_level{i}", "flat", window, 0.02, "sphere", level)
        out.append(Planned(place, f"{session_name}_level{i}", session_name, 4))
    twin = out[-1]
    again = Place(f"{twin.place.name}r", *_tail(twin.place))
    out.append(Planned(again, f"{twin.setup}r", session_name, 4, repeat_of=twin.place.name))
    return out


def _fields(session_name, numbers):
    out = []
    for i in numbers:
        place = Place(f"{session_name}_field{i:02d}", "flat", window_at(FIELD_POINTS[i], (64, 64)), 0.03, "sphere")
        out.append(Planned(place, f"{session_name}_field", session_name, 2))
    return out


def _edges(session_name):
    out = []
    for point_name, point in EDGE_POINTS.items():
        for orientation, angle in EDGE_ANGLES.items():
            setup = f"{session_name}_edge_{point_name}{orientation[0]}"
            target = Edge(f"edge_{orientation}", orientation, angle)
            for focus in FOCUS_UM:
                name = f"{setup}_{'mzp'[int(focus > 0) - int(focus < 0) + 1]}"
                place = Place(name, "edge", window_at(point, (96, 96)), 0.05, "sphere", 1.0, focus, target)
                out.append(Planned(place, setup, session_name, 2))
    first = next(p for p in out if p.place.name.endswith("cv_z"))
    again = Place(f"{first.place.name}r", *_tail(first.place))
    out.append(Planned(again, f"{first.setup}r", session_name, 2, repeat_of=first.place.name))
    return out


def _tail(place):
    return place.role, place.window, place.time_s, place.light, place.level, place.focus_um, place.target


def chart_target():
    """The chart's boxes: 36 px patches, 4 px apart."""
    boxes = {}
    for i, name in enumerate(reflectances()):
        row, col = 7 + 40 * (i // 6), 7 + 40 * (i % 6)
        boxes[name] = (row, row + 36, col, col + 36)
    return Chart("chart", boxes)


def _charts(session_name):
    out = []
    for where, corner in CHART_PLACES.items():
        for light in CHART_LIGHTS:
            name = f"{session_name}_chart_{where}_{light}"
            place = Place(name, "chart", (*corner, 170, 250), 0.05, light, 1.0, 0.0, chart_target())
            out.append(Planned(place, name, session_name, 2))
    return out
