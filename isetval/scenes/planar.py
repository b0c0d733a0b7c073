"""Planar targets without a renderer: uniform fields, slanted edges, charts of uniform patches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.cache import Remembered, content_hash
from isetval.core.campaign import Light, Shot, of_patch
from isetval.core.context import Context
from isetval.core.errors import InputError
from isetval.core.scene import ChartTarget, EdgeTarget, Highlight, Scene
from isetval.core.sensor import RoiLike
from isetval.core.signal import Layer, Moved, Signal, Transfer
from isetval.scenes.pictures import HALO_PX, SpectralPicture, wavelength_nodes

Float = NDArray[np.float64]
ESF_STEP_PX = 1 / 16
ESF_HALF_PX = 512
SPREAD_BYTES = 100_000_000  # of edge spread functions: a hundred pupils; light, place and what does not blur ask for the same


def build_scene(shot: Shot, light: Light | None, wavelength_nm: Float, context: Context) -> Scene:
    """The scene of a shot with its nuisances: light level, spectrum tilt, light field, target."""
    white = np.zeros_like(wavelength_nm) if light is None else light.radiance.photon_means(wavelength_nm)
    if shot.role == "dark":
        white = np.zeros_like(wavelength_nm)
    level = shot.light_level * max(0.0, 1 + context.get("light_level"))
    step = (wavelength_nm - 550.0) / 100.0
    spectrum = 1 + context.get("spectrum_tilt") * step + context.get("spectrum_bow") * step**2
    patches = shot.target.patches if isinstance(shot.target, ChartTarget) else ()
    level *= 1.0 if shot.target is None else _at_window(context)
    factor = level * np.maximum(spectrum, 0)
    return Scene(
        wavelength_nm=wavelength_nm,
        white=white * factor,
        lamp_factor=factor,
        light=None if light is None else light.radiance,
        target=_moved(shot.target, context),
        tilt=(context.get("light_tilt_x"), context.get("light_tilt_y")),
        radial=context.get("light_radial"),
        bow=(context.get("light_bow_x"), context.get("light_bow_y"), 0.0),
        target_tilt=(context.get("target_tilt_x"), context.get("target_tilt_y")),
        target_bow=(context.get("target_bow_x"), context.get("target_bow_y"), context.get("target_twist")),
        target_shift_px=(context.get("chart_shift_x_px"), context.get("chart_shift_y_px")),
        patch_factor=_patch_factors([patch.name for patch in patches], context, step),
        surround=context.get("surround_reflectance"),
        black=context.get("dark_reflectance"),
        parameters={"wall_albedo": context.get("wall_albedo")},
    )


def _patch_factors(names: Sequence[str], context: Context, step: Float) -> dict[str, Float]:
    """What the laboratory's errors of each patch make of its reflectance, (bands,); patches without an error are left out.

    ``step`` are wavelengths from 550 nm in 100 nm.
    """
    out = {}
    for name in names:
        level, tilt, bow = (context.get(of_patch(f"patch_{what}", name)) for what in ("reflectance", "tilt", "bow"))
        if level or tilt or bow:
            out[name] = np.maximum((1 + level) * (1 + tilt * step + bow * step**2), 0.0)
    return out


def _at_window(context: Context) -> float:
    """Relative light on a target by the place of its window's middle in the field."""
    tilt_x, tilt_y = context.get("window_tilt_x"), context.get("window_tilt_y")
    if not (tilt_x or tilt_y):
        return 1.0
    row0, col0, rows, cols = context.shot_window or context.window
    sensor = context.sensor
    half = math.hypot(sensor.rows, sensor.cols) / 2
    x, y = (col0 + (cols - sensor.cols) / 2) / half, (row0 + (rows - sensor.rows) / 2) / half
    lab_x, lab_y = _in_lab(x, y, context)
    return max(0.0, float(1 + tilt_x * lab_x + tilt_y * lab_y))


def _in_lab(x: Any, y: Any, context: Context) -> tuple[Any, Any]:
    """Places on the sensor, turned with the camera."""
    turn = np.deg2rad(context.rotation_deg)
    return np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y


def _moved(target: Any, context: Context) -> Any:
    shift, turn = context.get("edge_shift_px"), context.get("edge_angle_deg")
    if not isinstance(target, EdgeTarget) or not (shift or turn):
        return target
    normal = _normal(target)
    offset = (target.offset_px[0] + shift * normal[0], target.offset_px[1] + shift * normal[1])
    return replace(target, offset_px=offset, angle_deg=target.angle_deg + turn)


def planar_radiance(scene: Scene, context: Context) -> Signal:
    """Spectral radiance (bands, rows, cols) that a planar scene sends to each pixel of the window.

    Raises
    ------
    InputError
        For a target that is not planar.
    """
    rows, cols = context.window[2:]
    if scene.target is None:
        layers = [Layer(scene.white[:, None, None], gain=light_field(scene, context))]
    elif isinstance(scene.target, EdgeTarget):
        layers = _edge_layers(scene, context)
    elif isinstance(scene.target, ChartTarget):
        white = scene.white[:, None, None]
        layers = [Layer(white, _chart(scene, scene.target, context), target_field(scene, context))]
        layers += [Layer(white, gain=_mirrored(one, context)) for one in scene.highlights]
    else:
        raise InputError(f"target {scene.target.name}: not a planar target; it needs the renderer")
    if scene.ambient is not None:
        layers.append(Layer(scene.ambient[:, None, None]))
    signal = Signal(tuple(layers), "radiance", (rows, cols), scene.wavelength_nm)
    return shifted(signal, scene) if isinstance(scene.target, ChartTarget) else signal


def shifted(signal: Signal, scene: Scene) -> Signal:
    """The picture of a target at its place beside the stated one."""
    if not any(scene.target_shift_px):
        return signal
    return signal.blurred(Moved(lambda wavelength_nm: scene.target_shift_px))


def mean_radiance(scene: Scene) -> Float:
    """Mean spectral radiance (bands,) of all that the camera sees, from the target's surround."""
    target = scene.target
    if isinstance(target, EdgeTarget):
        sides = (target.dark_reflectance.at(scene.wavelength_nm) + target.bright_reflectance.at(scene.wavelength_nm)) / 2
        mean = scene.white * ((sides if target.surround is None else target.surround.at(scene.wavelength_nm)) + scene.surround)
    elif isinstance(target, ChartTarget):
        around = target.surround if target.background is None else target.background
        mean = scene.white * (around.at(scene.wavelength_nm) + scene.surround)
    else:
        mean = scene.white
    return mean if scene.ambient is None else mean + scene.ambient


def light_field(scene: Scene, context: Context) -> Float:
    """Relative light of a uniform field, (1, rows, cols) or (1, 1, 1): tilt, radial part and bow, in lab axes."""
    if not (any(scene.tilt) or scene.radial or any(scene.bow)):
        return np.ones((1, 1, 1))
    x, y = context.xy_mm()
    unit = context.sensor.half_diagonal_mm
    x, y = x / unit, y / unit
    lab_x, lab_y = _in_lab(x, y, context)
    field = 1 + scene.tilt[0] * lab_x + scene.tilt[1] * lab_y + scene.radial * (x**2 + y**2)
    field += scene.bow[0] * lab_x**2 + scene.bow[1] * lab_y**2 + scene.bow[2] * lab_x * lab_y
    return np.asarray(field[None])


def target_field(scene: Scene, context: Context) -> Float:
    """Relative light on a target, (1, rows, cols) or (1, 1, 1): tilt and bow over the shot's window."""
    if not any(scene.target_tilt) and not any(scene.target_bow):
        return np.ones((1, 1, 1))
    rows, cols = context.shot_shape()
    row, col = context.place_in_shot()
    x, y = (col - (cols - 1) / 2) / max(cols / 2, 1), (row - (rows - 1) / 2) / max(rows / 2, 1)
    (along_x, along_y), (xx, yy, xy) = scene.target_tilt, scene.target_bow
    return np.asarray((1 + along_x * x + along_y * y + xx * x**2 + yy * y**2 + xy * x * y)[None])


def _chart(scene: Scene, target: ChartTarget, context: Context) -> SpectralPicture:
    """The chart's reflectances, with a halo of its surroundings for blur."""
    rows, cols = context.window[2:]
    top, left = (int(place.flat[0]) - HALO_PX for place in context.place_in_shot())
    table = [np.maximum(scene.reflectance(target.surround) + scene.surround, 0)]
    factor, added = scene.patch_factor, scene.patch_added
    for patch in target.patches:
        reflected = scene.reflectance(patch.reflectance) * factor.get(patch.name, 1.0)
        table.append(reflected + scene.gloss + added.get(patch.name, 0.0))
    boxes = [patch.box for patch in target.patches]
    label = np.zeros((rows + 2 * HALO_PX, cols + 2 * HALO_PX), np.intp)
    if target.background is not None and target.outline is not None:
        table.append(np.maximum(scene.reflectance(target.background) + scene.surround, 0))
        label[:] = len(table) - 1
        _fill(label, target.outline, 0, top, left)
    for number, box in enumerate(boxes, 1):
        _fill(label, box, number, top, left)
    return SpectralPicture.of_labels(label, np.array(table).T, HALO_PX)


def _mirrored(highlight: Highlight, context: Context) -> Float:
    """Reflectance (1, rows, cols) of a highlight over the shot's window."""
    rows, cols = context.shot_shape()
    row, col = context.place_in_shot()
    x, y = (col - (cols - 1) / 2) / max(cols / 2, 1), (row - (rows - 1) / 2) / max(rows / 2, 1)
    distance2 = ((x - highlight.place[0]) ** 2 + (y - highlight.place[1]) ** 2) / highlight.width**2
    return np.asarray(highlight.level * np.exp(-distance2 / 2)[None])


def _fill(label: NDArray[np.intp], box: RoiLike, number: int, top: int, left: int) -> None:
    """Write ``number`` into a box of the shot's window; ``label`` begins at row ``top``, column ``left`` of it."""
    row0, row1, col0, col1 = box
    label[max(row0 - top, 0) : max(row1 - top, 0), max(col0 - left, 0) : max(col1 - left, 0)] = number


def _edge_layers(scene: Scene, context: Context) -> list[Layer]:
    target = scene.target
    assert isinstance(target, EdgeTarget)
    dark = scene.white * np.maximum(scene.reflectance(target.dark_reflectance) + scene.black, 0)
    bright = scene.white * scene.reflectance(target.bright_reflectance)
    field = target_field(scene, context)
    edge = StraightEdge(_normal(target), *_relative(target.offset_px, context), falling=target.dark_side == "high")
    return [Layer(dark[:, None, None], gain=field), Layer((bright - dark)[:, None, None], edge, field)]


def _relative(offset_px: tuple[float, float], context: Context) -> tuple[Float, Float]:
    """Row and column of the pixels from a point that lies ``offset_px`` from the shot's middle."""
    rows, cols = context.shot_shape()
    row, col = context.place_in_shot()
    return row - (rows - 1) / 2 - offset_px[0], col - (cols - 1) / 2 - offset_px[1]


def _normal(target: EdgeTarget) -> tuple[float, float]:
    """Unit normal (row, col) of an edge, towards higher columns (vertical) or rows (horizontal)."""
    tilt = np.deg2rad(target.angle_deg)
    if target.orientation == "vertical":
        return (-float(np.sin(tilt)), float(np.cos(tilt)))
    return (float(np.cos(tilt)), -float(np.sin(tilt)))


@dataclass(frozen=True, eq=False)
class StraightEdge:
    """A unit step across a straight edge through the origin; exact for any transfer function.

    ``row_px`` (rows, 1) and ``col_px`` (1, cols) are the pixels' places from a point of the edge.

    The edge spread function is the integral of ``OTF(f n)`` along the edge normal n,
    ``ESF(d) = 1/2 + int_0^inf 2 Re[OTF(f n) exp(2 pi i f d)] / (2 pi i f) df``, computed once per
    band on a fine line and interpolated at the distance of each pixel.
    """

    normal: tuple[float, float]
    row_px: Float
    col_px: Float
    falling: bool = False

    def moved(self, down_px: Float, right_px: Float) -> StraightEdge:
        """The edge shifted by so much at each pixel (distortion)."""
        return replace(self, row_px=self.row_px - down_px, col_px=self.col_px - right_px)

    def distance_px(self) -> Float:
        """Distance (rows, cols) of each pixel's centre from the edge, along the normal."""
        distance = self.row_px * self.normal[0] + self.col_px * self.normal[1]
        return np.asarray(-distance if self.falling else distance)

    def sample(self, amplitude: Float, transfer: Transfer | None, wavelength_nm: Float | None) -> Float:
        """The blurred step times ``amplitude``, (bands, rows, cols)."""
        distance = self.distance_px()
        if transfer is None:
            return np.asarray(amplitude * np.clip(distance + 0.5, 0, 1)[None])
        nodes, weights = wavelength_nodes(np.array([550.0]) if wavelength_nm is None else wavelength_nm)
        steps = self._steps(np.eye(nodes.size), transfer, nodes)
        return np.asarray(amplitude * np.tensordot(weights.T, steps, axes=1))

    def mixed(self, weights: Float, transfer: Transfer | None, wavelength_nm: Float | None) -> Float:
        """Sums of the blurred step over the bands, with ``weights`` (channels, bands): (channels, rows, cols)."""
        if transfer is None:
            return np.asarray(weights.sum(axis=1)[:, None, None] * self.sample(np.ones((1, 1, 1)), None, None))
        nodes, shares = wavelength_nodes(np.array([550.0]) if wavelength_nm is None else wavelength_nm)
        return self._steps(weights @ shares.T, transfer, nodes)

    def _steps(self, mix: Float, transfer: Transfer, nodes: Float) -> Float:
        """Sums of the steps at the nodes with weights ``mix`` (sums, nodes), (sums, rows, cols)."""
        distance = self.distance_px()
        position, curves = self._edge_spread(transfer, nodes, float(np.abs(distance).max()))
        place = (distance - position[0]) / (position[1] - position[0])
        place = np.clip(place, 1, position.size - 3)
        index = place.astype(np.intp)
        return _cubic(mix @ curves, index, place - index)

    def _edge_spread(self, transfer: Transfer, wavelength_nm: Float, reach_px: float) -> tuple[Float, Float]:
        sign = -1.0 if self.falling else 1.0
        n = int(2 * ESF_HALF_PX / ESF_STEP_PX)
        frequency: Float = np.asarray(np.fft.rfftfreq(n, ESF_STEP_PX))
        coarse = np.unique(np.concatenate([np.linspace(0, 0.1, 65), np.linspace(0.1, 2.0, 153), np.linspace(2.0, 8.0, 97)]))
        fy, fx = sign * coarse * self.normal[0], sign * coarse * self.normal[1]
        otf = np.asarray(transfer(fx[None, :], fy[None, :], wavelength_nm[:, None]))
        otf = np.broadcast_to(otf, (wavelength_nm.size, coarse.size))
        position: Float = np.asarray((np.arange(n) - n // 2) * ESF_STEP_PX)
        key = content_hash(otf)
        esf = _SPREADS.get(key)
        if esf is None:
            esf = _step_response(_interpolated(otf, coarse, frequency), frequency, position)
            _SPREADS.put(key, esf)
        keep = np.abs(position) <= min(reach_px + 8, ESF_HALF_PX - 16)
        return position[keep], np.ascontiguousarray(esf[:, keep])


_SPREADS = Remembered(SPREAD_BYTES)


def _step_response(full: Any, frequency: Float, position: Float) -> Float:
    """Edge spread functions (nodes, places) of transfer functions (nodes, frequencies), which are overwritten."""
    # the periodic line spread less its mean 1/P integrates to ESF - 1/2 - d/P
    full[:, 1:] /= 2j * np.pi * frequency[1:]
    full[:, 0] = 0
    wave = np.fft.fftshift(np.fft.irfft(full, position.size, axis=1), axes=1) / ESF_STEP_PX
    esf = 0.5 + position / (2 * ESF_HALF_PX) + wave
    esf -= (esf[:, :1] + esf[:, -1:] - 1) / 2  # a shifted (complex) transfer leaves a constant behind
    return np.asarray(esf)


def _interpolated(otf: Any, coarse: Float, frequency: Float) -> Any:
    """Smooth interpolation of a transfer function from a coarse to a fine frequency grid."""
    from scipy.interpolate import make_interp_spline

    return make_interp_spline(coarse, otf, k=3, axis=1)(frequency).astype(complex)


def _cubic(table: Float, index: NDArray[np.intp], t: Float) -> Float:
    """Cubic Lagrange interpolation of (bands, n) at (rows, cols) places: (bands, rows, cols)."""
    weights = (
        -t * (t - 1) * (t - 2) / 6,
        (t + 1) * (t - 1) * (t - 2) / 2,
        -(t + 1) * t * (t - 2) / 2,
        (t + 1) * t * (t - 1) / 6,
    )
    return np.asarray(sum(w * table[:, index + k - 1] for k, w in enumerate(weights)))
