"""The only importer of Mitsuba: plain scene dictionaries in, arrays out.

Run as ``python -m isetval.scenes.rendered.mitsuba_backend --probe VARIANT`` it is the child process of
:mod:`isetval.scenes.rendered.variants`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.errors import InputError
from isetval.scenes.rendered import ray_sensor
from isetval.scenes.rendered.lens_tables import LensTables
from isetval.scenes.rendered.spectra import band_feet_nm

Float = NDArray[np.float64]
Crop = tuple[int, int, int, int]
# fixed, or Mitsuba halves it where there are more threads than blocks, and the bits depend on the machine
BLOCK_PX = 16
NEAR_M, FAR_M = 1e-3, 1e4
SKY_REACH, SPECK_M = 10.0, 1e-5  # of the farthest corner; half the side of a speck, a hundredth of a pixel wide at 10 m


def load_mitsuba(variant: str, library: str = "") -> Any:
    """Mitsuba with ``variant`` active; ``library`` is the libLLVM that passed the probe."""
    if variant.startswith("llvm") and library:
        os.environ["DRJIT_LIBLLVM_PATH"] = library
    import mitsuba as mi

    if mi.variant() != variant:
        mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    return mi


def _numbers(values: Sequence[float]) -> str:
    return ",".join(repr(float(v)) for v in values)


def spectrum_plugin(spectrum: Mapping[str, Any]) -> dict[str, Any]:
    """A Mitsuba spectrum; values outside its range repeat the end values to 360 and 830 nm."""
    grid = [float(v) for v in spectrum["wavelength_nm"]]
    value = [float(v) for v in spectrum["values"]]
    if max(value) <= 0:  # Mitsuba refuses an irregular spectrum without any value above zero
        return {"type": "uniform", "value": 0.0}
    if grid[0] > 360:
        grid, value = [360.0, *grid], [value[0], *value]
    if grid[-1] < 830:
        grid, value = [*grid, 830.0], [*value, value[-1]]
    return _table(grid, value)


def _table(grid: Sequence[float], values: Sequence[float]) -> dict[str, Any]:
    """Straight lines between points; evenly spaced ones need no search, which halves the time of a whole render."""
    steps = np.diff(grid)
    if np.allclose(steps, steps[0], rtol=1e-9):
        return {"type": "regular", "wavelength_min": grid[0], "wavelength_max": grid[-1], "values": _numbers(values)}
    return {"type": "irregular", "wavelengths": _numbers(grid), "values": _numbers(values)}


def band_channels(wavelength_nm: Sequence[float]) -> dict[str, Any]:
    """Triangular channels of unit area, so that a channel is the mean radiance over its band."""
    low, high = (feet.tolist() for feet in band_feet_nm(wavelength_nm))
    channels = {}
    for i, (a, c, b) in enumerate(zip(low, map(float, wavelength_nm), high, strict=True)):
        top = 2 / (b - a)
        points = [(a, 0.0)] * (a < c) + [(c, top)] + [(b, 0.0)] * (b > c)
        grid, values = zip(*points, strict=True)
        channels[f"band_{i:03d}"] = _table(grid, values)
    return channels


def film_plugin(camera: Mapping[str, Any], crop: Crop, wavelength_nm: Sequence[float] | None) -> dict[str, Any]:
    """A film of the whole sensor cropped to (row0, col0, rows, cols); spectral, or for depth without bands."""
    row0, col0, rows, cols = crop
    film = {
        "width": int(camera["cols"]),
        "height": int(camera["rows"]),
        "crop_offset_x": col0,
        "crop_offset_y": row0,
        "crop_width": cols,
        "crop_height": rows,
        "rfilter": {"type": "box"},
        "component_format": "float32",
        "sample_border": False,
    }
    if wavelength_nm is None:
        return {"type": "hdrfilm", "pixel_format": "luminance", **film}
    return {"type": "specfilm", **film, **band_channels(wavelength_nm)}


def sensor_plugin(mi: Any, camera: Mapping[str, Any], film: dict[str, Any]) -> dict[str, Any]:
    """A pinhole or thin-lens camera whose picture stands upright: row 0 is up, column 0 is left."""
    width_mm = camera["cols"] * camera["pixel_um"] * 1e-3
    transform = mi.ScalarTransform4f().look_at(
        origin=list(camera["position_m"]), target=list(camera["look_at_m"]), up=list(camera["up"])
    )
    plugin = {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(width_mm / 2 / camera["focal_mm"]))),
        "fov_axis": "x",
        "near_clip": NEAR_M,
        "far_clip": FAR_M,
        "to_world": transform,
        "film": film,
        "sampler": {"type": ray_sensor.SAMPLER},
    }
    if camera.get("aperture_radius_mm", 0.0) > 0:
        plugin["type"] = "thinlens"
        plugin["aperture_radius"] = camera["aperture_radius_mm"] * 1e-3
        plugin["focus_distance"] = float(camera["focus_m"])
    return plugin


def shape_plugin(mi: Any, shape: Mapping[str, Any], spectra: Mapping[str, Any]) -> dict[str, Any]:
    """One shape of a scene dictionary as a Mitsuba plugin."""
    kinds = {"rectangle": "rectangle", "box": "cube", "sphere": "sphere", "ply": "ply", "obj": "obj"}
    plugin: dict[str, Any] = {"type": kinds[shape["type"]]}
    if "to_world" in shape:
        plugin["to_world"] = mi.ScalarTransform4f(np.asarray(shape["to_world"], float))
    if shape["type"] in ("ply", "obj"):
        plugin["filename"] = str(shape["file"])
        plugin["face_normals"] = bool(shape.get("face_normals", False))
    if shape.get("inside_out"):
        plugin["flip_normals"] = True
    reflectance = spectrum_plugin(spectra[shape["reflectance"]])
    plugin["bsdf"] = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}
    if "radiance" in shape and max(spectra[shape["radiance"]]["values"]) > 0:
        plugin["emitter"] = {"type": "area", "radiance": spectrum_plugin(spectra[shape["radiance"]])}
    return plugin


def _sky_markers(mi: Any, shapes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Two specks on either side of all shapes, that the sphere from which a surround shines holds them all.

    Mitsuba (3.9) measures that sphere by boxes around the shapes and leaves out rectangles that are turned: the rays that ask
    whether the surround is hidden ended before a box's far walls, and its corners were up to 45 % too bright.
    """
    places = np.array([shape.get("to_world", np.eye(4)) for shape in shapes], float)
    reach = float((np.abs(places[:, :3, :3]).sum(axis=2) + np.abs(places[:, :3, 3])).max(initial=0.0))
    out = {}
    for i, side in enumerate((-SKY_REACH, SKY_REACH)):
        place = mi.ScalarTransform4f().translate([0, side * max(reach, 1.0), 0]).scale([SPECK_M] * 3)
        out[f"speck_{i}"] = {"type": "cube", "to_world": place}
    return out


def build_scene(mi: Any, spec: Mapping[str, Any], *, sensor: dict[str, Any], integrator: dict[str, Any]) -> Any:
    """A loaded Mitsuba scene from a plain dictionary, a sensor and an integrator."""
    spectra = spec["spectra"]
    scene: dict[str, Any] = {"type": "scene", "integrator": integrator, "sensor": sensor}
    for i, shape in enumerate(spec["shapes"]):
        scene[f"shape_{i:04d}"] = shape_plugin(mi, shape, spectra)
    if spec.get("environment") and max(spectra[spec["environment"]]["values"]) > 0:
        scene["environment"] = {"type": "constant", "radiance": spectrum_plugin(spectra[spec["environment"]])}
        scene |= _sky_markers(mi, spec["shapes"]) if spec["shapes"] else {}  # of an open sky nothing is hidden
    try:
        return mi.load_dict(scene, parallel=False)
    except (RuntimeError, ValueError) as error:
        words = " ".join(str(error).split())[-300:]
        raise InputError(f"scene {spec.get('name', '')!r} cannot be built: {words}") from None


def path_integrator(bounces: int) -> dict[str, Any]:
    """Path tracing with ``bounces`` reflections at most (Mitsuba counts the emission as depth 1)."""
    return {"type": "path", "max_depth": int(bounces) + 1, "rr_depth": 1000, "block_size": BLOCK_PX}


class Tile:
    """A scene loaded once for one crop; ``radiance(seed, spp)`` renders one pass of it.

    Parameters
    ----------
    spec, camera : dict
        Plain descriptions, see :mod:`isetval.scenes.rendered.box` and :mod:`isetval.scenes.rendered.rendering`.
    crop : (row0, col0, rows, cols)
    wavelength_nm : sequence of float
    variant, library : str
        As chosen by :func:`isetval.scenes.rendered.variants.choose_variant`.
    lens : LensTables, optional
        Trace every ray through this lens; passes are then spectral irradiance, W/(m2 nm).
    """

    def __init__(
        self,
        spec: Mapping[str, Any],
        camera: Mapping[str, Any],
        *,
        crop: Crop,
        wavelength_nm: Sequence[float],
        variant: str,
        library: str = "",
        lens: LensTables | None = None,
    ) -> None:
        self._mi = load_mitsuba(variant, library)
        self._spec, self._camera, self._crop = spec, camera, crop
        film = film_plugin(camera, crop, wavelength_nm)
        if lens is None:
            sensor = sensor_plugin(self._mi, camera, film)
        else:
            import drjit

            ray_sensor.register(self._mi, drjit)
            sensor = ray_sensor.sensor_plugin(self._mi, lens, camera, film)
        self._scene = build_scene(self._mi, spec, sensor=sensor, integrator=path_integrator(spec["bounces"]))

    def radiance(self, seed: int, spp: int) -> Float:
        """Mean spectral radiance of one pass, (bands, rows, cols), W/(sr m2 nm); irradiance through a lens."""
        image = np.array(self._mi.render(self._scene, seed=seed, spp=spp), dtype=np.float64)
        return np.ascontiguousarray(np.moveaxis(image, -1, 0))

    def depth_m(self, seed: int = 0) -> Float:
        """Distance along the optical axis of what one ray through each pixel meets, (rows, cols); inf for nothing."""
        mi = self._mi
        camera = {**self._camera, "aperture_radius_mm": 0.0}
        sensor = sensor_plugin(mi, camera, film_plugin(camera, self._crop, None))
        integrator = {"type": "aov", "aovs": "p:position,d:depth", "block_size": BLOCK_PX}
        scene = build_scene(mi, self._spec, sensor=sensor, integrator=integrator)
        image = np.array(mi.render(scene, seed=seed, spp=1), dtype=np.float64)[..., -4:]
        eye = np.asarray(camera["position_m"], float)
        axis = np.asarray(camera["look_at_m"], float) - eye
        depth = (image[..., :3] - eye) @ (axis / np.linalg.norm(axis))
        return np.where(image[..., 3] > 0, depth, np.inf)


def probe(variant: str) -> bool:
    """Render 4 x 4 pixels with ``variant``; True if the numbers are finite and right."""
    mi = load_mitsuba(variant)
    band = {"type": "irregular", "wavelengths": "400,700", "values": "1,1"}
    wall = {"type": "diffuse", "reflectance": {"type": "irregular", "wavelengths": "360,830", "values": "0.5,0.5"}}
    film = {"type": "specfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}, "band": band}
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 4},
            "sensor": {"type": "perspective", "fov": 40, "film": film, "sampler": {"type": "independent"}},
            "light": {"type": "constant", "radiance": {"type": "irregular", "wavelengths": "360,830", "values": "1,1"}},
            "wall": {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, 5]), "bsdf": wall},
        }
    )
    image = np.array(mi.render(scene, spp=1, seed=0))
    return bool(image.shape[:2] == (4, 4) and np.all(np.isfinite(image)) and image.mean() > 0)


def main(arguments: Sequence[str]) -> int:
    """Entry of the probing child process."""
    if len(arguments) != 2 or arguments[0] != "--probe":
        sys.stderr.write("usage: python -m isetval.scenes.rendered.mitsuba_backend --probe VARIANT\n")
        return 2
    if not probe(arguments[1]):
        sys.stderr.write("error: the probe render gave impossible numbers\n")
        return 1
    sys.stdout.write("probe passed\n")
    sys.stdout.flush()
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
