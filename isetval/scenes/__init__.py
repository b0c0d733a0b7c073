"""Scenes: analytic targets, and the spectral Cornell box rendered by Mitsuba 3.

Only :mod:`isetval.scenes.rendered.mitsuba_backend` imports Mitsuba, and only after the variant is chosen.
"""

from isetval.core.lazy import lazy_names

_NAMES = {
    "BoxParameters": "isetval.scenes.rendered.box",
    "Irradiance": "isetval.scenes.rendered.accumulation",
    "NoiseTarget": "isetval.scenes.rendered.accumulation",
    "Render": "isetval.scenes.rendered.accumulation",
    "below_shot_noise": "isetval.scenes.rendered.stop_rule",
    "choose_variant": "isetval.scenes.rendered.variants",
    "cornell_box": "isetval.scenes.rendered.box",
    "electrons_per_radiance": "isetval.scenes.rendered.stop_rule",
    "image_space_irradiance": "isetval.scenes.through_lens.image_space",
    "lens_view": "isetval.scenes.rendered.lens_view",
    "load_scene": "isetval.scenes.rendered.scene_file",
    "parse_scene": "isetval.scenes.rendered.scene_file",
    "pupil_camera": "isetval.scenes.rendered.lens_view",
    "pupil_crop": "isetval.scenes.rendered.lens_view",
    "ray_space_irradiance": "isetval.scenes.through_lens.ray_space",
    "render": "isetval.scenes.rendered.rendering",
    "wall_camera": "isetval.scenes.rendered.box",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
