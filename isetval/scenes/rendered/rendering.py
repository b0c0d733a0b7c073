"""``render``: a scene, a camera and a crop in; spectral radiance, its variance and depth out."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import asdict
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isetval.core import cache as store
from isetval.core.cache import content_hash
from isetval.core.engine import Engine
from isetval.core.errors import InputError
from isetval.scenes.rendered.accumulation import DRAWS, Crop, NoiseTarget, PassPlan, Progress, Render, Running, run_passes
from isetval.scenes.rendered.lens_tables import LensTables
from isetval.scenes.rendered.spectra import band_feet_nm
from isetval.scenes.rendered.variants import VariantChoice, choose_variant, mitsuba_version

TILE_PX = 256
CACHE_BYTES = 4_000_000_000
PATHS_PER_PASS = 4_000_000
CAMERA_KEYS = ("position_m", "look_at_m", "up", "focal_mm", "pixel_um", "rows", "cols")


def render(
    spec: Mapping[str, Any],
    *,
    camera: Mapping[str, Any],
    crop: Crop | None = None,
    wavelength_nm: ArrayLike = (),
    spp: int = 64,
    seed: int = 0,
    noise_target: float | NoiseTarget | None = None,
    variant: str | None = None,
    cache: bool = True,
    progress: Progress | None = None,
) -> Render:
    """Spectral radiance and depth of a scene as the entrance pupil of a camera sees it.

    Parameters
    ----------
    spec : mapping
        A scene as a plain dictionary, for instance from :func:`isetval.scenes.rendered.box.cornell_box`.
    camera : mapping
        ``position_m`` (of the entrance pupil), ``look_at_m``, ``up``, ``focal_mm`` (distance of the image plane),
        ``pixel_um``, ``rows``, ``cols`` of the full sensor; ``aperture_radius_mm`` and ``focus_m`` for a thin lens
        (default: a pinhole).  The picture stands upright: row 0 sees what is up, column 0 what is left.
        A lens throws the inverted picture on the chip; that the chip is read out turned by 180 degrees is part of
        this convention, as it is of raw files.
    crop : (row0, col0, rows, cols), optional
        On the full sensor grid, at its own sampling; the whole sensor by default.
    wavelength_nm : array (bands,)
        Centers of the triangular bands, rising, two or more.
    spp : int
        Samples for each pixel (with a noise target: at most).  They are split into passes.
    seed : int
        Gives the same bits anew with the scalar variant, with others the same radiance to about 1e-6 of it.
    noise_target : float or NoiseTarget, optional
        Stop earlier: a float is the wanted relative standard error of the mean radiance.
    variant : str, optional
        See :func:`isetval.scenes.rendered.variants.choose_variant`.
    cache : bool
        Keep passes in the cache folder: a killed render resumes and a repeated one costs nothing.
    progress : callable, optional
        ``progress(done, total, words)`` after every pass.

    Returns
    -------
    Render

    Raises
    ------
    InputError
        For an impossible camera, crop, band or scene.
    MissingPartError
        For a variant that does not work here.
    """
    choice = choose_variant(variant)
    job = Job(
        spec,
        camera,
        wavelength_nm=wavelength_nm,
        spp=spp,
        seed=seed,
        target=noise_target,
        choice=choice,
        keep=cache,
        progress=progress,
    )
    radiance, variance, depth, draws, settings = job.run(crop)
    assert depth is not None
    return Render(radiance, variance, depth, job.bands, settings["crop"], settings, draws)


class Job:
    """What the tiles of one render share; with ``lens`` the rays go through it and there is no depth."""

    def __init__(
        self,
        spec: Mapping[str, Any],
        camera: Mapping[str, Any],
        *,
        wavelength_nm: ArrayLike,
        spp: int,
        seed: int,
        target: float | NoiseTarget | None,
        choice: VariantChoice,
        keep: bool,
        progress: Progress | None,
        lens: LensTables | None = None,
    ) -> None:
        if spp < 2:
            raise InputError(f"spp is {spp}; a render needs 2 or more, its variance is measured between passes")
        self.spec, self.camera = spec, check_camera(camera)
        self.bands = np.asarray(wavelength_nm, float)
        band_feet_nm(self.bands)
        self.target = NoiseTarget(relative_sd=float(target)) if isinstance(target, float | int) else target
        self.spp, self.seed, self.choice, self.lens = int(spp), int(seed), choice, lens
        self.keep, self.progress, self.tiles = keep, progress, 1
        self.content = scene_content(spec, self.camera) | ({} if lens is None else {"lens": asdict(lens)})

    def run(self, crop: Crop | None) -> tuple[Any, Any, NDArray[np.float32] | None, Any, dict[str, Any]]:
        """Mean and variance (bands, rows, cols), depth (rows, cols) or None, draws (draws, bands, rows, cols), settings."""
        begun = time.perf_counter()
        crop = check_crop(crop, self.camera)
        tiles = split_tiles(crop, TILE_PX)
        self.tiles = len(tiles)
        mean, variance = (np.empty((len(self.bands), *crop[2:]), np.float32) for _ in range(2))
        draws = np.empty((DRAWS, *mean.shape), np.float32)
        depth = np.empty(crop[2:], np.float32) if self.lens is None else None
        reports = []
        for index, tile in enumerate(tiles):
            running, tile_depth, report = self.render_tile(index, tile)
            rows, cols = (slice(tile[i] - crop[i], tile[i] - crop[i] + tile[i + 2]) for i in (0, 1))
            mean[:, rows, cols], variance[:, rows, cols] = running.mean, running.variance_of_mean
            draws[:, :, rows, cols] = running.draws
            if depth is not None:
                depth[rows, cols] = tile_depth
            reports.append(report)
        if self.keep:
            store.prune(store.cache_folder() / "renders", max_bytes=CACHE_BYTES)
        done = {"crop": crop, "tiles": reports, "seconds": time.perf_counter() - begun}
        return mean, variance, depth, draws, self.settings() | done

    def settings(self) -> dict[str, Any]:
        """What it takes to render this again."""
        return {
            "scene": self.spec.get("name", ""),
            "scene_key": content_hash(self.content),
            "camera": dict(self.camera),
            "wavelength_nm": self.bands.tolist(),
            "spp_wanted": self.spp,
            "seed": self.seed,
            "variant": self.choice.variant,
            "library": self.choice.library,
            "variant_reason": self.choice.reason,
            "mitsuba": mitsuba_version(),
        }

    def _key(self, plan: PassPlan) -> str:
        return content_hash(
            {
                "format": "isetval-render-3",
                "content": self.content,
                "bands": self.bands,
                "tile": plan.tile,
                "passes": plan.passes,
                "spp_per_pass": plan.spp_per_pass,
                "seed": plan.seed,
                "target": None if plan.target is None else vars(plan.target),
                "variant": self.choice.variant,
                "mitsuba": mitsuba_version(),
            }
        )

    def render_tile(self, index: int, tile: Crop) -> tuple[Running, NDArray[np.float64] | None, dict[str, Any]]:
        """Mean and variance of one tile, its depth, and what was done."""
        passes, spp_per_pass = split_passes(self.spp, tile[2] * tile[3])
        plan = PassPlan(tile, passes, spp_per_pass, self.seed, self.target)
        folder = store.cache_folder() / "renders" / self._key(plan) if self.keep else None
        lazy = _LazyTile.of(self, tile)

        def report(done: int, noise: float) -> None:
            if self.progress is not None:
                words = f"tile {index + 1} of {self.tiles}, pass {done} of {passes}, {done * spp_per_pass} samples a pixel"
                self.progress(
                    index * passes + done, self.tiles * passes, words + (f", noise {noise:.3g}" if noise == noise else "")
                )

        running, noise = run_passes(
            plan, lazy.radiance, bands=len(self.bands), folder=folder, progress=report, engine=_ENGINE.get()
        )
        depth = None if self.lens else _cached_depth(folder, tile, lazy)
        done = {"tile": list(tile), "passes": running.count, "spp": running.count * spp_per_pass, "noise": noise}
        return running, depth, done


class _LazyTile:
    """Loads the scene only when a pass is really needed; in another process a copy does, once for all of its passes."""

    def __init__(self, key: str, made_of: Mapping[str, Any]) -> None:
        self._key, self._made_of = key, made_of
        self._loaded: Any = None

    @classmethod
    def of(cls, job: Job, tile: Crop) -> _LazyTile:
        """A tile of a job."""
        made_of = {
            "spec": job.spec,
            "camera": job.camera,
            "crop": tile,
            "wavelength_nm": job.bands.tolist(),
            "variant": job.choice.variant,
            "library": job.choice.library,
            "lens": job.lens,
        }
        return cls(content_hash((job.content, job.bands, tile, job.choice.variant)), made_of)

    def __reduce__(self) -> Any:
        return _held, (self._key, self._made_of)

    def _scene(self) -> Any:
        from isetval.scenes.rendered.mitsuba_backend import Tile

        if self._loaded is None:
            self._loaded = Tile(**self._made_of)
        return self._loaded

    def radiance(self, seed: int, spp: int) -> NDArray[np.float64]:
        with _RENDERING:
            return np.asarray(self._scene().radiance(seed, spp))

    def depth_m(self) -> NDArray[np.float64]:
        return np.asarray(self._scene().depth_m())


_RENDERING = Lock()  # a cluster's worker may have several threads; the renderer uses all cores by itself
_HELD: dict[str, _LazyTile] = {}


def _held(key: str, made_of: Mapping[str, Any]) -> _LazyTile:
    """The tile that this process rendered last, or a new one in its place."""
    if key not in _HELD:
        _HELD.clear()
        _HELD[key] = _LazyTile(key, made_of)
    return _HELD[key]


_ENGINE: ContextVar[Engine | None] = ContextVar("engine of render passes", default=None)


@contextmanager
def passes_on(engine: Engine) -> Iterator[None]:
    """Within the block the passes of every render are drawn on ``engine``; the bits are those of one process (scalar variant)."""
    before = _ENGINE.set(engine)
    try:
        yield
    finally:
        _ENGINE.reset(before)


def _cached_depth(folder: Path | None, tile: Crop, lazy: _LazyTile) -> NDArray[np.float64]:
    known = store.load_arrays(folder / "depth.npz") if folder is not None else None
    if known and "depth_m" in known and known["depth_m"].shape == (tile[2], tile[3]):
        return np.asarray(known["depth_m"])
    depth = lazy.depth_m()
    if folder is not None:
        store.save_arrays(folder / "depth.npz", {"depth_m": depth})
    return depth


SURROUND = 2  # of how light from outside is rendered; at 1 it passed through the far walls of a box


def scene_content(spec: Mapping[str, Any], camera: Mapping[str, Any]) -> dict[str, Any]:
    """What a render depends on: shapes, spectra and camera; not names, targets or where a mesh file lies."""
    shapes = [{k: v for k, v in s.items() if k != "name" and not (k == "file" and "sha256" in s)} for s in spec["shapes"]]
    spectra = {n: {"wavelength_nm": s["wavelength_nm"], "values": s["values"]} for n, s in spec["spectra"].items()}
    return {
        "shapes": shapes,
        "spectra": spectra,
        "environment": [spec["environment"], SURROUND] if spec.get("environment") else None,
        "bounces": spec["bounces"],
        "camera": dict(camera),
    }


def check_camera(camera: Mapping[str, Any]) -> dict[str, Any]:
    """The camera with defaults filled in.

    Raises
    ------
    InputError
        Names the entry that is missing or impossible.
    """
    missing = [key for key in CAMERA_KEYS if key not in camera and key != "up"]
    if missing:
        raise InputError(f"the camera lacks {', '.join(missing)}; it needs {', '.join(CAMERA_KEYS)}")
    known = {*CAMERA_KEYS, "aperture_radius_mm", "focus_m"}
    unknown = sorted(set(camera) - known)
    if unknown:
        raise InputError(f"the camera holds {', '.join(unknown)}; it may hold {', '.join(sorted(known))}")
    out = {"up": [0.0, 1.0, 0.0], "aperture_radius_mm": 0.0, **camera}
    for key in ("focal_mm", "pixel_um", "rows", "cols"):
        if not out[key] > 0:
            raise InputError(f"camera {key} is {out[key]}; it needs a positive number")
    for key in ("position_m", "look_at_m", "up"):
        out[key] = [float(v) for v in out[key]]
        if len(out[key]) != 3 or not np.all(np.isfinite(out[key])):
            raise InputError(f"camera {key} is {out[key]}; it needs three finite numbers")
    axis = np.subtract(out["look_at_m"], out["position_m"])
    if not np.linalg.norm(np.cross(axis, out["up"])) > 1e-9:
        raise InputError("the camera looks at its own position or along its up direction; move look_at_m or up")
    if out["aperture_radius_mm"] > 0 and not out.get("focus_m", 0) > 0:
        raise InputError("a camera with an aperture needs focus_m, the distance in metres that is sharp")
    return out


def check_crop(crop: Sequence[int] | None, camera: Mapping[str, Any]) -> Crop:
    """``crop`` as (row0, col0, rows, cols) inside the camera's sensor; None is the whole sensor."""
    rows, cols = int(camera["rows"]), int(camera["cols"])
    if crop is None:
        return (0, 0, rows, cols)
    row0, col0, height, width = (int(v) for v in crop)
    if not (row0 >= 0 and col0 >= 0 and height > 0 and width > 0 and row0 + height <= rows and col0 + width <= cols):
        raise InputError(
            f"crop {(row0, col0, height, width)} (row0, col0, rows, cols) leaves the sensor of {rows} x {cols} pixels"
        )
    return (row0, col0, height, width)


def split_tiles(crop: Crop, size_px: int) -> tuple[Crop, ...]:
    """The crop cut into tiles of at most ``size_px`` squared; memory and resume work tile by tile."""
    row0, col0, rows, cols = crop
    return tuple(
        (r, c, min(size_px, row0 + rows - r), min(size_px, col0 + cols - c))
        for r in range(row0, row0 + rows, size_px)
        for c in range(col0, col0 + cols, size_px)
    )


def split_passes(spp: int, pixels: int) -> tuple[int, int]:
    """(passes, samples in each): 16 passes where the samples allow, more where a pass would grow too large.

    The samples of a pass are raised to a full grid (rows of floor(sqrt)), which is what the stratified sampler draws.
    """
    passes = max(2, min(16, spp // 2))
    passes = max(passes, -(-spp * pixels // PATHS_PER_PASS))
    each = -(-spp // passes)
    side = math.isqrt(each)
    return passes, side * -(-each // side)
