"""Scenes: analytic targets, and the spectral Cornell box rendered by Mitsuba 3.

Only :mod:`isetval.scenes.mitsuba_backend` imports Mitsuba, and only after the variant is chosen.
"""

from isetval._lazy import lazy_names

_NAMES = {
    "BoxParameters": "isetval.scenes.box",
    "Irradiance": "isetval.scenes.passes",
    "NoiseTarget": "isetval.scenes.passes",
    "Render": "isetval.scenes.passes",
    "below_shot_noise": "isetval.scenes.budget",
    "choose_variant": "isetval.scenes.variants",
    "cornell_box": "isetval.scenes.box",
    "electrons_per_radiance": "isetval.scenes.budget",
    "image_space_irradiance": "isetval.scenes.image_space",
    "lens_view": "isetval.scenes.views",
    "load_scene": "isetval.scenes.scenefile",
    "parse_scene": "isetval.scenes.scenefile",
    "pupil_camera": "isetval.scenes.views",
    "pupil_crop": "isetval.scenes.views",
    "ray_space_irradiance": "isetval.scenes.ray_space",
    "render": "isetval.scenes.rendering",
    "wall_camera": "isetval.scenes.box",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
