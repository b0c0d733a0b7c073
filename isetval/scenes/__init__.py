"""Scenes: analytic targets, and the spectral Cornell box rendered by Mitsuba 3.

Only :mod:`isetval.scenes.render.mitsuba_backend` imports Mitsuba, and only after the variant is chosen.
"""

from isetval.core.lazy import lazy_names

_NAMES = {
    "BoxParameters": "isetval.scenes.render.box",
    "Irradiance": "isetval.scenes.render.render_passes",
    "NoiseTarget": "isetval.scenes.render.render_passes",
    "Render": "isetval.scenes.render.render_passes",
    "below_shot_noise": "isetval.scenes.render.noise_budget",
    "choose_variant": "isetval.scenes.render.variants",
    "cornell_box": "isetval.scenes.render.box",
    "electrons_per_radiance": "isetval.scenes.render.noise_budget",
    "image_space_irradiance": "isetval.scenes.through_lens.image_space",
    "lens_view": "isetval.scenes.render.lens_view",
    "load_scene": "isetval.scenes.render.scene_file",
    "parse_scene": "isetval.scenes.render.scene_file",
    "pupil_camera": "isetval.scenes.render.lens_view",
    "pupil_crop": "isetval.scenes.render.lens_view",
    "ray_space_irradiance": "isetval.scenes.through_lens.ray_space",
    "render": "isetval.scenes.render.rendering",
    "wall_camera": "isetval.scenes.render.box",
}
__all__ = sorted(_NAMES)
__getattr__, __dir__ = lazy_names(__name__, _NAMES)
