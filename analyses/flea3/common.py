"""Where the pictures are, what their files do not say, and the folder of work that `isetval campaign init` makes of them."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import isetval
from isetval.app.cli import main as isetval_command
from isetval.core.campaign import Campaign
from isetval.files.chart_parts import PARTS

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data" / "real" / "flea3"
MODEL = ROOT / "data" / "flea3" / "camera.toml"
Float = NDArray[np.float64]
SIDECAR = r"""# What the README of the pictures says of all of them
cfa = "GBRG"
black_dn = 0
white_dn = 255
bits = 8
pixel_um = 3.45
name_rule = '(?P<visit>d\d)_(?P<scene>[A-Za-z0-9]+?)_(?:(?P<wavelength_nm>\d+)nm_)?(?P<exposure_ms>\d+)ms_'

[[image]]                      # true crops of the mosaic
match = "d1_*.tif"
window = [1364, 1632]
sensor = [2048, 2448]

[[image]]                      # demosaiced, shrunk to a sixth, mosaicked again
match = "d2_*.tif"
pixel_um = 20.7
levels_only = true
"""


@dataclass(frozen=True)
class Laboratory:
    """The folder of work and its campaigns: charts (second visit, shrunk) and disks (first visit, true pixels)."""

    folder: Path
    charts: Campaign
    disks: Campaign


def laboratory(data: Path, folder: Path) -> Laboratory:
    """Copy the pictures beside a sidecar and let ``campaign init`` draft both; a folder made before is taken as it is."""
    work = folder / "lab"
    if not (work / "campaign.toml").is_file():
        shutil.copytree(data, work, dirs_exist_ok=True, copy_function=shutil.copyfile)
        (work / "sidecar.toml").write_text(SIDECAR)
        for name in ("camera.toml", "qe.csv"):
            shutil.copyfile(MODEL.parent / name, work / name)
        if isetval_command(["campaign", "init", str(work), "--camera", "camera.toml", "-q"]) != 0:
            raise SystemExit(f"{work}: campaign init refused the folder; its sentence stands above")
    whole = [path for path in sorted(work.glob("campaign*.toml")) if not path.stem.endswith(PARTS)]
    parts = [isetval.load_campaign(path) for path in whole]
    by_kind = {any(shot.levels_only for shot in part.shots): part for part in parts}
    return Laboratory(work, by_kind[True], by_kind[False])


def wavelength(light: str) -> float:
    """The wavelength that names a light, nm."""
    return float(light.removesuffix("nm"))
