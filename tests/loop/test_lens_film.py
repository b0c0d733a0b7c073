"""A film that stands elsewhere than the model says is named as the lens's own film shift."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isetval import diagnose, simulate
from isetval.camera.model_file import load_model
from isetval.core.campaign import Campaign, Light, Nuisance, Shot
from isetval.core.scene import EdgeTarget, Spectrum
from isetval.core.sensor import Exposure
from isetval.effects.ray_transfer import RayTransfer
from isetval.lens import default_lens
from isetval.lens.focus import film_for_object

pytestmark = pytest.mark.slow
WHITE = Light("white", Spectrum(np.array([390.0, 710.0]), np.array([0.0016, 0.0016])))
FIELD = ((1480, 1984), (1480, 60), (1480, 3900), (40, 60), (2900, 3900), (700, 900))
FILM_ERROR_UM = 10.0


def plan(sensor):
    """Darks, flats over the field, and edges through focus at two places, a metre away."""
    shots = [Shot(f"dark{t:g}", "dark", exposure=Exposure(time_s=t), window=(1480, 1984, 64, 64), frames=4) for t in (0.01, 0.2)]
    shots += [
        Shot(f"flat{t:g}", "flat", "center", exposure=Exposure(time_s=t), light="white", window=(1480, 1984, 64, 64), frames=2)
        for t in (0.004, 0.012, 0.03)
    ]
    shots += [
        Shot(f"field{i}", "flat", "field", exposure=Exposure(time_s=0.03), light="white", window=(*at, 64, 64), frames=2)
        for i, at in enumerate(FIELD)
    ]
    for place, at in (("c", (1472, 1976)), ("f", (500, 700))):
        for focus in (-8.0, 0.0, 8.0):
            shots.append(
                Shot(
                    f"edge_{place}{focus:g}",
                    "edge",
                    f"edge_{place}",
                    exposure=Exposure(time_s=0.02),
                    light="white",
                    window=(*at, 80, 80),
                    target=EdgeTarget("edge", angle_deg=5.0),
                    focus_um=focus,
                    distance_m=1.0,
                )
            )
    priors = (
        Nuisance("light_level", 0.02, "relative", "set-up", roles=("flat", "edge")),
        Nuisance("focus_um", 2.0, "um", "set-up", roles=("edge",)),
        Nuisance("light_tilt_x", 0.003, "relative", "measurement session", roles=("flat",)),
        Nuisance("light_tilt_y", 0.003, "relative", "measurement session", roles=("flat",)),
        Nuisance("edge_shift_px", 0.5, "px", "set-up", roles=("edge",)),
        Nuisance("edge_angle_deg", 0.1, "deg", "set-up", roles=("edge",)),
    )
    return Campaign("film", tuple(shots), lights={"white": WHITE}, nuisances=priors, sensor=sensor)


def test_a_hidden_film_position_is_named_with_its_strength(tmp_path):
    lens = replace(default_lens(), tables=(default_lens().table(550.0),), name="default-550")
    lens.save(tmp_path / "lens.json")
    nominal = load_model(Path(__file__).parents[2] / "data" / "pixel4a")
    film = film_for_object(lens, 1.0)
    effects = [e for e in nominal.effects if e.name not in RayTransfer.replaces]

    def camera(film_mm):
        return replace(nominal, effects=(RayTransfer(file="lens.json", base=str(tmp_path), film_mm=film_mm), *effects), path=None)

    captures = simulate(camera(film + 1e-3 * FILM_ERROR_UM), plan(nominal.sensor), seed=5, draw=True)
    found = diagnose(camera(film), captures, with_next_captures=False)
    assert [effect.name for effect in found.effects] == ["ray_transfer"]
    shift = found.effects[0].parameters["film_shift_um"]
    assert abs(shift.value - FILM_ERROR_UM) < 4 * shift.sigma
    assert shift.sigma < 2.0  # the prior of the two focus scales alone leaves 2 / sqrt(2) um
    for name, nominal_value in (("light_factor", 1.0), ("decenter_x_um", 0.0), ("decenter_y_um", 0.0)):
        other = found.effects[0].parameters[name]
        assert abs(other.value - nominal_value) < 4 * other.sigma
