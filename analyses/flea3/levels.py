"""Linearity over exposure time, exposure offset, light drift, spectral sensitivity, leak and glare by the levels of patches."""

# %%
from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, nnls

import isetval
from analyses.flea3.common import Float, wavelength
from isetval.core.campaign import Campaign
from isetval.core.scene import ChartTarget, Spectrum

DRIFT_PRIOR = 0.03  # of the projector from picture to picture
LEAST_SIGMA_DN, RELATIVE = 0.05, 0.004  # of a patch: what no repeat tells, unevenness inside a patch that moves by a pixel
EDGES_NM = (380, 420, 470, 520, 570, 620, 670, 720, 780)  # of the pieces of the spectrum that a leak may come from


@dataclass(frozen=True, eq=False)
class Rows:
    """Patch means of a campaign: arrays (rows,)."""

    light: Float
    channel: Float
    patch: Float
    time_s: Float
    value: Float
    sigma: Float
    lights: tuple[str, ...]
    channels: tuple[str, ...]
    patches: tuple[str, ...]


def rows_of(campaign: Campaign) -> Rows:
    """All patch means between the ends of the range, by the public measurement."""
    table = isetval.measure_campaign(campaign, summaries=False)
    kept = [m for m in table.metrics if m.name == "patch_mean" and m.exposure_s]
    names = [sorted({getattr(m, k) for m in kept}) for k in ("light", "channel", "patch")]
    index = [np.array([names[i].index(getattr(m, k)) for m in kept]) for i, k in enumerate(("light", "channel", "patch"))]
    value = np.array([m.value for m in kept])
    sigma = np.hypot(np.hypot([m.sigma for m in kept], LEAST_SIGMA_DN), RELATIVE * value)
    time = np.array([m.exposure_s for m in kept])
    return Rows(*index, time, value, sigma, *(tuple(n) for n in names))


# %% One line for everything: value = x - bend x^2/255 + offset, x = S(light, channel, patch) (t + t0) drift(light, t)
def linearity(rows: Rows) -> dict[str, object]:
    """Offset, bend, exposure offset and drift with sigma, and what each of them is worth in chi2.

    The rates S are solved for inside (variable projection); drift is one factor for each picture, with a prior of 3 %.
    """
    picture = rows.light * 1000 + np.unique(rows.time_s, return_inverse=True)[1]
    pictures, number = np.unique(picture, return_inverse=True)
    line = np.unique(rows.light * 10_000 + rows.channel * 1000 + rows.patch, return_inverse=True)[1]

    def residual(p: Float, use: tuple[bool, bool, bool, bool]) -> Float:
        offset, bend, t0 = (v if on else 0.0 for v, on in zip(p[:3], use, strict=False))
        drift = np.exp(p[3:]) if use[3] else np.ones(pictures.size)
        time = (rows.time_s + t0 / 1000) * drift[number]
        light = (rows.value - offset) * (1 + bend * (rows.value - offset) / 255)
        weight = 1 / rows.sigma**2
        rate = np.bincount(line, weight * light * time) / np.bincount(line, weight * time**2)
        data = (light - rate[line] * time) / rows.sigma
        return np.concatenate([data, np.where(use[3], p[3:], 0.0) / DRIFT_PRIOR])

    start = np.zeros(3 + pictures.size)
    steps: dict[str, tuple[bool, bool, bool, bool]] = {
        "linear": (False, False, False, False),
        "+ drift of the light": (False, False, False, True),
        "+ offset": (True, False, False, True),
        "+ bend": (True, True, False, True),
        "+ exposure offset": (True, True, True, True),
    }
    chi2 = {}
    for name, use in steps.items():
        fit = least_squares(residual, start, args=(use,), loss="soft_l1")
        chi2[name] = float(np.sum(residual(fit.x, use) ** 2))
        robust = float(np.median(np.abs(residual(fit.x, use)[: rows.value.size])) / 0.6745)
    scale = max(1.0, robust)
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * scale**2
    sigma = np.sqrt(np.diag(covariance))
    lights = rows.lights
    times = np.unique(rows.time_s)
    drift = [
        {
            "light": lights[int(p) // 1000],
            "time_s": float(times[int(p) % 1000]),
            "percent": 100 * float(np.expm1(v)),
            "sigma": 100 * float(s),
        }
        for p, v, s in zip(pictures, fit.x[3:], sigma[3:], strict=True)
    ]
    return {
        "rows": int(rows.value.size),
        "lines": int(line.max() + 1),
        "chi2": chi2,
        "robust_z": robust,
        "offset_dn": [float(fit.x[0]), float(sigma[0])],
        "bend": [float(fit.x[1]), float(sigma[1])],
        "exposure_offset_ms": [float(fit.x[2]), float(sigma[2])],
        "drift_percent": drift,
        "drift_rms_percent": float(np.sqrt(np.mean([d["percent"] ** 2 for d in drift]))),
    }


def frozen(rows: Rows, offset: float, bend: float) -> dict[str, float]:
    """How well a frozen response describes rows that it was not fitted to: rates and one light factor a picture are free.

    ``rms_percent`` over rows of 5 DN and more, ``median_z`` is 1 where the errors are the stated ones.
    """
    picture = np.unique(rows.light * 1000 + np.unique(rows.time_s, return_inverse=True)[1], return_inverse=True)[1]
    line = np.unique(rows.light * 10_000 + rows.channel * 1000 + rows.patch, return_inverse=True)[1]
    light = (rows.value - offset) * (1 + bend * (rows.value - offset) / 255)
    weight = 1 / rows.sigma**2
    factor = np.ones(picture.max() + 1)
    for _ in range(30):  # alternate: rates, then the light of each picture, drawn to 1 by its prior
        time = rows.time_s * factor[picture]
        rate = np.bincount(line, weight * light * time) / np.bincount(line, weight * time**2)
        wanted = rate[line] * rows.time_s
        top = np.bincount(picture, weight * light * wanted) + 1 / DRIFT_PRIOR**2
        factor = top / (np.bincount(picture, weight * wanted**2) + 1 / DRIFT_PRIOR**2)
    apart = light - wanted * factor[picture]
    clear = (rows.value > 5) & (np.bincount(line)[line] > 1)
    return {
        "rows": int(clear.sum()),
        "rms_percent": 100 * float(np.sqrt(np.mean((apart / light)[clear] ** 2))),
        "median_z": float(np.median(np.abs(apart / rows.sigma)[clear]) / 0.6745),
    }


def rates(rows: Rows, line: dict[str, object]) -> tuple[Float, Float]:
    """Rate (lights, channels, patches) in DN/s and its sigma with offset and bend taken out; NaN where nothing was open."""
    offset, bend = line["offset_dn"][0], line["bend"][0]  # type: ignore[index]
    drift = {(d["light"], d["time_s"]): 1 + d["percent"] / 100 for d in line["drift_percent"]}  # type: ignore[attr-defined]
    light = (rows.value - offset) * (1 + bend * (rows.value - offset) / 255)
    time = np.array([t * drift[rows.lights[k], float(t)] for k, t in zip(rows.light, rows.time_s, strict=True)])
    shape = (len(rows.lights), len(rows.channels), len(rows.patches))
    top, bottom = np.zeros(shape), np.zeros(shape)
    where = (rows.light, rows.channel, rows.patch)
    np.add.at(top, where, light * time / rows.sigma**2)
    np.add.at(bottom, where, time**2 / rows.sigma**2)
    with np.errstate(invalid="ignore", divide="ignore"):
        return top / bottom, 1 / np.sqrt(bottom)


# %% Colours against one another, and where the light of a weak channel comes from
def spectral(rows: Rows, line: dict[str, object], campaign: Campaign, model: isetval.CameraModel) -> list[dict[str, object]]:
    """For each band: rates of R, G, B on the white patch, what the model says, and the spectrum that the patches tell."""
    rate, sigma = rates(rows, line)
    target = next(s.target for s in campaign.shots if isinstance(s.target, ChartTarget))
    assert isinstance(target, ChartTarget)
    reflectance = {p.name: p.reflectance for p in target.patches}
    white = rows.patches.index("white")
    qe = model.effect("quantum_efficiency")
    out = []
    for i, light in enumerate(rows.lights):
        band = campaign.lights[light].radiance
        grid = model.wavelength_nm
        light_nm = band.band_means(grid) * grid
        curve = [float(np.sum(c * light_nm)) for c in qe.curves(_context(model), grid)]  # type: ignore[union-attr]
        levels = {c: rate[i, [k for k, name in enumerate(rows.channels) if name[0] == c], white].mean() for c in "RGB"}
        best = max(levels, key=lambda c: np.nan_to_num(levels[c]))
        places = [
            (p.box[0] + p.box[1], p.box[2] + p.box[3])
            for p in (next(q for q in target.patches if q.name == n) for n in rows.patches)
        ]
        for k, color in enumerate("RGB"):
            columns = [j for j, name in enumerate(rows.channels) if name[0] == color]
            seen, error = (np.mean(v[i, columns], axis=0) for v in (rate, sigma))  # NaN where one of two greens is shut
            found = composition(seen, error, [reflectance[n] for n in rows.patches], np.array(places, float))
            out.append(
                {
                    "light": light,
                    "nm": wavelength(light),
                    "channel": color,
                    "rate_dn_per_s": float(levels[color]),
                    "relative": float(levels[color] / levels[best]),
                    "model_relative": curve[k] / curve["RGB".index(best)],
                    **found,
                }
            )
    return out


def _context(model: isetval.CameraModel) -> object:
    from isetval.core.context import Context
    from isetval.core.sensor import Exposure

    return Context(sensor=model.sensor, window=(0, 0, 2, 2), exposure=Exposure(1.0), shot="", role="chart", light="", nuisance={})


def composition(rate: Float, sigma: Float, reflectance: list[Spectrum], place: Float) -> dict[str, object]:
    """Which part of the spectrum a channel sees, by the pattern of 24 reflectances, and light that falls on no patch.

    rate = field(x, y) sum_k w_k <reflectance>_k + glare, w >= 0; the field is a tilt, found by the brightest channel's rows.
    """
    use = np.isfinite(rate) & (rate > 0)
    if use.sum() < 12:
        return {"effective_nm": None, "glare_percent": None, "misfit_percent": None}
    pieces = [
        np.array([float(r.at(np.arange(low, high)).mean()) for r in reflectance]) for low, high in itertools.pairwise(EDGES_NM)
    ]
    x, y = ((place[:, k] - place[:, k].mean()) / np.ptp(place[:, k]) * 2 for k in (1, 0))
    error = np.hypot(sigma, 0.02 * rate)  # reflectances are known to 2 % at best
    field = np.ones(rate.size)
    for _ in range(6):
        design = np.stack([*(field * p for p in pieces), np.ones(rate.size)], axis=1)
        weight, _ = nnls(design[use] / error[use, None], rate[use] / error[use])
        flat = (design / field[:, None])[:, :-1] @ weight[:-1]
        tilt = np.stack([flat, flat * x, flat * y], axis=1)[use] / error[use, None]
        solved = np.linalg.lstsq(tilt, ((rate - weight[-1]) / error)[use], rcond=None)[0]
        field = np.clip((solved[0] + solved[1] * x + solved[2] * y) / solved[0], 0.5, 1.5)
    fit = design @ weight
    middles = (np.array(EDGES_NM[1:]) + np.array(EDGES_NM[:-1])) / 2
    total = float(weight[:-1].sum())
    return {
        "effective_nm": float(middles @ weight[:-1] / total) if total > 0 else None,
        "parts": {
            f"{a}-{b}": float(w / total) for a, b, w in zip(EDGES_NM, EDGES_NM[1:], weight, strict=False) if w > 0.02 * total
        },
        "glare_percent": 100 * float(weight[-1] / np.nanmax(rate)),
        "misfit_percent": 100 * float(np.sqrt(np.mean((rate[use] / fit[use] - 1) ** 2))),
        "tilt_percent": [100 * float(solved[1] / solved[0]), 100 * float(solved[2] / solved[0])],
        "patches": int(use.sum()),
    }


NEUTRALS = ("white", "neutral 8", "neutral 6.5", "neutral 5", "neutral 3.5", "black")
KNOWN = 0.05  # relative, of a patch's reflectance in its light: patches scatter by 4 to 9 % about a smooth light


# %% Light that falls on no patch, by the row of greys: what is left at reflectance 0
def glare(rows: Rows, line: dict[str, object], campaign: Campaign) -> list[dict[str, object]]:
    """Glare in percent of white by band, of its strongest channel, with sigma.

    rate = (a + b x) reflectance + glare over the six greys, x along their row; every rate is known to 5 %, as the other
    patches scatter, and the result is widened where the greys scatter by more.
    """
    rate, _ = rates(rows, line)
    target = next(s.target for s in campaign.shots if isinstance(s.target, ChartTarget))
    assert isinstance(target, ChartTarget)
    patches = [next(p for p in target.patches if p.name == name) for name in NEUTRALS]
    columns = [rows.patches.index(name) for name in NEUTRALS]
    x = np.linspace(-1, 1, len(NEUTRALS))
    out = []
    for i, light in enumerate(rows.lights):
        band = campaign.lights[light].radiance
        peak = float(band.wavelength_nm[np.argmax(band.values)])
        reflectance = np.array([float(p.reflectance.at(peak)) for p in patches])
        levels = rate[i][:, columns]
        best = int(np.argmax(np.nan_to_num(levels[:, 0])))
        seen = levels[best]
        if not np.isfinite(seen).all():
            continue
        design = np.stack([reflectance, reflectance * x, np.ones(x.size)], axis=1) / (KNOWN * seen)[:, None]
        found, cost, *_ = np.linalg.lstsq(design, np.full(x.size, 1 / KNOWN), rcond=None)
        wider = max(1.0, float(cost[0]) / (x.size - 3)) if cost.size else 1.0
        sigma = np.sqrt(np.linalg.inv(design.T @ design)[2, 2] * wider)
        white = found[0] * reflectance[0]
        out.append(
            {"light": light, "channel": rows.channels[best], "percent": 100 * found[2] / white, "sigma": 100 * sigma / white}
        )
    return out
