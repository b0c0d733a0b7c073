"""Any file that describes a lens: ray-transfer JSON, prescription TOML, or a measured table CSV."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from isetval.core.cache import cache_folder, content_hash, remembered_file_hash, save_json
from isetval.core.errors import InputError
from isetval.lens.measured_lens import MeasuredLens, read_measured_lens
from isetval.lens.prescription import Prescription
from isetval.lens.prescription_rays import ray_transfer
from isetval.lens.ray_transfer import RayTransferLens
from isetval.lens.transfer_file import load_lens
from isetval.lens.transfer_writer import to_json

FORMAT = 1
FITTED_NM = (450.0, 500.0, 550.0, 600.0, 650.0)  # of a prescription: as the default lens; color is smooth in between


def open_lens(path: Path | str, *, reach_mm: float) -> RayTransferLens | MeasuredLens:
    """The lens of a file, by its suffix: ``.json``, ``.toml`` or ``.csv``.

    Parameters
    ----------
    reach_mm : float
        Field height up to which a prescription is fitted by a ray-transfer function (kept in the cache folder).

    Raises
    ------
    InputError
        For another suffix, or a file that cannot be read as what its suffix says.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"lens file {path}: does not exist; correct the path")
    return _opened(str(path), remembered_file_hash(path), round(reach_mm, 3))


@lru_cache(maxsize=8)
def _opened(path: str, sha256: str, reach_mm: float) -> RayTransferLens | MeasuredLens:
    """The lens of a file with this content."""
    suffix = Path(path).suffix.lower()
    if suffix == ".json":
        return load_lens(path)
    if suffix == ".csv":
        return read_measured_lens(path)
    if suffix == ".toml":
        return _fitted(path, sha256, reach_mm)
    raise InputError(
        f"lens file {path}: suffix {suffix or 'none'}; it needs .json (ray transfer), .toml (prescription) or .csv (table)"
    )


def _fitted(path: str, sha256: str, reach_mm: float) -> RayTransferLens:
    """The ray-transfer lens of a prescription; the fit of a quarter of a minute is kept."""
    kept = cache_folder() / "lens" / f"{content_hash((FORMAT, sha256, reach_mm, FITTED_NM))[:32]}.json"
    if kept.is_file():
        return load_lens(kept)
    lens, _ = ray_transfer(Prescription.load(path), sensor_radius_mm=reach_mm, wavelengths_nm=FITTED_NM)
    save_json(kept, to_json(lens))
    return lens
