"""What the frames of an EMVA 1288 descriptor say of themselves: saturation, parts of the series, flicker, the camera."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from isetval.core.campaign import Campaign, Nuisance, Shot
from isetval.core.sensor import Window
from isetval.files.emva_camera import numbers_of
from isetval.files.emva_descriptor import FEWEST_OF_A_STACK

# of a part: the bend of a response and the growth of darks show in so many; each is simulated thousands of times
LEVELS, DARKS = 6, 3
PARTS = ("learn", "confirm", "judge")
LOOKED_AT = 2**17  # pixels of a shot: a variance is known to .4 %, and a diagnosis costs in proportion
PHOTONS = 0.03  # ours: photodiodes come calibrated to 3 %, and the format states no error of its photon numbers
EVEN = 0.02  # ours: EMVA 1288 (R4.0, 6.1) asks for light that is even to 3 % from the darkest to the brightest place
LEAST_FLICKER = 1e-4  # a prior of 0 would say that a lamp is perfectly steady
LEAST_BLACK_DN = 1e-3  # a prior of 0 would say that darks are rounded without error


def dealt(campaign: Campaign) -> dict[str, Campaign]:
    """Parts of the series: ``learn``, ``confirm`` and ``judge``.

    The first two take neighbours of about `LEVELS` levels and `DARKS` darks over the whole range, the third the others and the
    stacks.  Levels beyond saturation, where the variance is largest (EMVA 1288 R4.0, 6.6), are in none of them.
    """
    series = [s for s in campaign.shots if s.frames < FEWEST_OF_A_STACK]
    flats = sorted((s for s in series if s.role == "flat"), key=lambda s: s.photons_per_pixel or 0.0)
    darks = sorted((s for s in series if s.role == "dark"), key=lambda s: s.exposure.time_s or 0.0)
    saturated = beyond_saturation(campaign, flats)
    places = {s.name: "" for s in saturated}
    for shots, wanted in (([s for s in flats if s.name not in places], LEVELS), (darks, DARKS)):
        step = max(2, round(len(shots) / wanted))
        places |= {s.name: PARTS[min(i % step, 2)] for i, s in enumerate(shots)}
    return {part: campaign.only(s.name for s in campaign.shots if places.get(s.name, PARTS[2]) == part) for part in PARTS}


def beyond_saturation(campaign: Campaign, flats: Sequence[Shot]) -> list[Shot]:
    """The levels brighter than that of the largest temporal variance."""
    variances = [temporal_variance(campaign, shot) for shot in flats]
    if not any(math.isfinite(v) for v in variances):
        return []
    return list(flats[int(np.nanargmax(variances)) + 1 :])


def temporal_variance(campaign: Campaign, shot: Shot) -> float:
    """Half the variance of the difference of a shot's first two frames, DN^2; nan with fewer."""
    frames = [c.mosaic for _, c in zip(range(2), campaign.captures[shot.name], strict=False)]
    return float(np.var(np.subtract(*frames, dtype=float))) / 2 if len(frames) == 2 else math.nan


def flicker(campaign: Campaign) -> float:
    """Relative standard deviation of the light from frame to frame: scatter of frame means less that of pixel noise."""
    squares = []
    black = campaign.sensor.black_dn[0][0] if campaign.sensor else 0.0
    flats = [s for s in campaign.shots if s.role == "flat" and s.frames < FEWEST_OF_A_STACK]
    for shot in flats[: len(flats) - len(beyond_saturation(campaign, flats))]:
        frames = campaign.captures[shot.name]
        means = np.array([float(c.mosaic.mean()) - black for c in frames])
        if means.size > 1 and means.min() > 0:
            noise = temporal_variance(campaign, shot) / frames[0].mosaic.size
            squares.append((float(means.var(ddof=1)) - noise) / float(means.mean()) ** 2)
    return max(math.sqrt(max(float(np.median(squares)), 0.0) / 0.455), LEAST_FLICKER) if squares else LEAST_FLICKER


def black_sigma_dn(campaign: Campaign) -> float:
    """Error of the mean of the shortest darks, DN, from what the frame means of all darks scatter by (rows add to pixels)."""
    darks = [s for s in campaign.shots if s.role == "dark"]
    means = [np.array([float(c.mosaic.mean()) for c in campaign.captures[s.name]]) for s in darks]
    pooled = [float(m.var(ddof=1)) for m in means if m.size > 1]
    shortest = min(darks, key=lambda s: s.exposure.time_s or 0.0)
    return max(math.sqrt(float(np.mean(pooled)) / shortest.frames) if pooled else 0.0, LEAST_BLACK_DN)


def priors(campaign: Campaign) -> tuple[tuple[Nuisance, ...], list[str]]:
    """What a laboratory of the standard does not know of its light and black level, and the reason of each."""
    steady, black_dn = flicker(campaign), black_sigma_dn(campaign)
    out = [
        Nuisance("light_level", PHOTONS, "relative", "campaign", roles=("flat",)),
        Nuisance("light_level", steady, "relative", "frame", roles=("flat",)),
        *(Nuisance(f"light_{k}", EVEN, "relative", "campaign", roles=("flat",)) for k in ("tilt_x", "tilt_y", "bow_x", "bow_y")),
        Nuisance("black_level.offset_dn", black_dn, "DN", "campaign"),
    ]
    words = [
        f"light_level of the campaign, {PHOTONS:g}: the photon numbers' scale; photodiodes come calibrated to 3 %",
        f"light_level of a frame, {steady:.2g}: scatter of frame means of one level beyond their pixel noise",
        f"light_tilt_x, light_tilt_y, light_bow_x, light_bow_y, {EVEN:g}: the standard asks for light even to 3 %",
        f"black_level.offset_dn, {black_dn:.2g} DN: the mean of the shortest darks, by the scatter of all dark frames' means",
    ]
    return tuple(out), words


def looking_at_the_middle(campaign: Campaign) -> tuple[Campaign, str]:
    """Shots of large frames look at the middle only, and the sentence that says so (empty where nothing changed)."""
    sensor = campaign.sensor
    if sensor is None or sensor.rows * sensor.cols <= LOOKED_AT:
        return campaign, ""
    share = math.sqrt(LOOKED_AT / (sensor.rows * sensor.cols))
    rows, cols = (int(n * share) // 2 * 2 for n in (sensor.rows, sensor.cols))
    window = Window((sensor.rows - rows) // 4 * 2, (sensor.cols - cols) // 4 * 2, rows, cols)
    words = (
        f"shots look at the middle {rows} x {cols} of {sensor.rows} x {sensor.cols} pixels: a diagnosis costs in proportion; "
        "larger windows see more of the field"
    )
    return replace(campaign, shots=tuple(replace(s, window=window) for s in campaign.shots)), words


def camera_numbers(campaign: Campaign) -> Mapping[str, float]:
    """Numbers of the standard by the names of `SYMBOLS`, from the series that a campaign holds.

    Raises
    ------
    InputError
        If the series give no gain and no dark noise.
    """
    from isetval.measure import emva1288

    flats = [s for s in campaign.shots if s.role == "flat" and s.photons_per_pixel]
    frames = [(c, s.photons_per_pixel) for s in flats for c in campaign.captures[s.name]]
    darks = [c for s in campaign.shots if s.role == "dark" for c in campaign.captures[s.name]]
    photons = [*(p for _, p in frames), *[None] * len(darks)]
    found = numbers_of(emva1288([c for c, _ in frames], dark=darks, photons_per_pixel=photons))
    if _white_saturates(campaign):
        found.pop("well_e", None)  # the converter's end is in the sensor's white level
    return found


def _white_saturates(campaign: Campaign) -> bool:
    """Whether no pixel level stands below the converter's last code where the light is brightest."""
    flats = [s for s in campaign.shots if s.role == "flat"]
    sensor = campaign.sensor
    if not flats or sensor is None:
        return True
    brightest = max(flats, key=lambda s: s.photons_per_pixel or 0.0)
    saturated = brightest in beyond_saturation(campaign, flats)
    return not saturated or any(int(c.mosaic.max()) >= sensor.white_dn for c in campaign.captures[brightest.name])
