"""``campaign init`` on a folder with an EMVA 1288 descriptor: its series as a campaign.toml that can be edited."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from isetval.camera.model_file import load_model
from isetval.core.campaign import Campaign
from isetval.core.errors import InputError
from isetval.core.toml import resolve_path
from isetval.core.writing import write_whole
from isetval.files.campaign_writer import write_tables
from isetval.files.emva_descriptor import load_emva_descriptor
from isetval.files.sidecar import FOLDER_NAMES


def write_emva_campaign(descriptor: Path, *, camera: str = "") -> tuple[Path, Campaign]:
    """Write ``campaign.toml`` and, for what the pictures do not say, ``images.toml`` beside a descriptor.

    Parameters
    ----------
    descriptor : path
    camera : str, optional
        A camera model, for its pixel pitch.

    Returns
    -------
    path, campaign
        The file, and the campaign that it holds.

    Raises
    ------
    InputError
        If one of the two or a folder ``spectra`` exists, or the descriptor is refused.
    """
    folder = descriptor.parent
    path, sidecar = folder / "campaign.toml", folder / FOLDER_NAMES[0]
    for file in (path, sidecar, folder / "spectra"):
        if file.exists():
            raise InputError(f"{file}: exists already; rename it first (nothing was written)")
    model = load_model(resolve_path(camera, Path())) if camera else None
    campaign = load_emva_descriptor(descriptor, **({} if model is None else {"pixel_um": model.sensor.pixel_um}))
    sensor = campaign.sensor
    if sensor is None:
        raise InputError(f"{descriptor}: states no sensor; add a line 'n bits columns rows'")
    said = (
        f"# What the pictures of {descriptor.name} do not say; its black level is the mean of the shortest darks.\n"
        f'cfa = "MONO"\nblack_dn = {sensor.black_dn[0][0]!r}\nbits = {sensor.bits}\npixel_um = {sensor.pixel_um!r}\n'
    )
    remarks = [f"Drafted by `isetval campaign init` from {descriptor.name}.", *(f"CHECK: {note}" for note in campaign.notes)]
    plain = replace(campaign, provenance={})
    write_tables(plain, folder, {shot.name: shot.files for shot in campaign.shots}, remarks)
    write_whole(sidecar, said)
    return path, campaign
