"""A first ``campaign.toml`` for a laboratory's folder: read, group, register, relate the lights, write.

The steps stand in files of their own: `folder_reading`, `shot_grouping`, `recognition` with `registration`, `light_levels`,
`drafting`, `chart_drafting`, `campaign_drafting`, `draft_priors`, `draft_text`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from isetval.camera.model import CameraModel, same_field
from isetval.core.campaign import Light
from isetval.core.errors import InputError
from isetval.core.scene import read_spectra
from isetval.core.sensor import Sensor
from isetval.core.toml import PACKAGE_PREFIX, data_folder
from isetval.core.writing import write_whole
from isetval.files.campaign_drafting import drafted
from isetval.files.chart_drafting import bracket_scatter
from isetval.files.chart_parts import part_files
from isetval.files.dng.metadata import UNKNOWN_PITCH_UM
from isetval.files.draft_priors import camera_words, light_priors, target_priors
from isetval.files.draft_text import draft_text
from isetval.files.draft_types import Draft, DraftLight, DraftPrior, DraftShot, Seen
from isetval.files.drafted_camera import CAMERA, drafted_camera, with_channel_gain
from isetval.files.drafting import Drafting, unscaled_light
from isetval.files.file_facts import FileFacts
from isetval.files.folder_reading import FolderFacts, read_folder
from isetval.files.light_levels import dark_levels, lit_setups
from isetval.files.recognition import recognize_all
from isetval.files.scene_drafting import SCENE_TARGET, BuiltScene, add_scene_shot, read_built_scene
from isetval.files.spectra_search import FolderSpectra, chart_reflectances, find_spectra
from isetval.measure.color.chart_layout import PATCH_NAMES

Progress = Callable[[str, int, int], None]
SCENE_ROLES = ("chart", "edge")


def draft_campaign(
    folder: Path | str, *, role: str | None = None, camera: str = "", scene: str = "", progress: Progress | None = None
) -> Draft:
    """The first of `draft_campaigns`: of a folder of one camera whose files have one size of pixels, the only one."""
    return draft_campaigns(folder, role=role, camera=camera, scene=scene, progress=progress)[0]


def draft_campaigns(
    folder: Path | str, *, role: str | None = None, camera: str = "", scene: str = "", progress: Progress | None = None
) -> tuple[Draft, ...]:
    """Campaigns of the raw files of a folder, at all levels: one for each size of pixels.

    Parameters
    ----------
    folder : path
    role : str, optional
        What all files show; default found out for each.
    camera : str, optional
        A camera model: a file in the folder, ``isetval:`` embedded data, or a file elsewhere, of which the sensor is copied.
        Without one, a model is drafted from the darks and flats of the first visit, where they suffice.
    scene : str, optional
        The scene file (in the folder, or ``isetval:``) of what stands in the pictures of charts and edges: they become shots of
        its rendering, seen from where the camera stood.
    progress : callable, optional

    Returns
    -------
    tuple of Draft
        `write_draft` writes the text of each.

    Raises
    ------
    InputError
        If the folder is missing or holds no raw file that can be read, or the camera is not that of the files.
    """
    folder = Path(folder)
    model, named = _camera(camera, folder)
    found = read_folder(folder, progress=progress).parts()
    spectra = find_spectra(folder)
    built = read_built_scene(scene, folder) if scene else None
    drafts = []
    for number, part in enumerate(found, 1):
        try:
            models = (model, named or camera, named)
            first = number == 1
            drafts.append(
                _draft(folder, part, role=role, models=models, spectra=spectra, built=built, first=first, progress=progress)
            )
        except InputError as error:  # the first part stands for the folder; another that fails is told with it
            if number == 1:
                raise
            words = f"{len(part.facts)} files with pixels of {part.facts[0].sensor.pixel_um:g} um make no campaign: {error}"
            drafts[0] = replace(drafts[0], notes=(*drafts[0].notes, words))
    return tuple(replace(one, number=i, name=one.name + (f"_{i}" if i > 1 else "")) for i, one in enumerate(drafts, 1))


def _draft(
    folder: Path,
    found: FolderFacts,
    *,
    role: str | None,
    models: tuple[CameraModel | None, str, str],
    spectra: FolderSpectra,
    built: BuiltScene | None,
    first: bool,
    progress: Progress | None,
) -> Draft:
    """The campaign of the files of one size of pixels."""
    nominal, camera, named = models
    seen = recognize_all(found, role=role, progress=progress)
    sensor = _sensor(found.facts, nominal, camera)
    name, made, words = folder.resolve().name, None, ""
    if not camera and first and (folder / CAMERA).exists():
        words = f"{CAMERA} lies in the folder and was not asked for: --camera {CAMERA}"
    elif not camera and first:
        made, words = drafted_camera(name, sensor, seen, found.captures)
        nominal, camera, named = (made, CAMERA, CAMERA) if made else (None, "", "")
    model = None if nominal is None else nominal.sampled_as(sensor)
    illuminants = read_spectra(data_folder() / "spectra" / "illuminants.csv")
    work = drafted(seen, sensor, model, illuminants, spectra, without=() if built is None else SCENE_ROLES)
    made = made and _with_the_flats_color(made, work)
    seen = seen if built is None else _with_scene(work, seen, built)
    used = tuple(replace(one, shots=tuple(work.made.get(i, ()))) for i, one in enumerate(seen))
    if not work.shots:
        raise InputError(f"{folder}: no file shows a dark, a flat, a chart or an edge; the first: {seen[0].content.why}")
    return Draft(
        folder,
        name,
        sensor,
        named,
        tuple(work.shots),
        tuple(work.targets),
        tuple(work.lights.values()),
        _priors(work, used, made is None),
        tuple(_unknown(work, used, found.facts, camera, made is not None)),
        tuple(camera_words([one.group for one in used if one.content.role == "dark"], found.captures)),
        used,
        (*found.refused, *(pair for pair in found.captures.skipped if pair not in found.refused)),
        (*found.notes, *([words] if words else [])),
        found.facts[0].camera,
        resampled=nominal is not None and sensor is not nominal.sensor,
        drafted=made,
    )


def _with_the_flats_color(model: CameraModel, work: Drafting) -> CameraModel:
    """The drafted model with the colour of the brightest flats that are not clipped."""
    flats = [shot for shot in work.shots if shot.role == "flat" and not shot.group.clipped]
    if not flats:
        return model
    brightest = max(flats, key=lambda shot: shot.group.level_dn)
    spectrum = unscaled_light(work, brightest.light, brightest.group)[1]
    return with_channel_gain(model, brightest.group, Light(brightest.light, spectrum))


def _with_scene(work: Drafting, seen: Sequence[Seen], built: BuiltScene) -> list[Seen]:
    """Shots of the scene for all pictures of charts and edges; those without a pose keep the reason."""
    out = list(seen)
    for i, one in enumerate(seen):
        why = add_scene_shot(work, i, one.group, built) if one.content.role in SCENE_ROLES else None
        if why is not None:
            out[i] = replace(one, content=replace(one.content, role="scene", why=why))
    return out


def check_free(folder: Path | str, *names: str) -> None:
    """Refuse a folder that may not be written, or that has one of the files already: before minutes of reading, and once more.

    Raises
    ------
    InputError
        With the file and what to do.
    """
    folder = Path(folder)
    for file in map(folder.joinpath, names):
        if file.exists():
            raise InputError(f"{file}: exists already; rename it first (nothing was written)")
    if folder.is_dir() and not os.access(folder, os.W_OK):
        raise InputError(
            f"{folder}: may not be written, and the campaign has to lie with its files; copy the folder to a disk of yours"
        )


def write_draft(draft: Draft, folder: Path | str) -> Path:
    """Write the draft, unless the folder has a campaign already.

    Raises
    ------
    InputError
        If its file exists or cannot be written.
    """
    path = Path(folder) / draft.file
    camera = path.with_name(CAMERA)
    # page and parts are written next
    files = (path, path.with_suffix(".html"), *([camera] if draft.drafted else []), *part_files(path))
    check_free(folder, *(file.name for file in files))
    if draft.drafted is not None:
        draft.drafted.save(camera)
    write_whole(path, draft_text(draft))
    return path


def _camera(camera: str, folder: Path) -> tuple[CameraModel | None, str]:
    """The model, and how the campaign names it: empty where it lies outside the folder, which a campaign may not name."""
    from isetval.camera.model_file import load_model

    if not camera:
        return None, ""
    if camera.startswith(PACKAGE_PREFIX):
        return load_model(camera), camera
    path = folder / camera if (folder / camera).exists() else Path(camera)
    inside = path.resolve().is_relative_to(folder.resolve())
    return load_model(path), path.resolve().relative_to(folder.resolve()).as_posix() if inside else ""


def _sensor(facts: Sequence[FileFacts], model: CameraModel | None, camera: str) -> Sensor:
    """The full sensor: that of the model, else the largest that a file states, with the black level that it is read with."""
    largest = max(facts, key=lambda f: f.sensor.rows * f.sensor.cols).sensor
    if model is None:
        return largest
    mine = model.sensor
    if same_field(mine, largest):
        return largest
    if mine.rows < largest.rows or mine.cols < largest.cols or mine.white_dn != largest.white_dn:
        raise InputError(
            f"{camera}: its sensor has {mine.rows} x {mine.cols} pixels and white at {mine.white_dn:g} DN, the files "
            f"{largest.rows} x {largest.cols} and {largest.white_dn:g} DN; name the model of the camera that took them"
        )
    return mine


def _priors(work: Drafting, seen: Sequence[Seen], camera_known: bool) -> tuple[DraftPrior, ...]:
    flats = [one.group for one in seen if one.content.role == "flat"]
    setups, _ = lit_setups(flats, dark_levels([one.group for one in seen if one.content.role == "dark"]))
    by_name = {shot.name: shot for shot in work.shots}
    again = {(s.setup, by_name[s.repeat_of].setup) for s in work.shots if s.repeat_of and s.role == "flat"}
    roles = {shot.role for shot in work.shots}
    tilts = [tilt for tilt in work.tilts if tilt is not None]
    known = camera_known or chart_reflectances(work.folder_spectra, PATCH_NAMES) is not None
    targets = target_priors(roles, tilt=max(tilts, default=None), colors_known=known)
    lights = list(work.lights.values())
    return (*light_priors(flats, setups, sorted(again), lights, roles, bracket_scatter(work)), *targets, *work.priors)


def _of_scene(shot: DraftShot) -> bool:
    return shot.target.startswith(SCENE_TARGET)


def _spectrum_words(light: DraftLight) -> str:
    if light.file:
        return f"{light.column} of {light.file}, scaled"
    if light.band_nm is not None:
        return f"a band of {light.band_nm[1]:g} nm at {light.band_nm[0]:g} nm"
    return f"published {light.column}" if light.column != "E" else "equal energy"


def _unknown(
    work: Drafting, seen: Sequence[Seen], facts: Sequence[FileFacts], camera: str, estimated: bool
) -> list[tuple[str, str, str]]:
    """What no file says: what it is, what it needs, what happens without."""
    out = []
    if not camera:
        needs = (
            'the nominal model of this camera: camera = "camera.toml" in this folder, or "isetval:NAME", in place of [sensor]; '
            "isetval campaign init --camera MODEL drafts it so."
        )
        out.append(("camera", needs, "the campaign can be measured, not compared or diagnosed."))
    if estimated:
        needs = "the camera's own spectral curves (quantum_efficiency), its lens (a lens file, defocus)."
        without = "curves of another camera, in the flats' colour, and a perfect focus stand in; comparing shows where they fail."
        out.append((CAMERA, needs, without))
    alike: dict[str, list[str]] = {}
    for light in work.lights.values():
        alike.setdefault(_spectrum_words(light), []).append(f"[light.{light.name}]")
    for now, names in alike.items():
        needs = f"a CSV of its spectral radiance in W/(sr m2 nm), in place of radiance, column and scale. Now: {now}."
        without = "colour ratios carry its wide prior and tell little of filters and quantum efficiency."
        out.append((", ".join(names), needs, without))
    roles = {shot.role for shot in work.shots if not _of_scene(shot)}
    if any(map(_of_scene, work.shots)):
        needs = "the spectra of its lamp and papers in the scene file ([spectra.NAME])."
        without = "isetval's own papers and lamp stand in; only the lamp's level is read off the white patch."
        out.append(("[target.scene_*]", needs, without))
    if "chart" in roles and chart_reflectances(work.folder_spectra, PATCH_NAMES) is None:
        needs = 'the chart\'s own reflectances (reflectance = "chart.csv" with a column for each patch).'
        without = (
            "smooth spectra of the published colours stand in, .06 rms off a real chart, so that little can be said of colour."
        )
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
