"""The frames of one shot: mean electrons through the electronics, frame by frame, into captures."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.camera.chain import Camera, ShotSetup, electronics, make_context, mean_electrons
from isetval.core.campaign import Light, Shot
from isetval.core.capture import Capture, ExpectedFrame
from isetval.core.context import Context, Mode, stream, word
from isetval.core.sensor import Exposure, Roi, as_rational_time
from isetval.effects.electrons import FullWell

Float = NDArray[np.float64]
PLASTIC = 1.324717957244746  # x^3 = x + 1
LEFT_DITHER = 0.05  # of a code, where nothing is rounded: no estimator meets data without noise; a 400th of its variance
BIG_PX = 1_000_000  # below it starting threads costs more than they save
NORMAL_ABOVE_E = 30.0  # skewness of a Poisson number 1/sqrt(30) = .18: its normal twin keeps mean and variance exactly


def expose(
    model: Camera,
    setup: ShotSetup,
    seed: int = 0,
    *,
    mode: Mode = "capture",
    sensor_seed: int | None = None,
    frame_factors: Float | None = None,
    frame_normals: Float | None = None,
    mean: Float | None = None,
    rounded: bool = True,
    mirrored: frozenset[str] = frozenset(),
) -> tuple[Capture, ...]:
    """The frames of one shot; ``mean`` replaces the light, effects ``mirrored`` draw their noise with the other sign.

    The light of each frame is ``frame_factors`` (frames,) times as strong; ``frame_normals`` (frames,) stand for what effects
    draw for a frame as a whole.

    Expected frames need not be ``rounded`` to codes; a little of their dither stays, or estimators would meet data without any
    noise.  Derivatives that are not are `dithered`.
    """
    shot = setup.shot
    mean = mean_electrons(model, setup) if mean is None else mean
    specimen = seed if sensor_seed is None else sensor_seed
    smooth = mode == "derivative" and not rounded
    context = make_context(model, setup, seed=seed, sensor_seed=specimen, mode=mode, mirrored=mirrored).but(dithered=smooth)
    parts = setup.parts(mean.shape)
    lit = [mean[roi.row0 : roi.row1, roi.col0 : roi.col1] for roi in parts]
    gaussian = bool(sum(float(part.sum()) for part in lit) > NORMAL_ABOVE_E * sum(part.size for part in lit))
    threads = min(2, os.cpu_count() or 1) if max(part.size for part in lit) > BIG_PX else 1
    frames = []
    stored = stored_exposure(shot.exposure)
    lags = any(effect.needs_previous for effect in model.effects)
    well_e = min((effect.well_e for effect in model.effects if isinstance(effect, FullWell)), default=math.inf)
    row0, col0 = context.window[:2]
    for frame in range(shot.frames):
        factor = 1.0 if frame_factors is None else frame_factors[frame]
        codes = np.zeros(mean.shape, np.uint16 if rounded else np.float32)
        for roi, part in zip(parts, lit, strict=True):
            before = _charge_before(setup, frame, roi, part, well_e) if lags else None
            of_frame = None if frame_normals is None else float(frame_normals[frame])
            own = context.but(frame=frame, previous=before, poisson_gaussian=gaussian, of_frame=of_frame)
            if setup.regions:
                own = own.but(window=(row0 + roi.row0, col0 + roi.col0, *part.shape), shot_window=context.window)
            dn = electronics(model, part, own, factor=float(factor), threads=threads)
            if mode == "expected":  # codes are whole: dither keeps means unbiased where no noise does
                place = (roi.row0, roi.col0) if setup.regions else ()
                rng = stream(seed, word("dither"), word(shot.name), frame, *place)
                dither = _even_dither(dn.shape, rng) if shot.levels_only else rng.random(dn.shape) - 0.5
                dn = dn + (dither if rounded else LEFT_DITHER * dither)
            elif smooth:
                dn = dithered(dn, code_step_dn(model), model.sensor.white_dn, own)
            codes[roi.row0 : roi.row1, roi.col0 : roi.col1] = _codes(dn) if rounded else np.clip(dn, 0, 65535)
        frames.append(_capture(model, setup, codes, seed, frame, stored))
    return tuple(frames)


def _charge_before(setup: ShotSetup, frame: int, roi: Roi, part: Float, well_e: float) -> Float:
    """What the frame before one held, e-, (rows, cols) or (1, 1): ``part`` is the light of each, ``well_e`` all that fits."""
    held = np.minimum(part, well_e)
    if frame:
        return held
    first = np.minimum(setup.charge_before(roi), well_e)
    return np.asarray((first + (setup.stands_for - 1) * held) / setup.stands_for)


def code_step_dn(model: Camera) -> float:
    """The step in DN between the codes of a camera's files, one at least; nan where not all pixels have one."""
    return float(np.max([1.0, *(effect.code_step_dn() for effect in model.effects)]))


def dithered(dn: NDArray[Any], step_dn: float, white_dn: float, context: Context) -> Float:
    """Codes (rows, cols) that were not rounded, with a part of a code that is the same at every point of a fit.

    Where noise is wider than half a step, rounding is an error that is evenly spread over one step and hangs on nothing (Widrow
    and Kollar, Quantization Noise, 2008, ch. 4), so that these numbers have the mean, the variance and the correlations of
    rounded ones.  Those of two points are rounded each by itself: their difference has a noise of a sixth of a step squared in
    each pixel, this one has none.  What is at either end of the range stays there, and what would be rounded to it goes there.
    Done in place.
    """
    full, empty = dn >= white_dn, dn <= 0
    dn += step_dn * context.but(effect_key=(word("dither"), 0)).frame_numbers("dither", dn.shape)
    dn[full | (dn > white_dn - 0.5)] = white_dn
    dn[empty | (dn < 0.5)] = 0.0
    return dn


def _even_dither(shape: tuple[int, ...], rng: np.random.Generator) -> Float:
    """Parts of a code, (rows, cols), so evenly spread that means of n neighbours err by some 1/n of a code, not 1/sqrt(n).

    A lattice whose steps are powers of the plastic number's inverse (Roberts' R2 sequence), begun anywhere: a fit to means
    of patches follows levels smoothly.
    """
    rows, cols = np.ogrid[: shape[-2], : shape[-1]]
    return np.asarray((rng.random() + rows / PLASTIC + cols / PLASTIC**2) % 1.0 - 0.5)


def _codes(dn: NDArray[Any]) -> NDArray[np.uint16]:
    np.rint(dn, out=dn)
    return np.clip(dn, 0, 65535, out=dn).astype(np.uint16)


def _capture(model: Camera, setup: ShotSetup, codes: NDArray[Any], seed: int, frame: int, exposure: Exposure) -> Capture:
    shot = setup.shot
    provenance = {"maker": "isetval", "model": model.name, "shot": shot.name, "seed": seed, "frame": frame}
    row0, col0 = (shot.window or (0, 0))[:2]
    kind = Capture if codes.dtype == np.uint16 else ExpectedFrame
    return kind(codes, model.sensor, (row0, col0), exposure, provenance)


@lru_cache(maxsize=256)
def stored_exposure(exposure: Exposure) -> Exposure:
    """The exposure as a DNG holds it: times as 32-bit rationals."""
    if exposure.time_s is None:
        return exposure
    return replace(exposure, time_s=float(as_rational_time(exposure.time_s)))


def expected_dn(
    model: Camera, shot: Shot, *, lights: Mapping[str, Light] | None = None, nuisance: Mapping[str, float] | None = None
) -> Float:
    """Noise-free DN of a shot, float64 (rows, cols); frame noise off, fixed pattern of seed 0 on."""
    setup = ShotSetup(shot, (lights or {}).get(shot.light or ""), nuisance or {})
    context = make_context(model, setup, mode="expected")
    return np.asarray(electronics(model, mean_electrons(model, setup), context))


def expose_shot(
    model: Camera, shot: Shot, *, seed: int = 0, lights: Mapping[str, Light] | None = None, **more: Any
) -> tuple[Capture, ...]:
    """The frames of one shot of a plan with ``lights``."""
    return expose(model, ShotSetup(shot, (lights or {}).get(shot.light or "")), seed, **more)
