# %% [markdown]
# # Write your own analysis
# An analysis takes captures and gives numbers with a standard deviation and a unit. `check_measurement` plants a truth many times and
# demands that the error bars are honest. As a file in `isetval/measure/analyses/` it takes part in measure, compare and diagnose.

# %%
import numpy as np

import isetval
from isetval.core.capture import plane_black_dn, plane_view
from isetval.testing import check_measurement


def color_ratio(capture: isetval.Capture, plane: str = "R") -> isetval.Metric:
    """Mean of a colour over that of green, black removed; sigma from the scatter of the pixels."""
    mean, variance = {}, {}
    for name in (plane, "Gr"):
        values = plane_view(capture, name)[0].astype(float)
        mean[name] = values.mean() - plane_black_dn(capture, name)
        variance[name] = values.var(ddof=1) / values.size
    ratio = mean[plane] / mean["Gr"]
    sigma = ratio * np.sqrt(sum(variance[name] / mean[name] ** 2 for name in mean))
    return isetval.Metric("color_ratio", float(ratio), float(sigma), "1", channel=plane)


# %% [markdown]
# Red 150 e-, green 300 e-: the ratio is one half, whatever the noise.


# %%
def planted(seed: int) -> isetval.Capture:
    """A flat of 48 x 48 pixels with Poisson noise, black at 64."""
    electrons = np.tile([[150.0, 300.0], [300.0, 100.0]], (24, 24))
    return isetval.Capture.from_array(64 + np.random.default_rng(seed).poisson(electrons))


pulls = check_measurement(color_ratio, 0.5, make=planted)
print(color_ratio(planted(0)))
pulls

# %% [markdown]
# An error bar that is too small is found out: without the green's part the pulls are too wide.


# %%
def proud(capture: isetval.Capture) -> tuple[float, float]:
    """The same value with half the error bar."""
    honest = color_ratio(capture)
    return honest.value, honest.sigma / 2


try:
    check_measurement(proud, 0.5, make=planted)
except AssertionError as error:
    print(error)
else:
    raise RuntimeError("a dishonest error bar was accepted")
