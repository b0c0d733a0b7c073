"""What the linear model of EMVA 1288 lacks for reference set 001: a bent response and codes of unequal width.

Learned on the even levels, judged on the odd ones; see ``analyses/emva1288_set001.py``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import isetval
from isetval.core.campaign import Campaign, Shot

Float = NDArray[np.float64]
PIXELS = 640 * 480
REPEAT = 16  # codes after which the pattern of a converter's last stages repeats
LEAST_PHOTONS = 900.0  # above it enough codes are hit for their widths
FLICKER = 5e-4  # frame means of the stack scatter by so much


def causes(campaign: Campaign) -> dict[str, object]:
    """Chi2 of temporal variance against light on the odd levels, with nothing fitted to them.

    The bend comes from the means of the even levels, the codes' widths from how often codes occur in them, gain and read
    noise from their variances.  A level of standard deviation s averages the widths of 2 sqrt(pi) s codes: their own part
    scatters the local gain by its square root, the pattern that repeats every 16 codes by nothing.
    """
    rows = np.array([level_row(campaign, shot) for shot in open_levels(campaign)])
    light, mean, variance, spread, own, repeated = rows.T
    even = np.arange(light.size) % 2 == 0
    error = variance * np.sqrt(2 / PIXELS)
    bend, bend_sigma = bend_of(light[even], mean[even])
    local = np.sqrt(np.mean(own[even]) / (2 * np.sqrt(np.pi) * spread))  # relative standard deviation of the gain
    straight, slope = mean, 1 - 2 * bend * light / light.max()
    bent = slope**2 * mean / (1 - bend * light / light.max())
    steps = {
        "straight line": (straight, error),
        "bent response": (bent, error),
        "bent response, uneven codes": (bent, np.hypot(error, 2 * local * variance)),
    }
    out: dict[str, object] = {"levels": int(light.size), "judged": int((~even).sum()), "bend": [bend, bend_sigma], "steps": {}}
    for name, (signal, sigma) in steps.items():
        design = np.stack([signal, np.ones_like(signal)], axis=1)
        scaled = design[even] / sigma[even, None]
        found = np.linalg.lstsq(scaled, variance[even] / sigma[even], rcond=None)[0]
        spent = np.sqrt(np.diag(np.linalg.inv(scaled.T @ scaled)))
        chi2 = float(np.sum(((variance - design @ found) / sigma)[~even] ** 2))
        read_e = float(np.sqrt(max(found[1] - 1 / 12, 0.0)) / found[0])
        out["steps"][name] = {"K": [float(found[0]), float(spent[0])], "read_noise_e": read_e, "chi2": chi2}  # type: ignore[index]
    out["code_width_rms"] = [float(np.sqrt(np.mean(own[k] + repeated[k]))) for k in (even, ~even)]
    out["own_width_rms"], out["repeated_width_rms"] = float(np.sqrt(np.mean(own[even]))), float(np.sqrt(np.mean(repeated[even])))
    out["local_gain_percent"] = 100 * float(np.mean(local))
    out |= pattern(campaign)
    return out


def open_levels(campaign: Campaign) -> list[Shot]:
    """The two-frame levels in which no pixel is clipped."""
    flats = [s for s in campaign.shots if s.role == "flat" and s.frames == 2 and (s.photons_per_pixel or 0.0) > LEAST_PHOTONS]
    return [s for s in flats if all(int(c.mosaic.max()) < campaign.sensor.white_dn for c in campaign.captures[s.name])]


def level_row(campaign: Campaign, shot: Shot) -> tuple[float, ...]:
    """Photons, mean above black and temporal variance in DN, spread of the codes, variance of widths: own, repeated."""
    captures = campaign.captures[shot.name]
    table = isetval.measure_campaign(campaign.only([shot.name]), summaries=False)
    found = {m.name: m.value for m in table.metrics}
    a, b = (c.mosaic.astype(float) for c in captures)
    variance = float(np.var(a - b)) / 2
    own = max(found["code_width_variance"] - found["code_pattern_variance"], 0.0)
    return (shot.photons_per_pixel or 0.0, found["mean"], variance, float(a.std()), own, found["code_pattern_variance"])


def bend_of(light: Float, mean: Float) -> tuple[float, float]:
    """Relative loss at the brightest level of ``mean = g light (1 - bend light / brightest) + offset``, and its sigma."""
    top = light / light.max()
    sigma = np.hypot(FLICKER * mean, 0.3)  # and the black level
    design = np.stack([top, top**2, np.ones_like(top)], axis=1) / sigma[:, None]
    found = np.linalg.lstsq(design, mean / sigma, rcond=None)[0]
    covariance = np.linalg.inv(design.T @ design)
    return float(-found[1] / found[0]), float(np.sqrt(covariance[1, 1]) / found[0])


def pattern(campaign: Campaign) -> dict[str, object]:
    """Widths of codes that are equal modulo 16, by even and odd levels.

    And the share of the excess of the odd levels' counts that the even levels' pattern takes away.
    """
    places = np.arange(65536) % REPEAT
    counts = [
        sum(np.bincount(c.mosaic.ravel(), minlength=65536) for c in campaign.captures[s.name]) for s in open_levels(campaign)
    ]
    seen = [(np.asarray(c, float), smooth_counts(np.asarray(c, float))) for c in counts]
    widths = [
        sum(np.bincount(places, np.where(g > 0, c, 0.0), REPEAT) for c, g in part)
        / sum(np.bincount(places, g, REPEAT) for _, g in part)
        for part in (seen[::2], seen[1::2])
    ]
    before = sum(float(np.sum(((c - g) ** 2 - g)[g > 0])) for c, g in seen[1::2])
    after = sum(float(np.sum(((c - g * widths[0][places]) ** 2 - g)[g > 0])) for c, g in seen[1::2])
    return {"pattern_explains": 1 - after / before, "pattern_even": widths[0].tolist(), "pattern_odd": widths[1].tolist()}


def smooth_counts(counts: Float) -> Float:
    """Counts over a window of 33 codes (two patterns), a parabola through them; 0 where fewer than 200 are expected."""
    from scipy.signal import savgol_filter

    found = np.asarray(savgol_filter(counts, 2 * REPEAT + 1, 2))
    return np.where(found > 200, found, 0.0)


def cause_lines(found: dict[str, object], published_gain: float) -> list[str]:
    """The verdict on the published chi2, in sentences."""
    steps: dict[str, dict[str, object]] = found["steps"]  # type: ignore[assignment]
    bend, bend_sigma = (100 * v for v in found["bend"])  # type: ignore[attr-defined]
    learned, judged = found["code_width_rms"]  # type: ignore[misc]
    explained = 100 * found["pattern_explains"]  # type: ignore[operator]
    chi2 = ", ".join(f"{name} {step['chi2']:.0f}" for name, step in steps.items())
    gains = "; ".join(f"{n}: {s['K'][0]:.4f} +- {s['K'][1]:.4f} DN/e-, {s['read_noise_e']:.2f} e-" for n, s in steps.items())  # type: ignore[index]
    return [
        f"Missing: nonlinearity and uneven_codes. The response bends by {bend:.2f} +- {bend_sigma:.2f} % at the brightest level "
        f"(means of the even levels), and the converter's codes differ in width by {learned:.4f} LSB rms (counts of the even "
        f"levels; {judged:.4f} on the odd ones).",
        f"The widths' pattern of 16 codes, learned on the even levels, takes away {explained:.0f} % of what the counts of the "
        "odd levels scatter beyond Poisson: the same codes are wide at every level.",
        f"Temporal variance of the {found['judged']} odd levels, nothing fitted to them, chi2: {chi2}; the last allows for a "
        f"gain that scatters by {found['local_gain_percent']:.2f} % from level to level, as the widths of single codes say.",
        f"Gain and read noise: {gains}. A straight line gives the published {published_gain} DN/e-, the mean slope; the gain "
        "at small signals is higher by what the bend takes.",
    ]
