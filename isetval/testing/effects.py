"""The battery of checks that every effect passes: in the catalogue and in packages of users."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.context import Context
from isetval.core.effect import STAGES, UNTOUCHED, Effect
from isetval.core.errors import InputError
from isetval.core.scene import ChartTarget, EdgeTarget, Patch, Scene, Spectrum
from isetval.core.sensor import Exposure, Sensor
from isetval.core.signal import UNITS, Signal

Array = NDArray[Any]
NO_BLACK = ((0.0, 0.0), (0.0, 0.0))
SENSOR = Sensor(400, 600, pixel_um=1.4, cfa="RGGB", black_dn=NO_BLACK, white_dn=1023, bits=10)
FILE_SENSOR = dataclasses.replace(SENSOR, black_dn=((64.0, 65.0), (66.0, 64.0)))
GRID_NM = np.array([440.0, 500.0, 560.0, 620.0, 710.0])
FIELD = (230, 340, 96, 160)
CROP = (257, 375, 40, 70)


def _need(good: Any, message: str) -> None:
    if not good:
        raise AssertionError(message)


def check_effect(effect: Effect) -> None:
    """Run the battery that every effect of the catalogue passes.

    Checked: stage, units, equation, reference, docstring, unit and text of every parameter; bounds
    refuse; the null is exactly the identity and the given (or a plausible) strength is not; the input
    is left as it was; single precision stays single; same seed, same bits; a sensor's pattern repeats
    in every frame and changes with the sensor, frame noise does neither and vanishes from the
    expectation; a crop sees what the whole field sees there; no hidden source of randomness is used.

    Parameters
    ----------
    effect : Effect
        With the parameters to try; a parameter at its null is moved by its plausible scale.

    Raises
    ------
    AssertionError
        With the effect's name, what was found and what is needed.
    """
    _check_declaration(type(effect))
    _check_bounds(effect)
    strong = _strong(effect)
    if strong.stage == "scene":
        _check_scene(strong)
    else:
        _check_null(strong)
        _check_signal(strong)
        _check_randomness(strong)
        _check_window(strong)


def _check_declaration(cls: type[Effect]) -> None:
    where = f"effect {cls.name or cls.__name__}"
    _need(cls.name and cls.name.isidentifier(), f"{where}: name is {cls.name!r}; a word of letters, digits and _ is needed")
    _need(cls.stage in STAGES, f"{where}: stage is {cls.stage!r}; it needs one of {', '.join(STAGES)}")
    _need(cls.random in ("none", "sensor", "frame"), f"{where}: random is {cls.random!r}; it needs none, sensor or frame")
    if cls.stage != "scene":
        _need({cls.acts_on, cls.gives} <= set(UNITS), f"{where}: acts_on {cls.acts_on!r}, gives {cls.gives!r}; units are {UNITS}")
    _need(
        set(cls.must_not_change) <= set(UNTOUCHED),
        f"{where}: must_not_change is {cls.must_not_change}; it needs some of {UNTOUCHED}",
    )
    own_doc = cls.__doc__ and not cls.__doc__.startswith(f"{cls.__name__}(")
    _need(own_doc and cls.equation and cls.reference, f"{where}: a docstring, an equation and a reference are needed")
    for info in cls.parameters():
        _need(info.unit and info.doc, f"{where}: {info.name} needs a unit and a line of text")
        _need(info.low <= info.null <= info.high, f"{where}: {info.name} has its null {info.null} outside its bounds")
        _need(info.tau is None or info.tau > 0, f"{where}: {info.name} has tau {info.tau}; a positive scale (or None) is needed")


def _check_bounds(effect: Effect) -> None:
    for info in effect.parameters():
        for value in (info.low - 1, info.high + 1, math.nan):
            if math.isinf(value):
                continue
            said = _refusal(effect, info.name, value)
            _need(info.name in said, f"effect {effect.name}: {info.name} = {value} is not refused by name; it says {said!r}")


def _refusal(effect: Effect, parameter: str, value: float) -> str:
    try:
        effect.changed(**{parameter: value})
    except InputError as error:
        return str(error)
    return ""


def _strong(effect: Effect) -> Effect:
    """The effect with parameters that stand at their null moved by their plausible scale."""
    moved = {
        info.name: min(info.null + info.tau, info.high) if info.null + info.tau > info.low else info.null
        for info in effect.own_parameters()
        if info.tau is not None and not info.shape and effect.values()[info.name] == info.null
    }
    return effect.changed(**moved)


def _null(effect: Effect) -> Effect:
    return effect.changed(**{info.name: info.null for info in effect.parameters() if not info.shape})


def _context(effect: Effect, **changes: Any) -> Context:
    settings: dict[str, Any] = {
        "sensor": FILE_SENSOR if effect.stage == "file" else SENSOR,
        "window": FIELD,
        "shot_window": FIELD,
        "exposure": Exposure(time_s=0.1),
        "shot": "check",
        "role": "edge",
        "frame": 3,
        "previous": np.linspace(100, 500, FIELD[2] * FIELD[3]).reshape(FIELD[2:]),
        "mean_irradiance": np.linspace(1, 2, GRID_NM.size),
    }
    return Context(**(settings | changes)).for_effect(effect.name, 0)


def _input(effect: Effect, context: Context, dtype: Any = np.float64) -> Signal:
    """A signal of the kind the effect acts on: an edge in light, a smooth pattern of charge or codes."""
    from isetval.effects.optics_blur import Aperture
    from isetval.scenes.planar import planar_radiance

    if effect.acts_on in ("radiance", "irradiance"):
        scene = Scene(GRID_NM, np.linspace(1, 2, GRID_NM.size), target=EdgeTarget("edge", angle_deg=8.0))
        radiance = planar_radiance(scene, context)
        return radiance if effect.acts_on == "radiance" else Aperture().apply(radiance, context)
    row0, col0, rows, cols = context.window
    row, col = np.mgrid[row0 : row0 + rows, col0 : col0 + cols]
    wave = np.sin(row / 7.0) * np.cos(col / 9.0)
    if effect.acts_on == "dn":
        values = (
            (80 + 40 * wave)[None]
            if effect.stage == "electronics"
            else np.rint(80 + 40 * wave + 9 * ((7 * row + 13 * col) % 5))[None]
        )
    else:
        channels = np.array([1, 2, 1.5]) if effect.stage == "pixel" else np.ones(1)
        values = channels[:, None, None] * (2000 + 1500 * wave)
    signal = Signal.of(values.astype(dtype), effect.acts_on)
    return dataclasses.replace(signal, chief_ray_deg=_chief_ray_deg)


def _chief_ray_deg(x_mm: Array, y_mm: Array) -> Array:
    """Chief rays of a lens whose exit pupil lies 0.5 mm before a sensor of a millimetre."""
    return np.degrees(np.arctan(np.hypot(x_mm, y_mm) / 0.5))


def _seen(signal: Signal, effect: Effect, context: Context) -> Array:
    """What a signal holds, (channels, rows, cols); light in front of the pixel is seen through a rising QE."""
    from isetval.effects.color import QuantumEfficiency

    class Rising(QuantumEfficiency):
        def curves(self, context: Context, wavelength_nm: Array) -> Array:
            return np.ones((3, 1)) * (wavelength_nm / 1000)[None]

    if effect.stage == "pixel" and signal.unit == "irradiance":
        signal = Rising().apply(signal, context)
    values = signal.values
    return np.broadcast_to(values, (values.shape[0], *context.window[2:]))


def _out(effect: Effect, *, dtype: Any = np.float64, **changes: Any) -> Array:
    context = _context(effect, **changes)
    return _seen(effect.apply(_input(effect, context, dtype), context), effect, context)


def _check_null(effect: Effect) -> None:
    if not effect.candidate or effect.acts_on != effect.gives:
        return  # what turns one unit into another cannot be the identity
    context = _context(effect)
    before = _seen(_input(effect, context), effect, context)
    after = _out(_null(effect))
    _need(np.array_equal(after, before), f"effect {effect.name}: its null is not the identity")
    _need(not np.array_equal(_out(effect), after), f"effect {effect.name}: {dict(effect.values())} changes nothing")


def _check_signal(effect: Effect) -> None:
    context = _context(effect)
    signal = _input(effect, context)
    before = [layer.amplitude.copy() for layer in signal.layers]
    after = effect.apply(signal, context)
    _need(after.unit == effect.gives, f"effect {effect.name}: gives {after.unit}, declares {effect.gives}")
    same = all(np.array_equal(a, layer.amplitude) for a, layer in zip(before, signal.layers, strict=True))
    _need(same, f"effect {effect.name}: it writes into the signal it was given; make a new one")
    _need(np.all(np.isfinite(after.values)), f"effect {effect.name}: values that are not finite")
    if effect.acts_on == effect.gives == "irradiance":
        stated = effect.apply(signal.filtered(leak=0.5), context).filters.leak - after.filters.leak
        _need(
            np.allclose(stated, 0.5),
            f"effect {effect.name}: what other effects state of the filters is lost; derive from the signal it got",
        )
        _need(after.wavelength_nm is not None, f"effect {effect.name}: the light has lost its wavelengths")
    if effect.stage in ("exposure", "electronics", "file"):
        single = _out(effect, dtype=np.float32).dtype
        _need(single == np.float32, f"effect {effect.name}: single precision becomes {single}; keep the signal's")


def _check_randomness(effect: Effect) -> None:
    name = f"effect {effect.name} (random: {effect.random})"
    state = _global_state()
    out = _out(effect)
    _need(np.array_equal(out, _out(effect)), f"{name}: the same seed gives other bits")
    _need(state == _global_state(), f"{name}: it draws from numpy's global state; use context.rng or context.fixed_normal")
    frame_changes = not np.array_equal(out, _out(effect, seed=1))
    sensor_changes = not np.array_equal(out, _out(effect, sensor_seed=1))
    expected_changes = not np.array_equal(_out(effect, mode="expected"), _out(effect, mode="expected", seed=1))
    _need(frame_changes == (effect.random == "frame"), f"{name}: another frame seed changes it: {frame_changes}")
    _need(sensor_changes or effect.random != "sensor", f"{name}: another sensor has the same pattern")
    _need(not sensor_changes or effect.random != "none", f"{name}: it depends on the sensor's seed")
    _need(not expected_changes, f"{name}: its expectation depends on the frame's seed")
    if effect.random == "sensor":
        _need(np.array_equal(out, _out(effect, frame=4)), f"{name}: the pattern changes from frame to frame")
    if effect.random == "frame":
        _need(not np.array_equal(out, _out(effect, frame=4)), f"{name}: two frames are the same")


def _global_state() -> str:
    return repr(np.random.get_state(legacy=False))  # noqa: NPY002


def _check_window(effect: Effect) -> None:
    if effect.random == "frame":
        return
    row, col, rows, cols = CROP
    halo = effect.halo_px
    crop = _out(effect, window=CROP)[:, halo : rows - halo, halo : cols - halo]
    top, left = row - FIELD[0] + halo, col - FIELD[1] + halo
    whole = _out(effect)[:, top : top + rows - 2 * halo, left : left + cols - 2 * halo]
    close = np.allclose(crop, whole, rtol=1e-9, atol=1e-9 * float(np.abs(whole).max()))
    _need(close, f"effect {effect.name}: a crop differs from the same place of the whole field; state halo_px or use the window")


def _check_scene(effect: Effect) -> None:
    changed = False
    for role, scene in _scenes():
        context = _context(effect, role=role, window=CROP, shot_window=CROP)
        before = _flat(scene)
        _need(_flat(_null(effect).apply_scene(scene, context)) == before, f"effect {effect.name}: its null changes a scene")
        after = _flat(effect.apply_scene(scene, context))
        _need(after == _flat(effect.apply_scene(scene, context)), f"effect {effect.name}: not the same twice")
        _need(_flat(scene) == before, f"effect {effect.name}: it writes into the scene it was given; use dataclasses.replace")
        changed = changed or after != before
    _need(changed, f"effect {effect.name}: {dict(effect.values())} changes no scene")


def _scenes() -> Iterator[tuple[str, Scene]]:
    white = np.linspace(1, 2, 8)
    grid = np.linspace(400, 720, 8)
    yield "flat", Scene(grid, white)
    yield "edge", Scene(grid, white, target=EdgeTarget("edge"))
    patch = Patch("white", (4, 20, 4, 20), Spectrum.flat(0.9))
    yield "chart", Scene(grid, white, target=ChartTarget("chart", (patch,)))


def _flat(thing: Any) -> Any:
    """A scene as nested tuples of plain numbers, for exact comparison; absent stray light counts as none."""
    if dataclasses.is_dataclass(thing) and not isinstance(thing, type):
        parts = {f.name: getattr(thing, f.name) for f in dataclasses.fields(thing)}
        return (type(thing).__name__, *((name, _flat(value)) for name, value in parts.items()))
    if isinstance(thing, np.ndarray):
        return tuple(thing.ravel().tolist())
    if isinstance(thing, tuple):
        return tuple(_flat(part) for part in thing)
    return tuple((name, _flat(thing[name])) for name in sorted(thing)) if isinstance(thing, dict) else thing
