"""``campaign init`` on a folder with an EMVA 1288 descriptor: its series as a campaign.toml, and a camera from their numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from isetval.camera.model_file import load_model
from isetval.core.campaign import Campaign
from isetval.core.errors import InputError
from isetval.core.toml import resolve_path
from isetval.core.writing import write_whole
from isetval.files.campaign_writer import write_tables
from isetval.files.emva_camera import emva_camera
from isetval.files.emva_descriptor import UNKNOWN_PITCH_UM, load_emva_descriptor
from isetval.files.emva_estimates import PARTS, camera_numbers, dealt, looking_at_the_middle, priors
from isetval.files.sidecar import FOLDER_NAMES

CAMERA = "camera.toml"


def write_emva_campaign(descriptor: Path, *, camera: str = "") -> tuple[Path, Campaign]:
    """Write beside a descriptor ``campaign.toml``, its parts, ``images.toml`` for what the pictures lack, and ``camera.toml``.

    Parameters
    ----------
    descriptor : path
    camera : str, optional
        A camera model, for its pixel pitch; none is drafted then.

    Returns
    -------
    path, campaign
        The file, and the campaign that it holds; its notes tell what was assumed, and how the camera was drafted or why not.

    Raises
    ------
    InputError
        If one of them or a folder ``spectra`` exists, or the descriptor is refused.
    """
    folder = descriptor.parent
    path, sidecar = folder / "campaign.toml", folder / FOLDER_NAMES[0]
    parts = [folder / part_name(part) for part in PARTS]
    for file in (path, *parts, sidecar, folder / "spectra", *([] if camera else [folder / CAMERA, folder / "qe.csv"])):
        if file.exists():
            raise InputError(f"{file}: exists already; rename it first (nothing was written)")
    own = load_model(resolve_path(camera, Path())).sensor if camera else None
    pixel_um, cfa = (UNKNOWN_PITCH_UM, "MONO") if own is None else (own.pixel_um, own.cfa)
    campaign = load_emva_descriptor(descriptor, pixel_um=pixel_um, cfa=cfa)
    sensor = campaign.sensor
    if sensor is None:
        raise InputError(f"{descriptor}: states no sensor; add a line 'n bits columns rows'")
    said = (
        f"# What the pictures of {descriptor.name} do not say; its black level is the mean of the shortest darks.\n"
        f'cfa = "{sensor.cfa}"\nblack_dn = {sensor.black_dn[0][0]!r}\nbits = {sensor.bits}\npixel_um = {sensor.pixel_um!r}\n'
    )
    nuisances, reasons = priors(campaign)
    campaign = replace(campaign, nuisances=nuisances)
    parted = dealt(campaign)
    drafted = "" if camera else _drafted_camera(parted[PARTS[0]], folder, descriptor.name)
    notes = (*campaign.notes, *reasons, *([drafted] if drafted else []))
    campaign = replace(campaign, notes=notes)
    _write(campaign, folder, path.name, [f"Drafted by `isetval campaign init` from {descriptor.name}.", *_checks(notes)])
    for part, shots in parted.items():
        looking, window = looking_at_the_middle(shots)
        remarks = [
            f"The part of campaign.toml to {part} on: {len(shots.shots)} of {len(campaign.shots)} series.",
            *_checks([window]),
        ]
        _write(replace(looking, name=part_title(campaign, part)), folder, part_name(part), remarks)
    write_whole(sidecar, said)
    return path, campaign


def part_title(campaign: Campaign, part: str) -> str:
    """The name of the campaign of one of `PARTS`."""
    return f"{campaign.name}, {part}"


def part_name(part: str) -> str:
    """The file of one of `PARTS`."""
    return f"campaign_{part}.toml"


def _checks(notes: Sequence[str]) -> list[str]:
    return [f"CHECK: {note}" for note in notes if note]


def _write(campaign: Campaign, folder: Path, name: str, remarks: Sequence[str]) -> None:
    files = {shot.name: shot.files for shot in campaign.shots}
    write_tables(replace(campaign, provenance={}), folder, files, remarks, name=name)


def _drafted_camera(campaign: Campaign, folder: Path, name: str) -> str:
    """Write the linear model with the numbers of the part to learn on, and the sentence that says so, or why there is none."""
    assert campaign.sensor is not None
    source = f"estimated: EMVA 1288 by isetval on the part 'learn' of {name}"
    try:
        found = camera_numbers(campaign)
        own, lacking = (part_title(campaign, PARTS[0]),), f"{name} gives none"
        model = emva_camera(campaign.name, campaign.sensor, found, folder, said=source, lacking=lacking, fitted_to=own)
    except InputError as error:
        return f"no camera model was drafted: {error}; give one with --camera"
    model.save(folder / CAMERA)
    numbers = ", ".join(f"{key} {value:.4g}" for key, value in found.items())
    return f"{CAMERA}: the linear model of the standard with numbers estimated on the part 'learn' ({numbers})"
