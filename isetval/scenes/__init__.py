"""Scenes: analytic targets, and the spectral Cornell box rendered by Mitsuba 3.

Only :mod:`isetval.scenes.mitsuba_backend` imports Mitsuba, and only after the variant is chosen.
"""

from isetval._lazy import lazy_names

_NAMES = {
    "Render": "isetval.scenes.passes",
    "BoxParameters": "isetval.scenes.box",
    "NoiseTarget": "isetval.scenes.passes",
    "choose_variant": "isetval.scenes.variants",
    "cornell_box": "isetval.scenes.box",
    "load_scene": "isetval.scenes.scenefile",
    "render": "isetval.scenes.rendering",
    "wall_camera": "isetval.scenes.box",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
