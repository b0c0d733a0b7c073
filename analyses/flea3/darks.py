"""Dark frames of two visits: what leaves code 0, whether it grows with time, and whether it is the same pixels."""

# %%
from __future__ import annotations

import numpy as np

from isetval.core.campaign import Campaign

HOT_DN = 8  # codes: ten times what a pixel of 10 e- read noise and .04 DN/e- shows
TRUNCATION_DN = 0.5


def dark_pixels(campaign: Campaign) -> dict[str, object]:
    """Counts of hot pixels by exposure, their growth with time, and how many are hot in both frames of a shot."""
    shots = sorted((s for s in campaign.shots if s.role == "dark"), key=lambda s: s.exposure.time_s or 0.0)
    frames = {s.exposure.time_s: np.array([c.mosaic for c in campaign.captures[s.name]], float) for s in shots}
    longest = max(frames)
    hot = frames[longest].mean(axis=0) >= HOT_DN
    rows = []
    for time_s, stack in frames.items():
        both = np.all(stack >= HOT_DN, axis=0)
        rows.append(
            {
                "time_s": time_s,
                "mean_dn": float(stack.mean()),
                "sigma_dn": float(stack.std() / np.sqrt(stack.size)),
                "above_zero": int((stack.mean(axis=0) > 0).sum()),
                "hot": int((stack.mean(axis=0) >= HOT_DN).sum()),
                "hot_in_both_frames": int(both.sum()),
                "largest_dn": float(stack.max()),
                "mean_of_hottest_dn": float(stack.mean(axis=0)[hot].mean()) if hot.any() else 0.0,
            }
        )
    clear = (frames[longest].mean(axis=0) < 200) & hot
    times = np.array(sorted(frames))
    growth = np.array([frames[t].mean(axis=0)[clear].mean() for t in times]) if clear.any() else np.zeros(times.size)
    slope = float(np.sum(growth * times) / np.sum(times**2))
    return {
        "pixels": int(hot.size),
        "frames": rows,
        "hot_rate_dn_per_s": slope,
        "growth_dn": dict(zip(map(str, times.tolist()), growth.tolist(), strict=True)),
        "growth_of_a_line_dn": dict(zip(map(str, times.tolist()), (slope * times).tolist(), strict=True)),
    }
