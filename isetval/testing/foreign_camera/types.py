"""The kinds of things that go through the foreign camera: numbers, targets, places in nature, the camera itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Float = NDArray[np.float64]
Codes = NDArray[np.uint16]
Window = tuple[int, int, int, int]
Curve = Callable[[Any], Any]
Hidden = Mapping[str, Mapping[str, Any]]

__all__ = ["Camera", "Chart", "Codes", "Curve", "Edge", "Float", "Generator", "Hidden", "Light", "Place", "Window"]


@dataclass(frozen=True)
class Edge:
    """A straight edge; ``angle_deg`` away from the column (vertical) or row axis, dark at small columns or rows."""

    name: str
    orientation: str
    angle_deg: float
    offset_px: tuple[float, float] = (0.0, 0.0)
    dark: float = 0.05
    bright: float = 0.8
    surround: float = 0.35


@dataclass(frozen=True)
class Chart:
    """Patches; boxes (row0, row1, col0, col1) in the window, reflectance curves by the same names."""

    name: str
    boxes: Mapping[str, tuple[int, int, int, int]]
    surround: float = 0.12
    curves: Mapping[str, Curve] = field(default_factory=dict)


@dataclass(frozen=True)
class Place:
    """One shot as nature has it: where, how long, under which light, with which unknowns."""

    name: str
    role: str
    window: Window
    time_s: float
    light: str = ""
    level: float = 1.0
    focus_um: float = 0.0
    target: Any = None
    unknown: Mapping[str, float] = field(default_factory=dict)
    frame: int = 0
    before_e: Any = 0.0

    def get(self, name: str) -> float:
        """Value of an unknown, 0 where it has none."""
        return self.unknown.get(name, 0.0)


@dataclass(frozen=True)
class Light:
    """What a perfect white on axis gives: photons per nm of one exposure, and the electrons per nm of each channel."""

    photons: Float
    spectral: Float
    radiance: Float


@dataclass(frozen=True)
class Camera:
    """The nominal camera's constants, and what is hidden in it (effect -> parameters)."""

    f_number: float
    focal_mm: float
    prnu: float
    dark_e_per_s: float
    well_e: float
    dsnu_e: float
    read_e: float
    gain: float
    black: float
    white: int
    qe: Float
    wave_f_number: float = 0.0
    pitch_um: float = 1.4
    rows: int = 3024
    cols: int = 4032
    specimen: int = 0
    focus_um: float = 0.0
    diffusion_px: float = 0.0
    pixel_px: float = 1.0
    step_dn: float = 1.0
    hidden: Hidden = field(default_factory=dict)
