"""Campaign folders: ``campaign.toml`` beside its DNG files, read strictly and without loading them all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from isetval.camera.model import CameraModel
from isetval.camera.model_file import load_model, model_path, read_sensor
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.scene import Spectrum, band_limited, narrow_band, read_spectra
from isetval.core.sensor import Exposure, Sensor, Window
from isetval.core.toml import PACKAGE_PREFIX, check_keys, named_file, number, numbers, read_toml, tables, text, texts
from isetval.files.campaign_shots import first_readable, read_given, read_shots, sized
from isetval.files.captures import FileCaptures
from isetval.files.emva_descriptor import load_emva_descriptor
from isetval.files.emva_lines import find_emva_descriptor
from isetval.files.target_file import read_target

RECENT_PIXELS = 100_000_000  # 200 MB: eight frames of 12 MP, the files of a shot that is looked at in parts
_KEYS = ("name", "camera", "sensor", "nuisance", "light", "target", "shot", "notes")
_NUISANCE_KEYS = ("parameter", "sigma", "unit", "scope", "distribution", "roles", "lights", "setups", "notes")


def load_campaign(path: Path | str, *, camera: CameraModel | None = None, as_plan: bool = False) -> Campaign:
    """Read a campaign or a plan: a folder with ``campaign.toml`` or an EMVA 1288 descriptor, or one of these files itself.

    The DNG files are opened when their shot is measured; that they exist is checked here.

    Parameters
    ----------
    path : path
    camera : CameraModel, optional
        Stands in for a camera that the file names outside its folder, which is not opened.
    as_plan : bool
        Without its captures, which then need not be there (those of a descriptor are asked for).

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
            if camera is None:
                return load_emva_descriptor(descriptor)
            return load_emva_descriptor(descriptor, pixel_um=camera.sensor.pixel_um, cfa=camera.sensor.cfa)
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
    shots = read_shots(table["shot"], targets, path, files_needed=not as_plan)
    sensor = sensor or _sensor_of_files(shots, path)
    where = f"{path}: [[shot]] number"
    shots = tuple(
        replace(shot, given=read_given(entry, f"{where} {i}", sensor, path)) if "metrics" in entry else shot
        for i, (shot, entry) in enumerate(zip(shots, table["shot"], strict=True), 1)
    )
    try:
        campaign = Campaign(
            name=text(table, "name", str(path), path.parent.name),
            shots=tuple(sized(shot, sensor, path) for shot in shots),
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
    if as_plan or not with_files:
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


def camera_file(camera: str, folder: Path) -> Path | None:
    """The model file that a campaign names, in its folder; ``isetval:NAME`` is an embedded camera; None where it names none."""
    if not camera:
        return None
    return model_path(camera) if camera.startswith(PACKAGE_PREFIX) else named_file(camera, folder)


def _sensor(table: Mapping[str, Any], path: Path, given: CameraModel | None) -> tuple[Sensor | None, str]:
    """The sensor, and the camera model as the file names it (empty where another stands in for it)."""
    camera = text(table, "camera", str(path))
    try:
        file = camera_file(camera, path.parent)
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
    return first_readable(files, path).sensor


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
