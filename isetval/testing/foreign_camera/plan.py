"""The laboratory's plans: which shots a session holds, and how well the laboratory knows its numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from .spectra import reflectances
from .types import Camera, Chart, Edge, Place, Window


@dataclass(frozen=True)
class Prior:
    """How well the laboratory knows a number: standard deviation, what shares one value, and which shots it touches."""

    parameter: str
    sigma: float
    unit: str
    scope: str
    roles: tuple[str, ...] = ()
    lights: tuple[str, ...] = ()
    setups: tuple[str, ...] = ()


LIT = ("flat", "edge", "chart")
PRIORS = (
    Prior("light_level", 0.02, "relative", "set-up", LIT),
    Prior("light_level", 0.001, "relative", "frame", LIT),
    Prior("light_tilt_x", 0.005, "relative", "measurement session", ("flat",)),
    Prior("light_tilt_y", 0.005, "relative", "measurement session", ("flat",)),
    Prior("light_radial", 0.005, "relative", "measurement session", ("flat",)),
    Prior("focus_um", 0.5, "um", "measurement session", ("edge",)),
    Prior("edge_shift_px", 0.5, "px", "set-up", ("edge",)),
    Prior("edge_angle_deg", 0.2, "deg", "set-up", ("edge",)),
    Prior("dark_reflectance", 0.002, "reflectance", "measurement session", ("edge",)),
    Prior("target_tilt_x", 0.005, "relative", "set-up", ("chart",)),
    Prior("target_tilt_y", 0.005, "relative", "set-up", ("chart",)),
)
CHART_LIGHTS = ("lamp", "sky", "tube")
SPECTRUM_TILT = 0.02
# the sensor's temperature differs by half a kelvin between sessions: dark current doubles in about 8 K
TEMPERATURE = Prior("dark_current.rate_e_per_s", 0.011, "e-/s", "measurement session")
WHITE_E_PER_S = 90_000.0  # green electrons per second of a perfect white on axis, at level 1
CENTER = (1464, 1968)
TIMES_DARK_S = (0.001, 0.1, 0.5, 2.0)
FLAT_E = (60, 150, 400, 900, 1700, 2700, 3800, 6300, 8500)
LEVELS_FIXED_TIME = (0.25, 0.6, 1.2, 2.0)
FIELD_POINTS = [(0.0, 0.0)] + [
    (x, y) for x, y in ((0.4, 0), (-0.4, 0), (0, 0.5), (0, -0.5), (0.5, 0.5), (-0.5, 0.5), (0.5, -0.5), (-0.5, -0.5),
                        (0.95, 0.95), (-0.95, 0.95), (0.95, -0.95), (-0.95, -0.95))
]  # fmt: skip
FEW_FLATS, FEW_FIELDS = (0, 2, 4, 6, 8), (0, 2, 6, 9, 12)
DARK_CORNER = (0.9, 0.85)
EDGE_POINTS = {"c": (0.0, 0.0), "m": (0.5, 0.4), "o": (-0.75, -0.8)}
EDGE_ANGLES = {"vertical": 5.2, "horizontal": -4.6}
FOCUS_UM = (-8.0, 0.0, 8.0)
# what a laboratory knows that never ran through focus: the film stands where the phone put it, to 2 um, a depth of focus at f/1.7
LOOSE_FOCUS_UM = 2.0
CHART_PLACES = {"mid": (1430, 1890), "side": (420, 600)}
# small: darks and flats; edges: two edge points, one chart place and two of its lights besides; one_focus: three edge points and
# darks and flats, all at best focus as far as anybody knows; full: a laboratory's whole day
PLANS = ("small", "edges", "one_focus", "full")


@dataclass(frozen=True)
class Planned:
    """A shot of the plan: its place in nature (unknowns not drawn), frames, set-up and what it repeats."""

    place: Place
    setup: str
    session: str
    frames: int
    repeat_of: str = ""


def priors(plan: str) -> tuple[Prior, ...]:
    """Every prior of a plan; spectra and the sensor's temperature are unknown where a plan can tell."""
    tilts = [
        Prior("spectrum_tilt", SPECTRUM_TILT, "relative per 100 nm", "measurement session", (), (light,))
        for light in ("sphere", *CHART_LIGHTS)
    ]
    known = [replace(p, sigma=LOOSE_FOCUS_UM) if plan == "one_focus" and p.parameter == "focus_um" else p for p in PRIORS]
    return (*known, *tilts, *((TEMPERATURE,) if plan != "small" else ()))


def window_at(camera: Camera, point: tuple[float, float], size: tuple[int, int]) -> Window:
    """A window of ``size`` (rows, cols) at a field point (x, y), each -1 to 1, on even rows and columns."""
    x, y = point
    row = (camera.rows - size[0]) / 2 * (1 + y)
    col = (camera.cols - size[1]) / 2 * (1 + x)
    return (2 * round(row / 2), 2 * round(col / 2), *size)


def session(camera: Camera, name: str, plan: str = "full") -> list[Planned]:
    """All shots of one measurement session, in the order in which they are taken."""
    full = plan == "full"
    numbers, levels = (range(len(FLAT_E)), LEVELS_FIXED_TIME) if full else (FEW_FLATS, LEVELS_FIXED_TIME[::2])
    fields = range(len(FIELD_POINTS)) if full else FEW_FIELDS
    out = [*_darks(camera, name), *_flats(name, numbers, levels), *_fields(camera, name, fields)]
    if plan == "edges":
        out += [*_edges(camera, name, ("c", "o")), *_charts(name, ("mid",), ("lamp", "tube"))]
    if plan == "one_focus":
        out += _edges(camera, name, EDGE_POINTS, focus_um=(0.0,))
    if full:
        out += [*_edges(camera, name, EDGE_POINTS), *_charts(name, CHART_PLACES, CHART_LIGHTS)]
    return out


def _darks(camera: Camera, session_name: str) -> list[Planned]:
    windows: list[tuple[str, Window, float]] = [
        (f"{session_name}_dark{i}", (*CENTER, 96, 96), t) for i, t in enumerate(TIMES_DARK_S)
    ]
    windows.append((f"{session_name}_dark_corner", window_at(camera, DARK_CORNER, (96, 96)), TIMES_DARK_S[-1]))
    return [Planned(Place(name, "dark", window, t), f"{session_name}_dark", session_name, 8) for name, window, t in windows]


def _flats(session_name: str, numbers: Iterable[int], levels: Sequence[float]) -> list[Planned]:
    window = (*CENTER, 96, 96)
    out = []
    for i in numbers:
        place = Place(f"{session_name}_flat{i}", "flat", window, round(FLAT_E[i] / WHITE_E_PER_S, 7), "sphere")
        out.append(Planned(place, f"{session_name}_series", session_name, 4))
    for i, level in enumerate(levels):
        place = Place(f"{session_name}_level{i}", "flat", window, 0.02, "sphere", level)
        out.append(Planned(place, f"{session_name}_level{i}", session_name, 4))
    return [*out, _again(out[-1])]


def _again(twin: Planned) -> Planned:
    """The shot once more, with a set-up made anew."""
    place = replace(twin.place, name=f"{twin.place.name}r")
    return replace(twin, place=place, setup=f"{twin.setup}r", repeat_of=twin.place.name)


def _fields(camera: Camera, session_name: str, numbers: Iterable[int]) -> list[Planned]:
    out = []
    for i in numbers:
        place = Place(f"{session_name}_field{i:02d}", "flat", window_at(camera, FIELD_POINTS[i], (64, 64)), 0.03, "sphere")
        out.append(Planned(place, f"{session_name}_field", session_name, 2))
    return out


def _edges(camera: Camera, session_name: str, points: Iterable[str], focus_um: Iterable[float] = FOCUS_UM) -> list[Planned]:
    out = []
    for point in points:
        for orientation, angle in EDGE_ANGLES.items():
            setup = f"{session_name}_edge_{point}{orientation[0]}"
            target = Edge(f"edge_{orientation}", orientation, angle)
            window = window_at(camera, EDGE_POINTS[point], (96, 96))
            for focus in focus_um:
                name = f"{setup}_{'mzp'[int(focus > 0) - int(focus < 0) + 1]}"
                out.append(Planned(Place(name, "edge", window, 0.05, "sphere", 1.0, focus, target), setup, session_name, 2))
    first = next(p for p in out if p.place.name.endswith("cv_z"))
    return [*out, _again(first)]


def chart_target() -> Chart:
    """The chart's boxes: 36 px patches, 4 px apart."""
    boxes = {}
    for i, name in enumerate(reflectances()):
        row, col = 7 + 40 * (i // 6), 7 + 40 * (i % 6)
        boxes[name] = (row, row + 36, col, col + 36)
    return Chart("chart", boxes)


def _charts(session_name: str, places: Iterable[str], lights: Iterable[str]) -> list[Planned]:
    out = []
    for where in places:
        for light in lights:
            name = f"{session_name}_chart_{where}_{light}"
            place = Place(name, "chart", (*CHART_PLACES[where], 170, 250), 0.05, light, 1.0, 0.0, chart_target())
            out.append(Planned(place, name, session_name, 2))
    return out
