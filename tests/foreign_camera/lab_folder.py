"""A folder as a laboratory leaves it: pictures with a phone's names and times in folders of folders, and no word on them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path

from isetval.testing.foreign_camera import campaign, plan
from isetval.testing.foreign_camera.camera_file import nominal_camera
from isetval.testing.foreign_camera.dngfile import write_dng
from isetval.testing.foreign_camera.sensor import specimen_of
from isetval.testing.foreign_camera.spectra import reflectances
from isetval.testing.foreign_camera.types import Chart, Edge, Place

VISITS = {"A": datetime(2026, 3, 2, 10, 0), "B": datetime(2026, 3, 5, 14, 30)}
FRAME_WINDOW, EDGE_WINDOW, CHART_WINDOW = (1464, 1968, 96, 96), (1464, 1968, 96, 96), (1408, 1872, 208, 288)
DARK_S = (0.001, 0.5, 2.0)
SERIES_E = (150, 400, 900, 2700, 4500)
LEVELS = {"dim": 0.25, "half": 0.6, "half_repeat": 0.6}
LEVEL_S = 0.04
PLACES = {
    "topleft": (0, 0), "top": (0, 16), "topright": (0, 36), "left": (14, 4), "mid": (18, 18), "right": (22, 34),
    "bottomleft": (36, 2), "bottomright": (36, 38),
}  # fmt: skip
DISTANCES, FOCI_UM = {"20cm": 5.6, "35cm": -4.7}, (-6.0, 4.0)


@dataclass(frozen=True)
class TrueShot:
    """What a group of files is: the place in nature (unknowns drawn), its folder, visit and files."""

    place: Place
    session: str
    folder: str
    files: tuple[str, ...]

    @property
    def level(self):
        """The light as it was, relative to the plan's."""
        return self.place.level * (1 + self.place.get("light_level"))


def shots(session, places):
    """(folder, place, frames) of all shots of a visit."""
    day = VISITS[session].strftime("%Y-%m-%d")
    for i, t in enumerate(DARK_S):
        yield f"{day}/cap on", Place(f"{session}_d{i}", "dark", FRAME_WINDOW, t), 3
    for i, electrons in enumerate(SERIES_E):
        place = Place(f"{session}_s{i}", "flat", FRAME_WINDOW, round(electrons / plan.WHITE_E_PER_S, 7), "sphere")
        yield f"{day}/sphere/series", place, 3
    for name, level in LEVELS.items():
        yield f"{day}/sphere/{name}", Place(f"{session}_{name}", "flat", FRAME_WINDOW, LEVEL_S, "sphere", level), 3
    for distance, angle in DISTANCES.items():
        orientation = "vertical" if angle > 0 else "horizontal"
        for focus in FOCI_UM:
            target = Edge("e", orientation, angle)
            place = Place(f"{session}_{distance}{focus}", "edge", EDGE_WINDOW, 0.05, "sphere", 1.0, focus, target)
            yield f"{day}/blade/{distance}/focus{focus:+.0f}um", place, 2
    if session == "A":
        for light in plan.CHART_LIGHTS:
            for name, corner in list(PLACES.items())[:places]:
                place = Place(f"{session}_{light}_{name}", "chart", CHART_WINDOW, 0.05, light, 1.0, 0.0, _chart(corner))
                yield f"{day}/QE calibration/{light}/{name}", place, 1


def _chart(corner):
    boxes = {}
    for i, name in enumerate(reflectances()):
        row, col = 7 + corner[0] + 40 * (i // 6), 7 + corner[1] + 40 * (i % 6)
        boxes[name] = (row, row + 36, col, col + 36)
    return Chart("chart", boxes)


def write_lab(folder, nominal_folder, *, seed, places=8, hidden=None, blur_chart=False):
    """Shoot both visits into ``folder``; returns the true shots.  Charts are sharp unless ``blur_chart``, which takes time."""
    folder = Path(folder)
    nominal = nominal_camera(Path(nominal_folder) / "camera.toml")
    lights = campaign.lights_of(nominal)
    camera = specimen_of(nominal, seed, hidden)
    truth, number = [], 0
    for session, start in VISITS.items():
        now = start
        for where, place, frames in shots(session, places):
            planned = plan.Planned(place, f"{session} {where}", session, frames)
            names = []
            for codes in campaign.shoot(planned, camera, lights, seed, blur_chart=blur_chart):
                number, now = number + 1, now + timedelta(seconds=40)
                name = f"{where}/IMG_{number:04d}.dng"
                (folder / where).mkdir(parents=True, exist_ok=True)
                row0, col0 = place.window[:2]
                phase = [((row0 + r) % 2) + ((col0 + c) % 2) for r in (0, 1) for c in (0, 1)]
                write_dng(
                    folder / name, codes, phase=phase, black=nominal.black, white=nominal.white, time_s=place.time_s,
                    pixel_um=1.4, taken=now.strftime("%Y:%m:%d %H:%M:%S"),
                )  # fmt: skip
                names.append(name)
            truth.append(TrueShot(replace(place, unknown=campaign.draw_unknowns(planned, seed)), session, where, tuple(names)))
    return truth
