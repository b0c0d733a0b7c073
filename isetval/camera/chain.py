"""Running a model's chain on one shot: mean electrons behind the colour filters, then the electronics.

Everything in front of the electronics is deterministic and is computed once per shot content; the
electronics run frame by frame in blocks of rows of the full-sensor grid, each with its own streams.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from isetval.camera.bands import bands_nm
from isetval.core.cache import Remembered, content_hash
from isetval.core.campaign import Light, Shot
from isetval.core.context import TILE_ROWS, Context, Mode
from isetval.core.effect import Effect
from isetval.core.errors import InputError
from isetval.core.scene import ChartTarget, RenderedTarget, Scene
from isetval.core.sensor import Roi, Sensor, Window
from isetval.core.signal import Signal
from isetval.scenes.planar import build_scene, mean_radiance, planar_radiance
from isetval.scenes.rendered.accumulation import DRAWS
from isetval.scenes.rendered.accumulation import Progress as RenderProgress

Float = NDArray[np.float64]
FRONT = ("scene", "optics", "pixel")
FIELD_PX = 32  # pixels along the longer side of the coarse full field: a mean of r^2 over it errs by 1/(12 FIELD_PX^2), 1e-4
BAND_BUDGET = 6_000_000  # spectral samples held at once: 48 MB, a strip of 20 rows of a 12 MP sensor at 73 bands
PICTURE_STRIPS = 4  # times that for charts, whose pictures are few: strips of 90 rows had 192 of halo, which is blurred with them
RUN_PX = 32_768  # that effects without a halo see at once: 256 KB of doubles stay in a core's second-level cache
CACHE_BYTES = 600_000_000  # six full 12 MP frames, or all windows of a laboratory's plan at twenty points of a fit


class Camera(Protocol):
    """What a chain is run on: a sensor and its effects in the order in which light and charge meet them."""

    @property
    def name(self) -> str:
        """For messages."""
        ...

    @property
    def sensor(self) -> Sensor:
        """Geometry and levels."""
        ...

    @property
    def effects(self) -> tuple[Effect, ...]:
        """In order."""
        ...

    @property
    def wavelength_nm(self) -> Float:
        """Bands of the light, (bands,)."""
        ...


def occurrences(effects: tuple[Effect, ...]) -> tuple[int, ...]:
    """How often the same effect stands before each one: part of the key of its random streams."""
    names = [e.name for e in effects]
    return tuple(names[:i].count(name) for i, name in enumerate(names))


@dataclass(frozen=True, eq=False)
class ShotSetup:
    """A shot with what is known about it: its light and the values of its nuisances.

    ``regions`` of its window are all that will be looked at (none: all of it); elsewhere there is no light and code 0.
    ``before_e`` is the charge of the frame before the first, in e-: of each pixel of the window, or of each of the 2 x 2 pixels
    of the mosaic; the first of ``stands_for`` frames is left where one tells their mean.
    """

    shot: Shot
    light: Light | None = None
    nuisance: Mapping[str, float] = field(default_factory=dict)
    regions: tuple[Roi, ...] = ()
    before_e: Float | float = 0.0
    stands_for: int = 1

    def digest(self) -> str:
        """SHA-256 of all that decides the shot's light (not its frames, files or name, nor where the light's table lies)."""
        return self._digest

    def of_one_frame(self) -> ShotSetup:
        """The same with one frame."""
        return self if self.shot.frames == 1 else replace(self, shot=self.shot.of_one_frame, stands_for=self.shot.frames)

    def charge_before(self, roi: Roi) -> Float:
        """``before_e`` in the pixels of a region of the window: (rows, cols), or (1, 1) where all have the same."""
        charge, window = np.atleast_2d(self.before_e), self.shot.window or Window(0, 0, 2, 2)
        if charge.shape == (2, 2):
            rows, cols = np.arange(roi.row0, roi.row1) + window[0], np.arange(roi.col0, roi.col1) + window[1]
            return np.asarray(charge[np.ix_(rows % 2, cols % 2)])
        return charge if charge.size == 1 else charge[roi.row0 : roi.row1, roi.col0 : roi.col1]

    @cached_property
    def before_digest(self) -> str:
        """What ``before_e`` is, in words that no other has: the number, or SHA-256 of those of all pixels."""
        return repr(self.before_e) if isinstance(self.before_e, float) else content_hash(self.before_e)

    @cached_property
    def _digest(self) -> str:
        return content_hash((self.shot.seen, None if self.light is None else self.light.digest, self.nuisance, self.regions))

    def parts(self, shape: tuple[int, int]) -> tuple[Roi, ...]:
        """The regions, or the whole window of ``shape`` (rows, cols)."""
        return self.regions or (Roi(0, shape[0], 0, shape[1]),)


@dataclass(frozen=True)
class Rendering:
    """How a rendered scene is asked for: who hears of its passes, and which draw of its error is added (None: no error)."""

    progress: RenderProgress | None = None
    draw: int | None = None


_MEANS = Remembered(CACHE_BYTES)


def make_context(
    model: Camera,
    setup: ShotSetup,
    *,
    seed: int = 0,
    sensor_seed: int = 0,
    mode: Mode = "capture",
    mirrored: frozenset[str] = frozenset(),
) -> Context:
    """The context of a shot's whole window."""
    shot = setup.shot
    window = shot.window or (0, 0, model.sensor.rows, model.sensor.cols)
    return Context(
        sensor=model.sensor,
        window=window,
        exposure=shot.exposure,
        shot=shot.name,
        role=shot.role,
        light=shot.light or "",
        radiance=None if setup.light is None else setup.light.radiance,
        nuisance=setup.nuisance,
        focus_um=shot.focus_um,
        object_distance_m=shot.distance_m,
        rotation_deg=shot.rotation_deg,
        seed=seed,
        sensor_seed=sensor_seed,
        mode=mode,
        mirrored=mirrored,
    )


def front_effects(model: Camera) -> tuple[Effect, ...]:
    """The effects up to the colour filter array."""
    return tuple(e for e in model.effects if e.stage in FRONT)


def mean_electrons(model: Camera, setup: ShotSetup, *, progress: RenderProgress | None = None) -> Float:
    """Mean photo-electrons per frame, (rows, cols), float64; cached by content, read-only.

    ``progress(done, total, words)`` is called after every pass of a renderer.
    """
    effects = front_effects(model)
    key = (model.sensor, model.wavelength_nm.tobytes(), tuple(e.content() for e in effects), setup.digest())
    found = _MEANS.get(key)
    if found is None:
        found = _front(model, effects, setup, Rendering(progress))
        _MEANS.put(key, found)
    return found


def _front(model: Camera, effects: tuple[Effect, ...], setup: ShotSetup, how: Rendering) -> Float:
    whole = make_context(model, setup)
    mean = _field_means(model, effects, setup) if any(e.uses_mean_irradiance for e in effects) else {}
    row0, col0, rows, cols = whole.window
    out = np.zeros((rows, cols))
    for roi in setup.parts((rows, cols)):
        width = roi.col1 - roi.col0
        budget = BAND_BUDGET * (PICTURE_STRIPS if isinstance(setup.shot.target, ChartTarget) else 1)
        step = max(1, min(rows, budget // (width * model.wavelength_nm.size)))
        if isinstance(setup.shot.target, RenderedTarget):
            step = rows
        for top in range(roi.row0, roi.row1, step):
            part = (row0 + top, col0 + roi.col0, min(step, roi.row1 - top), width)
            context = whole.but(window=part, shot_window=whole.window)
            signal = _run_front(model, effects, setup, context, mean, how)
            out[top : top + part[2], roi.col0 : roi.col1] = signal.values.reshape(signal.values.shape[-2:])
    return out


def _run_front(
    model: Camera,
    effects: tuple[Effect, ...],
    setup: ShotSetup,
    context: Context,
    mean: Mapping[int, Float],
    how: Rendering,
) -> Signal:
    scene = _scene(model, effects, setup, context)
    signal = _radiance(scene, context, how)
    if setup.shot.levels_only:  # how a resampled picture was blurred is not known, and means alone are measured in it
        signal = signal.with_values(signal.values)
    for i, (effect, nth) in enumerate(zip(effects, occurrences(effects), strict=True)):
        if effect.stage != "scene":
            own = context.for_effect(effect.name, nth)
            signal = effect.apply(signal, own.but(mean_irradiance=mean[i]) if i in mean else own)
    return signal


def build_signal(model: Camera, setup: ShotSetup) -> Signal:
    """The radiance of a shot's scene, in front of the first effect of the optics (not for rendered scenes)."""
    context = make_context(model, setup)
    return _radiance(_scene(model, front_effects(model), setup, context), context, Rendering())


def _scene(model: Camera, effects: tuple[Effect, ...], setup: ShotSetup, context: Context) -> Scene:
    scene = build_scene(setup.shot, setup.light, bands_nm(model, setup.shot, setup.light), context)
    for effect in effects:
        if effect.stage == "scene":
            scene = effect.apply_scene(scene, context)
    return scene if isinstance(scene.target, RenderedTarget) else _lit(scene)


def _lit(scene: Scene) -> Scene:
    """The scene at the wavelengths that hold light, and one dark band on either side, which keeps every integral as it is."""
    light = scene.white != 0 if scene.ambient is None else (scene.white != 0) | (scene.ambient != 0)
    first, last = (0, 0) if not light.any() else (int(np.flatnonzero(light)[0]), int(np.flatnonzero(light)[-1]))
    bands = slice(max(first - 1, 0), last + 2)
    ambient = None if scene.ambient is None else scene.ambient[bands]
    return replace(
        scene,
        wavelength_nm=scene.wavelength_nm[bands],
        white=scene.white[bands],
        ambient=ambient,
        patch_factor={name: factor[bands] for name, factor in scene.patch_factor.items()},
        patch_added={name: added[bands] for name, added in scene.patch_added.items()},
    )


def _radiance(scene: Scene, context: Context, how: Rendering) -> Signal:
    if isinstance(scene.target, RenderedTarget):
        from isetval.scenes.rendered_target import rendered_radiance

        return rendered_radiance(scene, context, progress=how.progress, draw=how.draw)
    return planar_radiance(scene, context)


def render_draws(model: Camera, setup: ShotSetup) -> Float:
    """Mean electrons (draws, rows, cols) of a rendered shot with another error of the render in each.

    The errors have the covariance of the render's own, over pixels and bands; see `Running.draws` of the render's passes.
    """
    effects = front_effects(model)
    return np.stack([_front(model, effects, setup, Rendering(draw=i)) for i in range(DRAWS)])


def _field_means(model: Camera, effects: tuple[Effect, ...], setup: ShotSetup) -> dict[int, Float]:
    """Mean irradiance (bands,) of the whole field in front of each effect that asks for it."""
    factor = max(model.sensor.rows, model.sensor.cols) / FIELD_PX
    rows, cols = (max(1, round(n / factor)) for n in (model.sensor.rows, model.sensor.cols))
    coarse = Sensor(
        rows, cols, model.sensor.pixel_um * factor, "MONO", ((0.0, 0.0), (0.0, 0.0)), model.sensor.white_dn, model.sensor.bits
    )
    context = replace(make_context(model, setup), sensor=coarse, window=(0, 0, rows, cols), shot_window=None)
    scene = _scene(model, effects, setup, context)
    if scene.target is None:
        signal = planar_radiance(scene, context)
    else:
        signal = Signal.of(mean_radiance(scene)[:, None, None], "radiance", shape=(rows, cols), wavelength_nm=scene.wavelength_nm)
    means: dict[int, Float] = {}
    for i, effect in enumerate(effects):
        if effect.stage != "optics":
            continue
        if effect.uses_mean_irradiance:
            values = np.broadcast_to(signal.values, (scene.wavelength_nm.size, rows, cols))
            means[i] = values.mean(axis=(1, 2))
            context = replace(context, mean_irradiance=means[i])
        signal = effect.apply(signal, context)
    return means


def electronics(model: Camera, mean: NDArray[Any], context: Context, *, factor: float = 1.0, threads: int = 1) -> NDArray[Any]:
    """One frame's DN, (rows, cols), from mean photo-electrons times ``factor``.

    Effects without a halo see some blocks at a time (rows of the full-sensor grid, one stream per
    block: the bits depend neither on how many these are, nor on ``threads``, nor on the other effects); an effect with a halo
    sees the whole window.
    """
    dtype = np.float32 if context.mode == "capture" else np.float64
    charge = np.multiply(mean, factor, out=np.empty(mean.shape, dtype), casting="same_kind")[None]
    unit = "electron"
    effects = [(e, n) for e, n in zip(model.effects, occurrences(model.effects), strict=True) if e.stage not in FRONT]
    while effects:
        run = _leading(effects)
        effects = effects[len(run) :]
        charge = _run_block_wise(run, charge, unit, context, threads)
        unit = run[-1][0].gives
    if unit != "dn":
        raise InputError(f"model {model.name}: its electronics end in {unit}; a camera ends in dn")
    return np.asarray(charge[0])


def _leading(effects: list[tuple[Effect, int]]) -> list[tuple[Effect, int]]:
    if effects[0][0].halo_px:
        return effects[:1]
    for i, (effect, _) in enumerate(effects):
        if effect.halo_px:
            return effects[:i]
    return effects


def _run_block_wise(
    run: list[tuple[Effect, int]], charge: NDArray[Any], unit: str, context: Context, threads: int
) -> NDArray[Any]:
    row0, col0, rows, cols = context.window
    if run[0][0].halo_px:
        return _run(run, charge, unit, context.but(shot_window=context.shot_window or context.window))
    edges = [row0, *range((row0 // TILE_ROWS + 1) * TILE_ROWS, row0 + rows, TILE_ROWS)]
    together = max(1, RUN_PX // (TILE_ROWS * cols))
    runs = [tuple(edges[i : i + together]) for i in range(0, len(edges), together)]
    ends = [*(first for first, *_ in runs[1:]), row0 + rows]
    out = charge

    def block(i: int) -> None:
        first, end = runs[i][0], ends[i]
        rows_here = slice(first - row0, end - row0)
        own = context.but(
            window=(first, col0, end - first, cols), shot_window=context.shot_window or context.window, row_edges=runs[i]
        )
        if own.previous is not None and own.previous.shape[0] == rows:
            own = own.but(previous=own.previous[rows_here])
        out[:, rows_here] = _run(run, charge[:, rows_here], unit, own)

    if threads > 1 and len(runs) > 3:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(block, range(len(runs))))
    else:
        for i in range(len(runs)):
            block(i)
    return out


def _run(run: list[tuple[Effect, int]], charge: NDArray[Any], unit: str, context: Context) -> NDArray[Any]:
    signal = Signal.of(charge, unit)
    for effect, nth in run:
        signal = effect.apply(signal, context.for_effect(effect.name, nth))
    return signal.values
