"""A shot's rendered scene as a signal: the renderer's picture for the simulation chain.

What is rendered is the *transport*: radiance per unit radiance of the lamp, in a few broad bands, by Mitsuba with a
pinhole at the entrance pupil.  The light of the shot multiplies it, band by band, so that its level and spectrum cost no
new render.  Reflectances of black and of a chart lie between renders at fixed steps, with common random numbers, which a
diagnosis makes once and finds again; those of walls are rendered as they are.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from isetval.core.cache import content_hash
from isetval.core.context import Context
from isetval.core.errors import InputError
from isetval.core.scene import RenderedTarget, Scene, Spectrum
from isetval.core.signal import Layer, Signal, Transfer
from isetval.scenes.pictures import SpectralPicture, keep
from isetval.scenes.planar import shifted, target_field
from isetval.scenes.rendered.accumulation import Progress, Render
from isetval.scenes.rendered.box import turned_up
from isetval.scenes.rendered.lens_view import LensView, pupil_camera, pupil_crop
from isetval.scenes.rendered.rendering import render, scene_content
from isetval.scenes.rendered.scene_file import LoadedScene, parse_scene
from isetval.scenes.rendered.spectra import LONGEST_NM, SHORTEST_NM

Float = NDArray[np.float64]
FINE_PX = 2_000_000
COARSE_PX = 64
REFLECTANCE_STEP = 0.02  # a chart on half of a box's wall sends a tenth of its light back to itself: half step^2 x .1 is 2e-5
DIRECT = -1.0  # strength of further bounces at which none is left
_PICTURES: OrderedDict[str, SpectralPicture] = OrderedDict()  # a diagnosis asks for the same few again and again


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
        Sharp, rendered when it is sampled on a grid finer than the pixels: lens, pixel aperture and blur are still to come.

    Raises
    ------
    InputError
        For a scene that cannot be built; the message names file and entry.
    """
    if not isinstance(scene.target, RenderedTarget):
        raise InputError("the shot's target is not a scene to be rendered")
    lamp = _lamp(scene)
    transport = RenderedScene(load_target(scene), scene, context, progress, draw)
    rows, cols = context.window[2:]
    layers = [Layer(lamp[:, None, None], transport, target_field(scene, context)[..., :rows, :cols])]
    if scene.ambient is not None:
        layers.append(Layer(scene.ambient[:, None, None]))
    return shifted(Signal(tuple(layers), "radiance", (rows, cols), scene.wavelength_nm), scene)


def _lamp(scene: Scene) -> Float:
    """Radiance (bands,) of the shot's light, else of the scene file's own lamp at the shot's level."""
    return scene.white if np.any(scene.white > 0) else own_lamp(scene) * scene.lamp_factor


def rendered_mean(scene: Scene, context: Context) -> Float:
    """Mean spectral radiance (bands,) of all that the camera sees of a rendered scene, for glare; a coarse render."""
    loaded = load_target(scene)
    lamp = _lamp(scene)
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


@dataclass(frozen=True, eq=False)
class RenderedScene:
    """A scene that waits to be rendered: by a pinhole at the entrance pupil, or for a lens that looks at it."""

    loaded: LoadedScene
    scene: Scene
    context: Context
    progress: Progress | None = None
    draw: int | None = None

    def sample(self, amplitude: Float, transfer: Transfer | None, wavelength_nm: Float | None) -> Float:
        """The picture of the pinhole, blurred and sampled; see `SpectralPicture.sample`."""
        return self.pinhole.sample(amplitude, transfer, wavelength_nm)

    def mixed(self, weights: Float, transfer: Transfer | None, wavelength_nm: Float | None) -> Float:
        """Sums of that picture over the bands; see `SpectralPicture.mixed`."""
        return self.pinhole.mixed(weights, transfer, wavelength_nm)

    @property
    def pinhole(self) -> SpectralPicture:
        """The scene file's own camera, finer than the sensor's pixels."""
        return self._kept((), lambda node: node.render().radiance)

    def render(self) -> Render:
        """The transport that the pinhole sees, with its error; of a scene that no other two stand for."""
        return self._rendered(self.camera, self._crop)

    def through(self, view: LensView) -> SpectralPicture:
        """Irradiance behind a lens per unit radiance of the lamp: warped, blurred by depth and field, lit as the lens does.

        Rendered from the lens's entrance pupil; `isetval.scenes.through_lens.image_space` on the finer grid.
        """
        from isetval.lens.field_table import lens_hash
        from isetval.lens.tracing import TracedLens
        from isetval.scenes.through_lens.image_space import image_space_irradiance

        def imaged(node: RenderedScene) -> NDArray[np.float32]:
            halo = self.halo_px * self.subsample
            crop = pupil_crop(view, self.camera, self._crop, subsample=1, halo_px=halo)
            made = node._rendered(pupil_camera(view, self.camera), crop)
            return image_space_irradiance(made, view, camera=self.camera, crop=self._crop, subsample=1, halo_px=halo).irradiance

        return self._kept((lens_hash(cast(TracedLens, view.lens)), view.film_mm), imaged)

    def _kept(self, view: tuple[Any, ...], make: Callable[[RenderedScene], NDArray[np.float32]]) -> SpectralPicture:
        """The picture (bands, rows, cols) of this scene on the finer grid, made once and kept in memory."""
        bands, settings = _bands(self.loaded, self.scene), self.loaded.settings
        render = (settings["spp"], settings["seed"], settings["variant"], self.loaded.spec["bounces"], self.scene.bounce)
        added = (self.scene.black, self.scene.gloss)
        made_of = (scene_content(self.loaded.spec, self.camera), added, bands, render, self.draw, self._crop, view)
        key = content_hash((made_of, self.scene.wavelength_nm, self.halo_px, self.subsample))
        if key not in _PICTURES:
            spectra = np.array([np.interp(self.scene.wavelength_nm, bands, row) for row in np.eye(bands.size)]).T
            nodes = self._nodes()
            if len(nodes) == 1:
                made = make(self)
            else:
                made = np.maximum(sum(np.float32(weight) * node._kept(view, make).parts for weight, node in nodes), 0)
            keep(_PICTURES, key, SpectralPicture(spectra, made, self.halo_px, self.subsample, averaged=True))
        _PICTURES.move_to_end(key)
        return _PICTURES[key]

    @property
    def subsample(self) -> int:
        """Samples of the render along a pixel's side; 1 for large windows."""
        rows, cols = self.context.window[2:]
        wanted = int(self.loaded.settings["subsample"])
        return wanted if rows * cols * wanted**2 <= FINE_PX else 1

    @property
    def halo_px(self) -> int:
        """Margin around the window, in pixels, that holds the blur."""
        return int(self.loaded.settings["halo_px"])

    @property
    def camera(self) -> dict[str, Any]:
        """The scene file's camera with the shot's sensor."""
        own = self.loaded.cameras[self.loaded.settings["camera"]]
        return fine_camera(own, self.context, subsample=self.subsample, halo_px=self.halo_px)

    @property
    def _crop(self) -> tuple[int, int, int, int]:
        """The window with its margin on the finer grid."""
        row0, col0, rows, cols = self.context.window
        s, halo = self.subsample, self.halo_px
        return (row0 * s, col0 * s, (rows + 2 * halo) * s, (cols + 2 * halo) * s)

    def _rendered(self, camera: dict[str, Any], crop: tuple[int, int, int, int]) -> Render:
        """The transport seen by a pinhole camera, with the wanted draw of its error; bounce 0 or -1 (direct light alone)."""
        settings, spec = self.loaded.settings, self.loaded.spec
        made = render(
            {**spec, "bounces": 1} if self.scene.bounce == DIRECT else spec,
            camera=camera,
            crop=crop,
            wavelength_nm=_bands(self.loaded, self.scene),
            spp=max(2, -(-int(settings["spp"]) // self.subsample**2)),
            seed=int(settings["seed"]),
            variant=settings["variant"] or None,
            progress=self.progress,
        )
        return made if self.draw is None else made.with_draw(self.draw)

    def _nodes(self) -> list[tuple[float, RenderedScene]]:
        """The scenes that are rendered and their weights; itself alone where nothing stands for it.

        A path's light is the product of the reflectances that it meets, and Lambertian paths do not depend on them: with
        common random numbers the transport is a polynomial of each reflectance added to black and to a chart, linear but for
        light that goes from such a surface to another one, and it lies between renders at whole steps.  A step that no surface
        can take (it would reflect all) is rendered as it is.  Strength b of the further bounces: (1 + b) all - b direct.
        """
        low, share = {}, {}
        for name in ("black", "gloss"):
            steps, share[name] = divmod(round(getattr(self.scene, name) / REFLECTANCE_STEP, 9), 1.0)
            low[name] = steps * REFLECTANCE_STEP if share[name] else getattr(self.scene, name)
        up = [(part, low | {name: low[name] + REFLECTANCE_STEP}) for name, part in share.items() if part]
        bounce = self.scene.bounce
        strengths = [(w, at) for w, at in ((1 + bounce, 0.0), (-bounce, DIRECT)) if w]
        try:
            return [
                (weight * strength, self._with(bounce=at, **black_and_chart))
                for weight, black_and_chart in [(1.0 - sum(share.values()), low), *up]
                for strength, at in strengths
            ]
        except InputError:
            return [(strength, self._with(bounce=at)) for strength, at in strengths]

    def _with(self, **changes: Any) -> RenderedScene:
        scene = replace(self.scene, **changes)
        return replace(self, loaded=load_target(scene), scene=scene)


def fine_camera(camera: Any, context: Context, *, subsample: int, halo_px: int) -> dict[str, Any]:
    """The scene file's camera with the shot's sensor: a margin of ``halo_px`` around it, ``subsample`` times finer."""
    sensor, turn = context.sensor, math.radians(context.rotation_deg)
    return {
        **camera,
        "up": turned_up(camera, turn),
        "pixel_um": sensor.pixel_um / subsample,
        "rows": (sensor.rows + 2 * halo_px) * subsample,
        "cols": (sensor.cols + 2 * halo_px) * subsample,
    }
