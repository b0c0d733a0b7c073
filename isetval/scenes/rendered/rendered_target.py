"""A shot's rendered scene as a signal: the renderer's picture for the simulation chain.

What is rendered is the *transport*: radiance per unit radiance of the lamp, in a few broad bands, by Mitsuba with a
pinhole at the entrance pupil.  The light of the shot multiplies it, band by band, so that its level and spectrum cost no
new render; walls, black and chart reflectances do, with common random numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.errors import InputError
from isetval.core.scene import RenderedTarget, Scene, Spectrum
from isetval.core.signal import Layer, Signal, Transfer
from isetval.scenes.planar import target_field
from isetval.scenes.rendered.accumulation import Progress, Render
from isetval.scenes.rendered.rendering import render
from isetval.scenes.rendered.scene_file import LoadedScene, parse_scene
from isetval.scenes.rendered.spectra import LONGEST_NM, SHORTEST_NM

Float = NDArray[np.float64]
FINE_PX = 2_000_000
COARSE_PX = 64


def rendered_radiance(scene: Scene, context: Context, *, progress: Progress | None = None, draw: int | None = None) -> Signal:
    """Spectral radiance (bands, rows, cols) that a rendered scene sends to each pixel of the window.

    Parameters
    ----------
    scene : Scene
        Its target holds the content of a scene file.  ``white`` is the lamp's radiance; without a light (all zero) the
        scene's own lamp is used.
    context : Context
        Sensor, window and rotation of the camera.
    progress : callable, optional
        ``progress(done, total, words)`` after every pass.
    draw : int, optional
        Add this draw of the render's error (`isetval.scenes.rendered.accumulation.Render.draws`).

    Returns
    -------
    Signal
        Sharp, with the render on a grid finer than the pixels: pixel aperture and blur are still to come.

    Raises
    ------
    InputError
        For a scene that cannot be built; the message names file and entry.
    """
    if not isinstance(scene.target, RenderedTarget):
        raise InputError("the shot's target is not a scene to be rendered")
    loaded = load_target(scene)
    lamp = scene.white if np.any(scene.white > 0) else own_lamp(scene)
    transport = _transport(loaded, scene, context, progress)
    if draw is not None:
        transport = replace(transport, render=transport.render.with_draw(draw))
    rows, cols = context.window[2:]
    amplitude = (lamp[:, None, None] * target_field(scene, context))[..., :rows, :cols]
    layers = [Layer(amplitude, transport)]
    if scene.ambient is not None:
        layers.append(Layer(scene.ambient[:, None, None]))
    return Signal(tuple(layers), "radiance", (rows, cols), scene.wavelength_nm)


def rendered_mean(scene: Scene, context: Context) -> Float:
    """Mean spectral radiance (bands,) of all that the camera sees of a rendered scene, for glare; a coarse render."""
    loaded = load_target(scene)
    lamp = scene.white if np.any(scene.white > 0) else own_lamp(scene)
    sensor = context.sensor
    factor = max(sensor.rows, sensor.cols) / COARSE_PX
    coarse = replace(
        sensor,
        rows=max(1, round(sensor.rows / factor)),
        cols=max(1, round(sensor.cols / factor)),
        pixel_um=sensor.pixel_um * factor,
    )
    camera = fine_camera(loaded.cameras[loaded.settings["camera"]], replace(context, sensor=coarse), subsample=1, halo_px=0)
    bands = _bands(loaded, scene)
    made = render(loaded.spec, camera=camera, wavelength_nm=bands, spp=32, seed=int(loaded.settings["seed"]))
    mean = np.interp(scene.wavelength_nm, bands, made.radiance.mean(axis=(1, 2), dtype=float))
    return np.asarray(lamp * mean if scene.ambient is None else lamp * mean + scene.ambient)


def _bands(loaded: LoadedScene, scene: Scene) -> Float:
    low, high = max(SHORTEST_NM, scene.wavelength_nm[0]), min(LONGEST_NM, scene.wavelength_nm[-1])
    return np.linspace(low, high, int(loaded.settings["bands"]))


def load_target(scene: Scene, **changes: Any) -> LoadedScene:
    """The scene of a shot for unit lamp radiance, with what scene effects and nuisances changed."""
    assert isinstance(scene.target, RenderedTarget)
    content = scene.target.spec
    parameters = content.get("parameters", {})
    albedo = float(scene.parameters.get("wall_albedo", 0.0))
    changes |= {
        "wall_albedo_scale": float(parameters.get("wall_albedo_scale", 1.0)) * (1 + albedo),
        "black_added": float(parameters.get("black_added", 0.0)) + scene.black,
        "chart_gloss": float(parameters.get("chart_gloss", 0.0)) + scene.gloss,
    }
    file = Path(str(content.get("file", scene.target.name)))
    loaded = parse_scene(content, file=file, lamp=Spectrum.flat(1.0), **changes)
    if not loaded.cameras:
        raise InputError(f"{file}: has no camera; add a [camera.NAME] table with z_m")
    return loaded


def own_lamp(scene: Scene) -> Float:
    """Radiance of the scene file's own lamp, mean over the bands of the scene's grid, (bands,)."""
    assert isinstance(scene.target, RenderedTarget)
    content = scene.target.spec
    lamp = parse_scene(content, file=Path(str(content.get("file", scene.target.name)))).spec["spectra"]["lamp"]
    scale = float(content.get("parameters", {}).get("light_scale", 1.0))
    values = np.array(lamp["values"]) / scale if scale else np.zeros(len(lamp["values"]))
    return Spectrum(np.array(lamp["wavelength_nm"]), values).band_means(scene.wavelength_nm)


def _transport(loaded: LoadedScene, scene: Scene, context: Context, progress: Progress | None) -> Picture:
    settings = loaded.settings
    rows, cols = context.window[2:]
    s = int(settings["subsample"]) if rows * cols * int(settings["subsample"]) ** 2 <= FINE_PX else 1
    halo = int(settings["halo_px"])
    camera = fine_camera(loaded.cameras[settings["camera"]], context, subsample=s, halo_px=halo)
    row0, col0 = context.window[:2]
    crop = (row0 * s, col0 * s, (rows + 2 * halo) * s, (cols + 2 * halo) * s)
    shared: dict[str, Any] = {
        "camera": camera,
        "crop": crop,
        "wavelength_nm": _bands(loaded, scene),
        "spp": max(2, -(-int(settings["spp"]) // s**2)),
        "seed": int(settings["seed"]),
        "variant": settings["variant"] or None,
        "progress": progress,
    }
    made = render(loaded.spec, **shared)
    if scene.bounce:
        direct = render({**loaded.spec, "bounces": 1}, **shared)
        more = made.radiance + scene.bounce * (made.radiance - direct.radiance)
        draws = made.draws + np.float32(scene.bounce) * (made.draws - direct.draws)
        made = replace(made, radiance=np.maximum(more, 0), draws=draws)
    return Picture(made, s, halo)


def fine_camera(camera: Any, context: Context, *, subsample: int, halo_px: int) -> dict[str, Any]:
    """The scene file's camera with the shot's sensor: a margin of ``halo_px`` around it, ``subsample`` times finer."""
    sensor, turn = context.sensor, math.radians(context.rotation_deg)
    return {
        **camera,
        "up": [math.sin(turn), math.cos(turn), 0.0],
        "pixel_um": sensor.pixel_um / subsample,
        "rows": (sensor.rows + 2 * halo_px) * subsample,
        "cols": (sensor.cols + 2 * halo_px) * subsample,
    }


@dataclass(frozen=True, eq=False)
class Picture:
    """A render ``subsample`` times finer than the pixels, with a margin of ``halo_px``: sharp detail of a scene."""

    render: Render
    subsample: int
    halo_px: int

    def sample(self, amplitude: Float, transfer: Transfer | None, wavelength_nm: Float | None) -> Float:
        """The blurred picture at the pixels' middles times ``amplitude``, (bands, rows, cols).

        Without a transfer function, the mean over each pixel.
        """
        grid = np.array([550.0]) if wavelength_nm is None else wavelength_nm
        fine = self.render.radiance
        s, halo = self.subsample, self.halo_px
        shape = tuple(n // s - 2 * halo for n in fine.shape[1:])
        weights = np.array([np.interp(grid, self.render.wavelength_nm, row) for row in np.eye(len(fine))]).T
        out = np.empty((grid.size, *shape))
        if transfer is None:
            inner = fine[:, halo * s : fine.shape[1] - halo * s, halo * s : fine.shape[2] - halo * s]
            binned = inner.reshape(len(fine), shape[0], s, shape[1], s).mean(axis=(2, 4), dtype=float)
            return np.asarray(amplitude * np.tensordot(weights, binned, 1))
        spectra = np.fft.rfft2(fine.astype(float))
        fy = np.asarray(np.fft.fftfreq(fine.shape[1], 1 / s), float)[:, None]
        fx = np.asarray(np.fft.rfftfreq(fine.shape[2], 1 / s), float)[None, :]
        # to the pixel's middle, half a pixel less half a fine sample on; and what the fine samples' own size blurs
        shift = np.exp(1j * np.pi * (1 - 1 / s) * (fx + fy)) / (np.sinc(fx / s) * np.sinc(fy / s))
        for i, wavelength in enumerate(grid):
            otf = np.asarray(transfer(fx, fy, np.array(wavelength)))
            picture = np.fft.irfft2(np.tensordot(weights[i], spectra, 1) * otf * shift, s=fine.shape[1:])
            out[i] = picture[halo * s : fine.shape[1] - halo * s : s, halo * s : fine.shape[2] - halo * s : s]
        return np.asarray(amplitude * out)
