"""What can be hidden, how strongly it is met in practice, and what a right answer would say.

``strength`` 1 is the size met in practice; other strengths are set so that an effect stands out by a wanted number of
sigmas (`strengths.json`, measured by ``analyses/hidden_effects.py --calibrate``): s = s_1 strength^power.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from .types import Camera

KINDS = ("effect", "form", "outsider")
DARK, LIT, FIELD, EDGES, CHARTS = "dark", "flat", "field", "edge", "chart"
OWN = "own choice"
Values = Callable[[Mapping[str, Any], Camera], dict[str, float]]


@dataclass(frozen=True)
class Concealed:
    """Something that can be hidden.

    ``name`` is what the catalogue calls it ("" for outsiders), ``also`` further names of the same class (no capture of
    the plans separates them; ``also_small``: none of darks and flats) or, for outsiders, names that would be right if a
    catalogue held them; ``values`` gives the catalogue's parameters where both descriptions mean the same number;
    ``practice`` where its size comes from.
    """

    key: str
    kind: str
    name: str
    amplitude: Mapping[str, Any]
    practice: str
    seen: str = LIT
    power: float = 1.0
    fixed: Mapping[str, Any] = field(default_factory=dict)
    values: Values | None = None
    also: tuple[str, ...] = ()
    also_small: tuple[str, ...] = ()
    scaled: bool = True

    def parameters(self, strength: float, camera: Camera) -> dict[str, Any]:
        """The foreign camera's parameters at a strength."""
        out: dict[str, Any] = dict(self.fixed)
        for key, size in self.amplitude.items():
            if self.key in FROM_NOMINAL and key == FROM_NOMINAL[self.key][0]:
                out[key] = getattr(camera, FROM_NOMINAL[self.key][1]) * (1 + strength * size)
            else:
                out[key] = tuple(strength * part for part in size) if isinstance(size, tuple) else strength * size
        return out

    def truth(self, parameters: Mapping[str, Any], camera: Camera) -> dict[str, float]:
        """The catalogue's parameters, where it means the same by them."""
        return {} if self.values is None else self.values(parameters, camera)


# constants of the camera that are wrong by a share of themselves
FROM_NOMINAL = {
    "conversion_gain": ("gain_dn_per_e", "gain"),
    "full_well": ("well_e", "well_e"),
    "diffraction": ("f_number", "f_number"),
    "pixel_aperture": ("width_px", "pixel_px"),
}
