# %% [markdown]
# # The plan of the Cornell box captures
#
# Question: which windows, patches and lines of the sensor hold what the paper measures in its box?
# Data: own geometry (`isetval/scenes/box.py`); the paper's list of captures: chart left, middle and right on the rear
# wall; edges at 0.3 m and 0.5 m, each with the lens focused at either.
# Result: `data/scenes/chart_{left,middle,right}.toml` and `data/pixel4a/cornell_box.toml`.
# Run time: a second.

# %%
from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from isetval.scenes import load_scene
from isetval.scenes.rendered.placing import project_px

ROOT = Path(__file__).resolve().parents[1] / "data"
HEAD = "# Written by analyses/make_cornell_plan.py.  Licence: that of the project.  Source: own numbers.\n"
CHART = """{head}# The box with its chart on the rear wall, {words}.
kind = "cornell_box"
name = "chart_{place}"
source = "own numbers; bounces from the paper, camera distance and light position from its public scripts"

[parameters]
bounces = 6
blocks = []

[[parameters.charts]]
kind = "chart"
center_m = [{x}, 0.0]
patch_mm = 10.0
gap_mm = 2.0

[camera.paper]
z_m = 0.40

[render]
spp = {spp}
"""
SHOT = """
[[shot]]
name = "{name}"
role = "{role}"
setup = "{setup}"
measurement_session = "A"
target = "{target}"
exposure_s = {time}
iso = 55
frames = {frames}
window = {window}
"""


# %%
def even(values: Any) -> list[int]:
    """Whole even numbers, so that the colour pattern keeps its phase."""
    return [2 * round(float(v) / 2) for v in values]


def chart_target(place: str) -> tuple[str, list[int]]:
    """The table of a chart position (six greys and the line through them) and its window."""
    scene = load_scene(ROOT / "scenes" / f"chart_{place}.toml")
    corners = scene.spec["targets"]["charts"][0]
    greys = {n: project_px(scene.cameras["paper"], corners[n]) for n in (f"grey_{i}" for i in range(1, 7))}
    low = np.min([p.min(axis=0) for p in greys.values()], axis=0)
    high = np.max([p.max(axis=0) for p in greys.values()], axis=0)
    row0, col0 = even(low - 6)
    window = [row0, col0, *even(high - low + 12)]
    lines = [f"[target.{place}]", 'kind = "scene"', f'file = "isetval:scenes/chart_{place}.toml"']
    for name, points in greys.items():
        middle, half = points.mean(axis=0) - [row0, col0], 0.32 * np.ptp(points, axis=0)
        box = [round(v) for v in (middle[0] - half[0], middle[0] + half[0], middle[1] - half[1], middle[1] + half[1])]
        lines += [f"[[target.{place}.patch]]", f'name = "{name}"', f"box = {box}"]
    row = float(np.mean([p.mean(axis=0)[0] for p in greys.values()])) - row0
    ends = [[round(row, 1), 2.0], [round(row, 1), float(window[3] - 3)]]
    lines += [f"[[target.{place}.line]]", 'name = "greys"', f"from = {ends[0]}", f"to = {ends[1]}"]
    return "\n".join(lines) + "\n", window


def edge_window(index: int) -> list[int]:
    """64 x 80 pixels around the middle of an edge of the edge scene."""
    scene = load_scene(ROOT / "scenes" / "slanted_edges.toml")
    middle = project_px(scene.cameras["paper"], scene.spec["targets"]["edges"][index]).mean(axis=0)
    return [*even(middle - [32, 40]), 64, 80]


def main() -> None:
    """Write scene files and plan."""
    places = {
        "left": (-0.095, "beside the red wall"),
        "middle": (0.0, "in the middle"),
        "right": (0.095, "beside the green wall"),
    }
    text = (
        HEAD
        + "# The paper's captures of the Cornell box: the chart at three places, edges at two distances and two focus settings.\n"
    )
    text += "# `isetval simulate data/pixel4a/camera.toml data/pixel4a/cornell_box.toml -o DIR` makes them.\n"
    text += 'name = "cornell_box"\ncamera = "camera.toml"\n\n'
    shots = ""
    for place, (x, words) in places.items():
        file = ROOT / "scenes" / f"chart_{place}.toml"
        file.write_text(CHART.format(head=HEAD, place=place, words=words, x=x, spp=256))
        target, window = chart_target(place)
        text += target + "\n"
        shots += SHOT.format(
            name=f"chart_{place}", role="scene", setup=f"chart_{place}", target=place, time=0.04, frames=3, window=window
        )
    text += '[target.edges]\nkind = "scene"\nfile = "isetval:scenes/slanted_edges.toml"\n\n'
    text += "# distance_m is that of the edge, focus_m what the lens is focused on: the camera model makes the blur of both\n"
    for focus in ("0.5", "0.3"):
        for index, distance in enumerate(("0.5", "0.3")):
            shot = SHOT.format(
                name=f"edge_{distance}_focus_{focus}".replace(".", ""),
                role="edge",
                setup=f"edges_focus_{focus}",
                target="edges",
                time=0.05,
                frames=3,
                window=edge_window(index),
            )
            shots += shot + f"distance_m = {distance}\nfocus_m = {focus}\n"
    (ROOT / "pixel4a" / "cornell_box.toml").write_text(text + shots)


if __name__ == "__main__":
    main()
