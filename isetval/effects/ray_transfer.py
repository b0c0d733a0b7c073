"""A lens from a file in the light path: its light over the field, its traced blur, its chief rays."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import Effect, parameter, table_file
from isetval.core.errors import InputError
from isetval.core.signal import Layer, Signal
from isetval.core.toml import resolve_path
from isetval.effects.pupil import CircularPupil, by_dispersion, field_point, thin_lens_shift_um
from isetval.lens.field_table import field_table
from isetval.lens.focus import film_for_object, object_for_film
from isetval.lens.illumination import effective_f_number
from isetval.lens.lens_file import open_lens
from isetval.lens.measured_lens import MeasuredLens, read_measured_lens
from isetval.lens.ray_transfer import RayTransferLens
from isetval.lens.spot_table import SpotTable, spot_table
from isetval.scenes.rendered.lens_view import LensView, lens_view
from isetval.scenes.rendered_target import RenderedScene

Float = NDArray[np.float64]
REACH_STEP_MM, DECENTER_MM = 0.05, 0.3  # tables end beyond the corner by the largest decentre, at a whole step
FEW = 4096  # frequencies of which the transfer function is kept: those of edges; pictures keep their blurred parts


@dataclass(frozen=True)
class TracedPupil:
    """The pupil of a lens file at one field point: transfer functions from traced rays.

    Parameters
    ----------
    lens : RayTransferLens
    reach_mm : float
        Largest field height of the tables.
    object_m : float
        Object to front vertex.
    film_mm : float
        Film to rear vertex.
    point_mm : (x, y)
        Field point from the lens's axis.
    pixel_um : float
    focus_um : float
        Further shift of the film away from the lens.
    red_um, blue_um : float
        Further focus shift at 610 and 460 nm relative to 540 nm.
    """

    lens: RayTransferLens
    reach_mm: float
    object_m: float
    film_mm: float
    point_mm: tuple[float, float]
    pixel_um: float
    focus_um: float = 0.0
    red_um: float = 0.0
    blue_um: float = 0.0

    def adjusted(self, **added: float) -> TracedPupil:
        """The pupil with further focus shifts; InputError for the aberrations of a circular pupil."""
        if other := set(added) - {"focus_um", "red_um", "blue_um"}:
            raise InputError(
                f"{sorted(other)[0]} cannot be added to the traced rays of lens '{self.lens.name}', which have aberrations and "
                "diffraction of their own; take that effect out, or ray_transfer"
            )
        return replace(self, **{name: getattr(self, name) + value for name, value in added.items()})

    def transfer(self, fx: Float, fy: Float, wavelength_nm: Float) -> Float:
        """Transfer function at (fx, fy) in cycles/pixel and wavelength in nm; arguments broadcast; complex."""
        table = spot_table(self.lens, self.object_m, self.reach_mm)
        per_mm = 1e3 / self.pixel_um
        waves = np.asarray(wavelength_nm, float)
        shape = np.broadcast_shapes(np.shape(fx), np.shape(fy), waves.shape)
        x, y = np.asarray(fx, float) * per_mm, np.asarray(fy, float) * per_mm
        if waves.ndim == 0:
            return cast(Float, np.broadcast_to(self._at(table, x, y, float(waves)), shape))
        parts = [self._at(table, x[0], y[0], float(w)) for w in waves.ravel()]
        return cast(Float, np.array(parts).reshape(shape))

    def _at(self, table: SpotTable, fx: Float, fy: Float, wavelength_nm: float) -> NDArray[np.complex128]:
        """One wavelength."""
        shift_um = self.focus_um + float(by_dispersion(wavelength_nm, self.red_um, self.blue_um))
        film = round(self.film_mm + 1e-3 * shift_um, 7)
        if max(fx.size, fy.size) > FEW or fx.ndim > 1:
            return table.otf(fx, fy, point_mm=self.point_mm, film_mm=film, wavelength_nm=wavelength_nm)
        return _line(table, self.point_mm, film, wavelength_nm, fx.tobytes(), fy.tobytes())


@lru_cache(maxsize=4096)
def _line(
    table: SpotTable, point_mm: tuple[float, float], film_mm: float, wavelength_nm: float, fx: bytes, fy: bytes
) -> NDArray[np.complex128]:
    """Transfer function along a line of frequencies, kept: most candidates of a diagnosis leave the lens alone."""
    x, y = np.frombuffer(fx), np.frombuffer(fy)
    out = table.otf(x, y, point_mm=point_mm, film_mm=film_mm, wavelength_nm=wavelength_nm)
    out.flags.writeable = False
    return out


@dataclass(frozen=True)
class MeasuredPupil:
    """The pupil of a lens that is known by measured MTF curves, with geometric defocus of a circular pupil."""

    lens: MeasuredLens
    point_mm: tuple[float, float]
    defocus: CircularPupil

    def adjusted(self, **added: float) -> MeasuredPupil:
        """The pupil with further focus shifts; InputError for aberrations, which the curves contain."""
        if other := set(added) - {"focus_um", "red_um", "blue_um"}:
            raise InputError(
                f"{sorted(other)[0]} cannot be added to the measured MTF of lens table {self.lens.name}, which contains it; take "
                "that effect out, or ray_transfer"
            )
        return replace(self, defocus=self.defocus.adjusted(**added))

    def transfer(self, fx: Float, fy: Float, wavelength_nm: Float) -> Float:
        """Transfer function at (fx, fy) in cycles/pixel and wavelength in nm; arguments broadcast."""
        x, y = self.point_mm
        r = math.hypot(x, y)
        out, side = (x / r, y / r) if r > 0 else (1.0, 0.0)
        per_mm = 1e3 / self.defocus.pixel_um
        radial, across = (fx * out + fy * side) * per_mm, (fy * out - fx * side) * per_mm
        return np.asarray(self.lens.transfer(radial, across, r_mm=r) * self.defocus.transfer(fx, fy, wavelength_nm))


@dataclass(frozen=True, kw_only=True)
class RayTransfer(Effect):
    """A lens from a file: light by field height, transfer function of the traced pupil, chief ray angle.

    ``file`` is an ISET ray-transfer JSON, a prescription (``.toml``) or a measured table (``.csv``: see
    `isetval.lens.measured_lens.read_measured_lens`).  Stands in the place of aperture, diffraction, cos4, defocus and the
    aberrations of a circular pupil, which a model must not hold beside it; field_curvature, sensor_tilt and axial_color
    move its film.

    The film stands at ``film_mm`` (film to rear vertex, whatever a shot's ``focus_m`` says), or where the lens focuses
    the shot's ``focus_m``, else ``focus_distance_m``, else the target itself; the shot's ``focus_um``, its focus
    nuisance and ``film_shift_um`` come on top.  The object is at the shot's ``distance_m``, else where the film is in
    focus.  One point spread per shot, that of the window's middle.  The light factor is the *named* place for a file
    whose pupil is too small; it does not change the blur.  A measured MTF holds at best focus; defocus multiplies it.
    Rendered scenes are imaged as a whole, with the lens's distortion and a blur by field and depth (a decentre moves
    their light, not their geometry); a measured table blurs their pinhole picture.
    """

    name = "ray_transfer"
    stage = "optics"
    acts_on = "radiance"
    gives = "irradiance"
    order = 0.0
    absent = "models whose lens is given by numbers"
    imitated_by = (
        "cos4",
        "vignetting",
        "defocus",
        "field_curvature",
    )
    equation = "E = L light_factor integral cos^4(theta)/z^2 dA; OTF = diffraction x sum w exp(-2 pi i f p)"
    reference = "Goossens, Lyu, Ko, Wan, Farrell & Wandell, Ray-transfer functions, Opt. Express 30 (2022) 24031"
    must_not_change = ("dark",)
    replaces = ("aperture", "diffraction", "defocus", "spherical", "coma", "astigmatism", "cos4")

    file: str = table_file("lens: ray-transfer JSON, prescription TOML or measured CSV table")
    film_mm: float = parameter(0.0, unit="mm", low=0.0, high=1000.0, shape=True, doc="film to rear vertex (0: from the focus)")
    focus_distance_m: float = parameter(
        0.0, unit="m", low=0.0, high=1e6, shape=True, doc="distance in focus of shots that state none (0: the target's)"
    )
    light_factor: float = parameter(1.0, unit="1", low=0.01, high=100.0, tau=0.05, doc="stated correction of the file's light")
    film_shift_um: float = parameter(
        0.0, unit="um", low=-200.0, high=200.0, tau=5.0, doc="film away from the lens by so much more"
    )
    decenter_x_um: float = parameter(
        0.0, unit="um", low=-300.0, high=300.0, tau=30.0, doc="lens axis from the sensor's middle, x"
    )
    decenter_y_um: float = parameter(
        0.0, unit="um", low=-300.0, high=300.0, tau=30.0, doc="lens axis from the sensor's middle, y"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.film_mm and self.focus_distance_m:
            raise InputError(
                f"effect ray_transfer: film_mm is {self.film_mm:g} and focus_distance_m {self.focus_distance_m:g}; "
                "one follows from the other: state one"
            )

    def lens(self, context: Context) -> tuple[RayTransferLens | MeasuredLens, float]:
        """The lens and the field height that its tables reach; InputError if no file is named."""
        if not self.file:
            raise InputError(
                'effect ray_transfer: file is empty; name a lens, for example file = "isetval:lens/default_lens.json"'
            )
        reach = context.sensor.half_diagonal_mm + DECENTER_MM
        reach = math.ceil(reach / REACH_STEP_MM) * REACH_STEP_MM
        return open_lens(resolve_path(self.file, Path(self.base)), reach_mm=reach), round(reach, 6)

    def states_chief_ray(self) -> bool:
        """All lens files but tables without rows of it."""
        path = resolve_path(self.file, Path(self.base))
        return path.suffix.lower() != ".csv" or read_measured_lens(path).chief_ray is not None

    def focus_shift_um(self, context: Context) -> float:
        """The film's."""
        return self.film_shift_um

    def apply(self, signal: Signal, context: Context) -> Signal:
        """Irradiance behind the lens, imaged by the pupil of the window's middle."""
        lens, reach = self.lens(context)
        if isinstance(lens, MeasuredLens):
            return self._measured(signal, context, lens)
        film, object_m = self._film_and_object(lens, context)
        film = round(film + 1e-3 * self._shift_um(context), 7)
        table = field_table(lens, reach)
        light = table.irradiance(self._radius_mm(*context.xy_mm()), film_mm=film, wavelength_nm=signal.wavelength_nm)
        pupil: Any = TracedPupil(lens, reach, object_m, film, self._point_mm(context), context.sensor.pixel_um)
        angle = partial(self._chief_ray_deg, curve=partial(table.chief_ray_angle_deg, film_mm=film))
        if any(isinstance(layer.structure, RenderedScene) for layer in signal.layers):
            pupil = CircularPupil(float(effective_f_number(lens, film_mm=film)), context.sensor.pixel_um)  # of further defocus
            view = _view(lens, film, context.sensor.half_diagonal_mm)
            centred = table.irradiance(np.asarray(np.hypot(*context.xy_mm())), film_mm=film)
            moved = table.irradiance(self._radius_mm(*context.xy_mm()), film_mm=film) / centred
            layers = tuple(_imaged(layer, view, light * self.light_factor, moved * self.light_factor) for layer in signal.layers)
            return replace(signal, layers=layers, unit="irradiance", pupil=pupil, chief_ray_deg=angle)
        return replace(signal.scaled(light * self.light_factor), unit="irradiance", pupil=pupil, chief_ray_deg=angle)

    def _measured(self, signal: Signal, context: Context, lens: MeasuredLens) -> Signal:
        """The same from measured curves."""
        if self.film_mm:
            raise InputError(
                f"effect ray_transfer: film_mm is stated, but {lens.name} is a table, which knows none; take film_mm out"
            )
        focus_m = context.exposure.focus_m or self.focus_distance_m or None
        shift = thin_lens_shift_um(lens.focal_mm or 0.0, focus_m, context.object_distance_m) + self._shift_um(context)
        pupil: Any = CircularPupil(lens.f_number, context.sensor.pixel_um, focus_um=shift)
        if lens.mtf:
            pupil = MeasuredPupil(lens, self._point_mm(context), pupil)
        else:
            pupil = pupil.adjusted(diffraction_f_number=lens.f_number)
        light = lens.irradiance(self._radius_mm(*context.xy_mm()))[None] * self.light_factor
        angle = None if lens.chief_ray is None else partial(self._chief_ray_deg, curve=lens.chief_ray_angle_deg)
        return replace(signal.scaled(light), unit="irradiance", pupil=pupil, chief_ray_deg=angle)

    def _film_and_object(self, lens: RayTransferLens, context: Context) -> tuple[float, float]:
        """Film to rear vertex in mm and object to front vertex in m, before any shift."""
        if self.film_mm:
            return self.film_mm, context.object_distance_m or _focused(lens, self.film_mm)
        stated = context.exposure.focus_m or self.focus_distance_m or None
        object_m = context.object_distance_m or stated or math.inf
        return _film(lens, stated or object_m), object_m

    def _shift_um(self, context: Context) -> float:
        """Film shift from the shot's focus scale and this effect."""
        return context.focus_um + context.get("focus_um") + self.film_shift_um

    def _point_mm(self, context: Context) -> tuple[float, float]:
        """The window's middle from the lens's axis."""
        x, y = field_point(context)
        half = context.sensor.half_diagonal_mm
        return round(x * half - 1e-3 * self.decenter_x_um, 7), round(y * half - 1e-3 * self.decenter_y_um, 7)

    def _radius_mm(self, x_mm: Float, y_mm: Float) -> Float:
        """Distance of film places from the lens's axis."""
        return np.asarray(np.hypot(x_mm - 1e-3 * self.decenter_x_um, y_mm - 1e-3 * self.decenter_y_um))

    def _chief_ray_deg(self, x_mm: Float, y_mm: Float, *, curve: Any) -> Float:
        """Chief ray angle at film places."""
        return np.asarray(curve(self._radius_mm(x_mm, y_mm)))


def _imaged(layer: Layer, view: LensView, light: Float, moved: Float) -> Layer:
    """A layer of a rendered scene behind the lens: the scene is imaged as a whole, a decentre moves its light alone."""
    if isinstance(layer.structure, RenderedScene):
        return replace(layer, structure=layer.structure.through(view)).scaled(moved)
    return layer.scaled(light)


@lru_cache(maxsize=16)
def _view(lens: RayTransferLens, film_mm: float, half_diagonal_mm: float) -> LensView:
    """Where the lens looks, with room for the margins of rendered windows; kept."""
    return lens_view(lens, film_mm=film_mm, reach_mm=1.05 * half_diagonal_mm + DECENTER_MM)


@lru_cache(maxsize=64)
def _film(lens: RayTransferLens, object_m: float) -> float:
    """Best film distance for an object, kept."""
    return film_for_object(lens, object_m)


@lru_cache(maxsize=64)
def _focused(lens: RayTransferLens, film_mm: float) -> float:
    """Object distance that a film distance focuses, kept."""
    return object_for_film(lens, film_mm)
