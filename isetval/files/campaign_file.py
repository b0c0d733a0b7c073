"""Campaign folders: ``campaign.toml`` beside its DNG files, read strictly and without loading them all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from isetval.camera.model import CameraModel
from isetval.camera.model_file import load_model, model_path, read_sensor
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.given import GivenMetrics
from isetval.core.scene import Spectrum, Target, band_limited, narrow_band, read_spectra
from isetval.core.sensor import Exposure, Sensor, Window
from isetval.core.toml import PACKAGE_PREFIX, check_keys, inside, named_file, number, numbers, read_toml, tables, text, texts
from isetval.files.captures import FileCaptures
from isetval.files.emva_descriptor import find_emva_descriptor, load_emva_descriptor
from isetval.files.metric_file import Reading, read_metrics
from isetval.files.target_file import read_target

MOST_FRAMES = 100_000  # of a shot: a typing error of more would be simulated for years
RECENT_PIXELS = 100_000_000  # 200 MB: eight frames of 12 MP, the files of a shot that is looked at in parts
_KEYS = ("name", "camera", "sensor", "nuisance", "light", "target", "shot", "notes")
METRIC_KEYS = ("metric", "column", "sigma", "edge", "correlation_length", "covariance")
"""Keys of a shot that say how its metrics file is read, beside method and channel."""
_SHOT_KEYS = (
    "name", "role", "measurement_session", "setup", "light", "light_level", "exposure_s", "iso", "rotation_deg", "window",
    "size", "frames", "files", "target", "focus_um", "focus_m", "distance_m", "repeat_of", "method", "channel",
    "photons_per_pixel", "levels_only", "notes", "metrics", *METRIC_KEYS,
)  # fmt: skip
_NUISANCE_KEYS = ("parameter", "sigma", "unit", "scope", "distribution", "roles", "lights", "setups", "notes")


def load_campaign(path: Path | str, *, camera: CameraModel | None = None) -> Campaign:
    """Read a campaign or a plan: a folder with ``campaign.toml`` or an EMVA 1288 descriptor, or one of these files itself.

    The DNG files are opened when their shot is measured; that they exist is checked here.

    Parameters
    ----------
    path : path
    camera : CameraModel, optional
        Stands in for a camera that the file names outside its folder, which is not opened.

    Raises
    ------
    InputError
        For unknown keys, missing files, names that lead out of the folder, unknown lights or targets, or values that
        make no sense.
    """
    path = Path(path)
    if not (path / "campaign.toml").is_file():
        descriptor = find_emva_descriptor(path)
        if descriptor is not None:
            return load_emva_descriptor(descriptor, **({} if camera is None else {"pixel_um": camera.sensor.pixel_um}))
    if path.is_dir():
        path = path / "campaign.toml"
        if not path.is_file():
            raise InputError(f"{path.parent}: holds no campaign.toml; make one with 'isetval campaign init {path.parent}'")
    table = check_keys(read_toml(path), str(path), known=_KEYS, needed=("shot",))
    sensor, named = _sensor(table, path, camera)
    lights = {name: _light(name, entry, path) for name, entry in _tables(table, "light", path).items()}
    targets = {name: read_target(name, entry, path) for name, entry in _tables(table, "target", path).items()}
    if not isinstance(table["shot"], list) or not table["shot"]:
        raise InputError(f"{path}: there is no [[shot]]; a campaign needs at least one")
    shots = tuple(_shot(entry, f"{path}: [[shot]] number {i}", targets, path) for i, entry in enumerate(table["shot"], 1))
    shots = _found_repeats(_told_apart(shots, table["shot"]))
    sensor = sensor or _sensor_of_files(shots, path)
    where = f"{path}: [[shot]] number"
    shots = tuple(
        replace(shot, given=_given(entry, f"{where} {i}", sensor, path)) if "metrics" in entry else shot
        for i, (shot, entry) in enumerate(zip(shots, table["shot"], strict=True), 1)
    )
    try:
        campaign = Campaign(
            name=text(table, "name", str(path), path.parent.name),
            shots=tuple(_sized(shot, sensor, path) for shot in shots),
            lights=lights,
            nuisances=tuple(
                _nuisance(entry, f"{path}: [[nuisance]] number {i}")
                for i, entry in enumerate(tables(table, "nuisance", str(path)), 1)
            ),
            sensor=sensor,
            camera=named,
            folder=path.parent,
        )
    except InputError as error:
        raise InputError(f"{path}: {error}" if not str(error).startswith(str(path)) else str(error)) from None
    with_files = {shot.name: shot for shot in campaign.shots if shot.files}
    if not with_files:
        return campaign
    read = _PlacedReader(with_files, sensor, path.parent, Counter(file for shot in campaign.shots for file in shot.files))
    files = {name: shot.files for name, shot in with_files.items()}
    return replace(campaign, captures=FileCaptures(files, read, folder=path.parent))


@dataclass(frozen=True, eq=False)
class _PlacedReader:
    """Reads a frame of a shot onto the campaign's sensor; refused where file and plan disagree."""

    shots: Mapping[str, Shot]
    sensor: Sensor
    folder: Path
    shared: Counter[str]
    recent: dict[tuple[str, str], Capture] = field(default_factory=dict)

    def __call__(self, name: str, file: str) -> Capture:
        from isetval.files.dng import place_on_sensor

        shot, path = self.shots[name], self.folder / file
        capture = self._decoded(file, shot.channel)
        _check_exposure(capture.exposure, shot, path)
        window = shot.window or Window(0, 0, *capture.mosaic.shape)
        whole = capture.mosaic.shape == (self.sensor.rows, self.sensor.cols)
        placed: Capture = place_on_sensor(capture, self.sensor, (0, 0) if whole else window.origin)
        if whole and window.shape != capture.mosaic.shape:  # a shot may look at a part of its files
            row0, col0, rows, cols = window
            part = placed.mosaic[row0 : row0 + rows, col0 : col0 + cols].copy()  # a view would keep the whole frame
            placed = replace(placed, mosaic=part, window=window.origin)
        time_s = placed.exposure.time_s if placed.exposure.time_s is not None else shot.exposure.time_s
        return replace(placed, exposure=replace(placed.exposure, time_s=time_s))

    def _decoded(self, file: str, channel: str) -> Capture:
        """The file; kept for a while where other shots look at other parts of it."""
        from isetval.files.capture_file import read_capture

        if (file, channel) in self.recent:
            return self.recent[file, channel]
        capture = read_capture(self.folder / file, channel=channel or None)
        if self.shared[file] > 1:
            while sum(c.mosaic.size for c in self.recent.values()) + capture.mosaic.size > RECENT_PIXELS and self.recent:
                self.recent.pop(next(iter(self.recent)))
            self.recent[file, channel] = capture
        return capture


def _check_exposure(found: Exposure, shot: Shot, path: Path) -> None:
    for name, unit in (("time_s", "s"), ("iso", "")):
        in_file, in_plan = getattr(found, name), getattr(shot.exposure, name)
        if in_file is not None and in_plan is not None and abs(in_file - in_plan) > 1e-4 * in_plan:
            raise InputError(
                f"{path}: its {name} is {in_file:g} {unit}, campaign.toml says {in_plan:g} for shot {shot.name}; "
                "correct the one that is wrong"
            )


def _camera_file(camera: str, folder: Path) -> Path | None:
    """The model file that a campaign names; ``isetval:NAME`` is an embedded camera."""
    if not camera:
        return None
    return model_path(camera) if camera.startswith(PACKAGE_PREFIX) else named_file(camera, folder)


def _sensor(table: Mapping[str, Any], path: Path, given: CameraModel | None) -> tuple[Sensor | None, str]:
    """The sensor, and the camera model as the file names it (empty where another stands in for it)."""
    camera = text(table, "camera", str(path))
    try:
        file = _camera_file(camera, path.parent)
    except InputError as error:
        if given is None and "sensor" not in table:
            raise InputError(f"{path}: camera: {error}; or state its [sensor] here") from None
        file, camera = None, ""
        if given is not None and "sensor" not in table:
            return given.sensor, ""
    if "sensor" in table:
        return read_sensor(table["sensor"], f"{path}: [sensor]"), camera
    return (None, "") if file is None else (load_model(file).sensor, camera)


def _sensor_of_files(shots: tuple[Shot, ...], path: Path) -> Sensor:
    files = [file for shot in shots for file in shot.files]
    if not files:
        raise InputError(f"{path}: neither camera nor [sensor] nor any file says what the sensor is; name a camera model")
    return _first_readable(files, path).sensor


def _first_readable(files: Sequence[str], path: Path) -> Capture:
    """The first capture that can be read: one broken frame does not lose the others.

    Raises
    ------
    InputError
        The first file's reason, if none can be read.
    """
    from isetval.files.capture_file import read_capture

    reasons = []
    for file in files:
        try:
            capture: Capture = read_capture(path.parent / file)
        except InputError as error:
            reasons.append(error)
        else:
            return capture
    raise reasons[0]


def _tables(table: Mapping[str, Any], key: str, path: Path) -> Mapping[str, Any]:
    value = table.get(key, {})
    if not isinstance(value, dict) or not all(isinstance(entry, dict) for entry in value.values()):
        raise InputError(f"{path}: {key} needs tables with names, as [{key}.sphere]")
    return value


def _light(name: str, entry: Any, path: Path) -> Light:
    where = f"{path}: [light.{name}]"
    entry = check_keys(entry, where, known=("radiance", "column", "scale", "peak_nm", "width_nm", "within_nm", "notes"))
    scale = number(entry, "scale", where, 1.0)
    if "radiance" not in entry:
        return Light(name, _band(entry, where, scale))
    radiance = entry["radiance"]
    if isinstance(radiance, int | float) and not isinstance(radiance, bool):
        return Light(name, Spectrum.flat(float(radiance) * scale))
    file = text(entry, "radiance", where)
    spectra = read_spectra(named_file(file, path.parent))
    column = text(entry, "column", where) or next(iter(spectra))
    if column not in spectra:
        raise InputError(f"{where}: {file} has no column {column!r}; it has {', '.join(spectra)}")
    chosen = spectra[column]
    if "within_nm" in entry:
        low, high = numbers(entry, "within_nm", where, lengths=(2,))
        try:
            chosen = band_limited(chosen, low, high)
        except InputError as error:
            raise InputError(f"{where}: within_nm: {error}") from None
    scaled = Spectrum(chosen.wavelength_nm, chosen.values * scale) if scale != 1 else chosen
    return Light(name, scaled, file=str(named_file(file, path.parent)), column=column)


def _band(entry: Mapping[str, Any], where: str, scale: float) -> Spectrum:
    """A light through a filter: ``peak_nm`` and ``width_nm``."""
    if "peak_nm" not in entry or "width_nm" not in entry:
        raise InputError(f"{where}: radiance is missing; name a table of spectra, or peak_nm and width_nm of a narrow band")
    peak, width = number(entry, "peak_nm", where), number(entry, "width_nm", where)
    if not (peak > 0 and width > 0):
        raise InputError(f"{where}: peak_nm is {peak:g} and width_nm {width:g}; both need to be above 0")
    return narrow_band(peak, width, scale)


def _nuisance(entry: Any, where: str) -> Nuisance:
    entry = check_keys(entry, where, known=_NUISANCE_KEYS, needed=("parameter", "sigma", "scope"))
    try:
        return Nuisance(
            parameter=text(entry, "parameter", where),
            sigma=number(entry, "sigma", where),
            unit=text(entry, "unit", where),
            scope=text(entry, "scope", where),
            distribution=text(entry, "distribution", where, "normal"),
            roles=texts(entry, "roles", where),
            lights=texts(entry, "lights", where),
            setups=texts(entry, "setups", where),
        )
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(where) else f"{where}: {error}") from None


def _shot(entry: Any, where: str, targets: Mapping[str, Target], path: Path) -> Shot:
    entry = check_keys(entry, where, known=_SHOT_KEYS, needed=("role",))
    files = texts(entry, "files", where)
    for file in files:
        if not inside(path.parent, file).is_file():
            raise InputError(f"{where}: names {file}, which is not in {path.parent}; correct the name or put the file there")
    if orphan := [key for key in METRIC_KEYS if key in entry and "metrics" not in entry]:
        raise InputError(f'{where}: {orphan[0]} says how a metrics file is read, and there is none; add metrics = "file.csv"')
    target = text(entry, "target", where)
    if target and target not in targets:
        raise InputError(f"{where}: target {target!r} is not described; the file has: {', '.join(targets) or 'none'}")
    frames = entry.get("frames", max(1, len(files)))
    if not isinstance(frames, int) or isinstance(frames, bool) or not 1 <= frames <= MOST_FRAMES:
        raise InputError(f"{where}: frames is {frames!r}; a shot has 1 to {MOST_FRAMES} frames")
    if files and frames != len(files):
        raise InputError(f"{where}: frames is {frames!r} and it names {len(files)} files; they must agree")
    name = text(entry, "name", where) or text(entry, "setup", where) or text(entry, "role", where)
    try:
        return Shot(
            name=name,
            role=text(entry, "role", where),
            setup=text(entry, "setup", where) or name,
            measurement_session=text(entry, "measurement_session", where, "A"),
            exposure=Exposure(
                _optional(entry, "exposure_s", where), _optional(entry, "iso", where), focus_m=_distance(entry, "focus_m", where)
            ),
            frames=frames,
            light=text(entry, "light", where) or None,
            light_level=number(entry, "light_level", where, 1.0),
            rotation_deg=number(entry, "rotation_deg", where, 0.0),
            window=_window(entry, where),
            target=targets[target] if target else None,
            focus_um=number(entry, "focus_um", where, 0.0),
            distance_m=_distance(entry, "distance_m", where),
            repeat_of=text(entry, "repeat_of", where) or None,
            files=files,
            method="" if "metrics" in entry else text(entry, "method", where),
            channel="" if "metrics" in entry else text(entry, "channel", where),
            photons_per_pixel=_optional(entry, "photons_per_pixel", where),
            levels_only=_yes_or_no(entry, "levels_only", where),
        )
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(where) else f"{where}: {error}") from None


def _yes_or_no(entry: Mapping[str, Any], key: str, where: str) -> bool:
    value = entry.get(key, False)
    if not isinstance(value, bool):
        raise InputError(f"{where}: {key} is {value!r}; it needs true or false")
    return value


def _given(entry: Mapping[str, Any], where: str, sensor: Sensor, path: Path) -> GivenMetrics:
    """The metrics that a shot's file states."""
    edge = entry.get("edge")
    if edge is not None and (not isinstance(edge, int) or isinstance(edge, bool)):
        raise InputError(f"{where}: edge is {edge!r}; it needs a whole number from 1")
    how = Reading(
        metric=text(entry, "metric", where),
        column=text(entry, "column", where),
        sigma=_optional(entry, "sigma", where),
        channel=text(entry, "channel", where),
        edge=edge,
        method=text(entry, "method", where),
        correlation_length=number(entry, "correlation_length", where, 0.0),
        covariance=text(entry, "covariance", where),
    )
    try:
        return read_metrics(path.parent, text(entry, "metrics", where), sensor, how)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _told_apart(shots: tuple[Shot, ...], entries: Sequence[Mapping[str, Any]]) -> tuple[Shot, ...]:
    """Shots that the file gives no name are called by their set-up, numbered where that is not enough."""
    given = {shot.name for shot, entry in zip(shots, entries, strict=True) if "name" in entry}
    counts = Counter(shot.name for shot in shots)
    out = []
    for place, (shot, entry) in enumerate(zip(shots, entries, strict=True), 1):
        alone = counts[shot.name] == 1 and shot.name not in given
        own = shot if "name" in entry or alone else replace(shot, name=f"{shot.name}_{place}")
        out.append(own if "setup" in entry else replace(own, setup=own.name))  # nothing said: a set-up of its own
    return tuple(out)


def _found_repeats(shots: tuple[Shot, ...]) -> tuple[Shot, ...]:
    """``repeat_of`` may name a shot or a set-up: of a set-up, the shot of the same role, exposure, window and light level."""
    names = {shot.name for shot in shots}

    def twin(shot: Shot) -> str | None:
        if shot.repeat_of is None or shot.repeat_of in names:
            return shot.repeat_of
        same = (shot.role, shot.exposure, shot.window, shot.light_level, shot.focus_um)
        for other in shots:
            if (
                other.setup == shot.repeat_of
                and (other.role, other.exposure, other.window, other.light_level, other.focus_um) == same
            ):
                return other.name
        return shot.repeat_of

    return tuple(replace(shot, repeat_of=twin(shot)) for shot in shots)


def _distance(entry: Mapping[str, Any], key: str, where: str) -> float | None:
    """A distance in metres; ``inf`` is far away."""
    value = _optional(entry, key, where)
    if value is not None and not value > 0:
        raise InputError(f"{where}: {key} is {value:g}; it needs a distance in metres above 0, or inf")
    return value


def _optional(entry: Mapping[str, Any], key: str, where: str) -> float | None:
    return number(entry, key, where) if key in entry else None


def _window(entry: Mapping[str, Any], where: str) -> Window | None:
    if "window" not in entry and "size" not in entry:
        return None
    window = numbers(entry, "window", where, lengths=(2, 4)) if "window" in entry else (0.0, 0.0)
    size = numbers(entry, "size", where, lengths=(2,)) if "size" in entry else window[2:] or (0.0, 0.0)
    return Window.of([int(v) for v in (*window[:2], *size)])


def _sized(shot: Shot, sensor: Sensor, path: Path) -> Shot:
    """The shot with a full window: from the plan, else from its first file, else the whole sensor."""
    window = shot.window
    if window is not None and window[2] > 0:
        pass
    elif shot.files:
        first = _first_readable(shot.files, path)
        window = Window(*(window[:2] if window else first.window), *first.mosaic.shape)
    elif window is None:
        window = Window(0, 0, sensor.rows, sensor.cols)
    else:
        raise InputError(
            f"shot {shot.name}: window {list(window[:2])} has no size and there are no files to take it from; add size"
        )
    if not window.fits((sensor.rows, sensor.cols)):
        raise InputError(f"shot {shot.name}: window {list(window)} leaves the sensor of {sensor.rows} x {sensor.cols} pixels")
    return replace(shot, window=window)
