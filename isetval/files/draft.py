"""A first ``campaign.toml`` for a laboratory's folder: read, group, register, relate the lights, write.

The steps stand in files of their own: `folder_reading`, `shot_grouping`, `registration`, `light_levels`, `draft_priors`,
`campaign_drafting`, `draft_text`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from isetval.camera.model import CameraModel
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.scene import read_spectra
from isetval.core.sensor import Sensor
from isetval.core.toml import PACKAGE_PREFIX, data_folder
from isetval.core.writing import write_whole
from isetval.files.campaign_drafting import Drafting, drafted
from isetval.files.draft_priors import camera_words, light_priors, target_priors
from isetval.files.draft_text import draft_text
from isetval.files.draft_types import Draft, DraftPrior, Seen
from isetval.files.file_facts import FileFacts
from isetval.files.folder_reading import FolderFacts, read_folder
from isetval.files.light_levels import dark_levels, lit_setups
from isetval.files.registration import DARK_SHARE, Content, patch_levels, recognized
from isetval.files.shot_grouping import shot_groups

Progress = Callable[[str, int, int], None]
THUMBNAIL_PX = 240  # wide enough to see a chart's patches
BRIGHT_PERCENTILE = 99.5
LEAST_SIGNAL_DN = 1.0  # less than a code tells nothing
LEAST_LIKENESS = 0.5  # ours: of gradients at the same places under another light; other pictures of one bench reach .2
UNKNOWN_PITCH_UM = 1.0  # what a reader states where a file does not


def draft_campaign(folder: Path | str, *, role: str | None = None, camera: str = "", progress: Progress | None = None) -> Draft:
    """A campaign of the raw files of a folder, at all levels.

    Parameters
    ----------
    folder : path
    role : str, optional
        What all files show; default found out for each.
    camera : str, optional
        A camera model: a file in the folder, ``isetval:`` embedded data, or a file elsewhere, of which the sensor is copied.
    progress : callable, optional

    Returns
    -------
    Draft
        `write_draft` writes its text.

    Raises
    ------
    InputError
        If the folder is missing or holds no raw file that can be read, or the camera is not that of the files.
    """
    folder = Path(folder)
    model, named = _camera(camera, folder)
    found = read_folder(folder, progress=progress)
    seen = _recognized(found, role, progress)
    sensor = _sensor(found.facts, model, camera)
    work = drafted(seen, sensor, model, read_spectra(data_folder() / "spectra" / "illuminants.csv"))
    used = tuple(replace(one, shots=tuple(work.made.get(i, ()))) for i, one in enumerate(seen))
    if not work.shots:
        raise InputError(f"{folder}: no file shows a dark, a flat, a chart or an edge; the first: {seen[0].content.why}")
    return Draft(
        folder,
        folder.resolve().name,
        sensor,
        named,
        tuple(work.shots),
        tuple(work.targets),
        tuple(work.lights.values()),
        _priors(work, used),
        tuple(_unknown(work, used, found.facts, named or camera)),
        tuple(camera_words([one.group for one in used if one.content.role == "dark"], found.captures)),
        used,
        (*found.refused, *(pair for pair in found.captures.skipped if pair not in found.refused)),
        found.notes,
        found.facts[0].camera,
    )


def write_draft(draft: Draft, folder: Path | str) -> Path:
    """Write the draft, unless the folder has a campaign already.

    Raises
    ------
    InputError
        If ``campaign.toml`` exists or cannot be written.
    """
    path = Path(folder) / "campaign.toml"
    if path.exists():
        raise InputError(f"{path}: exists already; rename it first (nothing was written)")
    write_whole(path, draft_text(draft))
    return path


def _camera(camera: str, folder: Path) -> tuple[CameraModel | None, str]:
    """The model, and how the campaign names it: empty where it lies outside the folder, which a campaign may not name."""
    from isetval.camera.model_file import load_model

    if not camera:
        return None, ""
    if camera.startswith(PACKAGE_PREFIX):
        return load_model(data_folder() / camera.removeprefix(PACKAGE_PREFIX)), camera
    path = folder / camera if (folder / camera).exists() else Path(camera)
    inside = path.resolve().is_relative_to(folder.resolve())
    return load_model(path), path.resolve().relative_to(folder.resolve()).as_posix() if inside else ""


def _sensor(facts: Sequence[FileFacts], model: CameraModel | None, camera: str) -> Sensor:
    """The full sensor: that of the model, else the largest that a file states, with the black level that it is read with."""
    largest = max(facts, key=lambda f: f.sensor.rows * f.sensor.cols).sensor
    if model is None:
        return largest
    mine = model.sensor
    if mine.rows < largest.rows or mine.cols < largest.cols or mine.white_dn != largest.white_dn:
        raise InputError(
            f"{camera}: its sensor has {mine.rows} x {mine.cols} pixels and white at {mine.white_dn:g} DN, the files "
            f"{largest.rows} x {largest.cols} and {largest.white_dn:g} DN; name the model of the camera that took them"
        )
    return mine


def _recognized(found: FolderFacts, role: str | None, progress: Progress | None) -> list[Seen]:
    """What each group shows; one that cannot be looked at is a scene of which nothing is known."""
    groups = shot_groups(found.facts)
    seen = []
    for i, group in enumerate(groups):
        capture = found.captures.take("", group.first.file)
        try:
            content = (
                Content("scene", "its file can no longer be read") if capture is None else recognized(group, capture, role=role)
            )
        except Exception as error:  # one odd picture must not lose the others
            content = Content("scene", f"a defect of isetval ({type(error).__name__}: {error}); please report it")
        seen.append(Seen(group, content, thumbnail=None if capture is None else thumbnail(capture)))
        if progress is not None:
            progress(f"looking at {group.first.file}", i + 1, len(groups))
    lit = [replace(one, content=lit_after_all(one, seen)) for one in seen]
    return [_with_borrowed_pose(one, lit, found) for one in lit]


def lit_after_all(one: Seen, seen: Sequence[Seen]) -> Content:
    """A frame as dark as a dark in a bracket of lit ones: its exposure is short enough for that."""
    group, content = one.group, one.content
    if content.role != "dark" or group.words.role == "dark":
        return content
    for other in seen:
        theirs, time_s = other.group.first, other.group.first.exposure.time_s
        same = (theirs.place, theirs.window, other.group.session) == (group.first.place, group.first.window, group.session)
        if not same or other.content.role == "dark" or not time_s or other.group.clipped:
            continue
        expected = other.group.level_dn / time_s * (group.first.exposure.time_s or 0.0)
        if abs(group.level_dn - expected) < expected / 2 and expected > LEAST_SIGNAL_DN:
            return Content("scene", f"dim, but as {theirs.file} would be at its exposure")
    return content


def _with_borrowed_pose(one: Seen, seen: Sequence[Seen], found: FolderFacts) -> Seen:
    content = borrowed_pose(one, seen)
    if content is one.content or content.chart is None:
        return one
    capture = found.captures.take("", one.group.first.file)
    levels = content.chart.levels_dn if capture is None else patch_levels(capture, content.chart.boxes)
    return replace(one, content=replace(content, chart=replace(content.chart, levels_dn=levels)))


def borrowed_pose(one: Seen, seen: Sequence[Seen]) -> Content:
    """A chart that only another light or exposure shows: its pose is that of a chart found in the same set-up and window.

    Under another light the borders must lie at the same places (thumbnails correlate in the size of their
    gradients); other exposures of one bracket have one pose.
    """
    fact, content = one.group.first, one.content
    if content.role not in ("scene", "edge"):
        return content
    for other in seen:
        theirs = other.group.first
        same = (theirs.place, theirs.window, theirs.rotation_deg, other.group.session)
        if other.content.chart is None or same != (fact.place, fact.window, fact.rotation_deg, one.group.session):
            continue
        alike = float(np.corrcoef(_borders(fact), _borders(theirs))[0, 1])
        bracket = fact.wavelength_nm == theirs.wavelength_nm and fact.exposure.time_s != theirs.exposure.time_s
        if alike > LEAST_LIKENESS or (bracket and content.role == "scene" and _dim(fact)):
            why = f"the chart of {theirs.file}, found there (borders correlate by {alike:.2f})"
            return replace(content, role="chart", why=why, chart=other.content.chart, edges=())
    return content


def _dim(fact: FileFacts) -> bool:
    """Whether too little light fell for a picture to be recognized."""
    return max(fact.levels_dn) < DARK_SHARE * fact.span_dn


def _borders(fact: FileFacts) -> NDArray[np.float64]:
    """Size of the gradients of a thumbnail, flat."""
    down, across = np.gradient(fact.blocks_dn) if min(fact.blocks_dn.shape) > 1 else (fact.blocks_dn, fact.blocks_dn)
    return np.asarray(np.hypot(down, across).ravel())


def thumbnail(capture: Capture) -> NDArray[np.uint8]:
    """A small picture (rows, cols, 3) of a capture: binned, each colour scaled to its brightest part, gamma 1/2.2."""
    from isetval.measure.color.chart_finding import encode, preview

    bin_px = 2 * max(1, round(max(capture.mosaic.shape) / (2 * THUMBNAIL_PX)))
    linear = preview(capture, min(bin_px, min(capture.mosaic.shape) // 2 * 2 or 1))
    return np.ascontiguousarray(encode(linear, BRIGHT_PERCENTILE)[..., ::-1])


def _priors(work: Drafting, seen: Sequence[Seen]) -> tuple[DraftPrior, ...]:
    flats = [one.group for one in seen if one.content.role == "flat"]
    setups, _ = lit_setups(flats, dark_levels([one.group for one in seen if one.content.role == "dark"]))
    by_name = {shot.name: shot for shot in work.shots}
    again = {(s.setup, by_name[s.repeat_of].setup) for s in work.shots if s.repeat_of and s.role == "flat"}
    roles = {shot.role for shot in work.shots}
    return (*light_priors(flats, setups, sorted(again), list(work.lights.values()), roles), *target_priors(roles))


def _unknown(work: Drafting, seen: Sequence[Seen], facts: Sequence[FileFacts], camera: str) -> list[tuple[str, str, str]]:
    """What no file says: what it is, what it needs, what happens without."""
    out = []
    if not camera:
        needs = 'the nominal model of this camera, camera = "camera.toml" in this folder.'
        out.append(("camera", needs, "the campaign can be measured, not compared or diagnosed."))
    for light in work.lights.values():
        told = f"published {light.column}" if light.column != "E" else "equal energy"
        needs = f"a CSV of its spectral radiance in W/(sr m2 nm), in place of radiance, column and scale. Now: {told}."
        without = "colour ratios carry its wide prior and tell little of filters and quantum efficiency."
        out.append((f"[light.{light.name}]", needs, without))
    roles = {shot.role for shot in work.shots}
    if "chart" in roles:
        needs = 'the chart\'s own reflectances (reflectance = "chart.csv" with a column for each patch).'
        without = "coloured patches are taken for greys of their luminance, so nothing can be said of colour."
        out.append(("[target.chart_*]", needs, without))
    if "edge" in roles:
        needs = "reflectance of both sides."
        out.append(("[target.edge_*]", needs, "levels were read off the files, so edges tell sharpness and not brightness."))
    bare = sorted({one.group.words.number for one in seen if one.shots and one.group.words.number})
    if bare:
        needs = f"distance_m of the shots in folders called {', '.join(bare)}, if that is their distance and in which unit."
        out.append(("distance_m", needs, "defocus by distance is left to focus_um."))
    elif roles & {"edge", "chart"} and not any(one.group.words.distance_m for one in seen):
        out.append(("distance_m", "the distance of edges and charts in m.", "defocus by distance is left to focus_um."))
    crops = [f for f in facts if not f.placed and (f.window.rows, f.window.cols) != (work.sensor.rows, work.sensor.cols)]
    if crops:
        needs = f"the place of {len(crops)} crops on the sensor (window = [row0, col0, rows, cols]); their files do not state it."
        out.append(("window", needs, "they are taken to lie in the middle: fall-off is compared at a wrong place."))
    timeless = [f for f in facts if f.exposure.time_s is None]
    if timeless:
        needs = f"the exposure time of {len(timeless)} files, which state none ({timeless[0].file} ...)."
        out.append(("exposure_s", needs, "they are measured, but no model can shoot them."))
    if work.sensor.pixel_um == UNKNOWN_PITCH_UM and not camera:
        out.append(("[sensor] pixel_um", "the pixel pitch in um.", "lengths in mm mean thousands of pixels."))
    scenes = sum(not one.shots for one in seen)
    if scenes:
        out.append(("scenes", f"a scene file for the {scenes} groups listed at the end.", "they are not measured."))
    return out
