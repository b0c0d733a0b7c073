"""Ray-space imaging: every ray of the film is traced through the lens into the scene by Mitsuba."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from isetval.scenes.rendered.accumulation import Crop, Irradiance, NoiseTarget, Progress
from isetval.scenes.rendered.lens_tables import lens_tables
from isetval.scenes.rendered.lens_view import LensView
from isetval.scenes.rendered.rendering import Job, check_camera, check_crop
from isetval.scenes.rendered.variants import choose_variant


def ray_space_irradiance(
    spec: Mapping[str, Any],
    view: LensView,
    *,
    camera: Mapping[str, Any],
    crop: Crop | None = None,
    wavelength_nm: ArrayLike = (),
    spp: int = 256,
    seed: int = 0,
    noise_target: float | NoiseTarget | None = None,
    light_factor: float = 1.0,
    variant: str | None = "auto",
    cache: bool = True,
    progress: Progress | None = None,
) -> Irradiance:
    """Spectral irradiance of a sensor crop through a ray-transfer lens.

    Parameters
    ----------
    spec : mapping
        A scene, see `isetval.scenes.rendered.rendering.render`.
    view : LensView
        The lens at a film distance.
    camera : mapping
        The sensor and the pose of the entrance pupil; an aperture in it is ignored.
    crop, wavelength_nm, spp, seed, noise_target, cache, progress
        As in `isetval.scenes.rendered.rendering.render`.
    light_factor : float
        Named factor on the light (3.96 or 3.54 for a lens file that holds half the pupil); the blur stays as it is.
    variant : str
        ``"auto"`` takes CUDA or LLVM where the probe passes.  ``"scalar_spectral"`` gives the same means at about a
        hundredth of the speed: for small regions.

    Returns
    -------
    Irradiance
        No diffraction and no transmission.  ``settings["beyond_table"]`` is the share of pixels beyond the lens's table,
        where its last pass region is held.

    Raises
    ------
    InputError, MissingPartError
        As `isetval.scenes.rendered.rendering.render`.
    """
    camera = check_camera(camera)
    camera["aperture_radius_mm"] = 0.0
    crop = check_crop(crop, camera)
    reach = math.hypot(camera["rows"], camera["cols"]) / 2 * camera["pixel_um"] * 1e-3
    tables = lens_tables(view, reach_mm=1.001 * reach, light_factor=light_factor)
    job = Job(
        spec,
        camera,
        wavelength_nm=wavelength_nm,
        spp=spp,
        seed=seed,
        target=noise_target,
        choice=choose_variant(variant),
        keep=cache,
        progress=progress,
        lens=tables,
    )
    mean, variance, _, _, settings = job.run(crop)
    lens = {
        "path": "ray space",
        "lens": view.lens.name,
        "film_mm": view.film_mm,
        "light_factor": light_factor,
        "beyond_table": _beyond(view, camera, crop),
    }
    return Irradiance(mean, variance, job.bands, crop, settings | lens)


def _beyond(view: LensView, camera: Mapping[str, Any], crop: Crop) -> float:
    row = crop[0] + np.arange(crop[2]) + 0.5 - camera["rows"] / 2
    col = crop[1] + np.arange(crop[3]) + 0.5 - camera["cols"] / 2
    r_mm = np.hypot(row[:, None], col) * camera["pixel_um"] * 1e-3
    return float(np.mean(r_mm > view.lens.table(None).region.last_position_mm))
