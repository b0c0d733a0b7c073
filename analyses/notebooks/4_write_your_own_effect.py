# %% [markdown]
# # Write your own effect
# An effect is a class of a dozen lines: what it acts on, its parameters with unit and bounds, its equation, and `apply`. `isetval effects
# new NAME` writes a file like this with its test.

# %%
from dataclasses import dataclass

import numpy as np

import isetval
from isetval.core.context import Context
from isetval.core.effect import parameter
from isetval.core.toml import data_folder
from isetval.testing import check_effect


@dataclass(frozen=True, kw_only=True)
class WarmSide(isetval.Effect):
    """Dark charge that grows from the left edge of the sensor to the right, where the electronics are warm."""

    name = "warm_side_of_a_notebook"
    stage = "electronics"
    acts_on = "electron"
    gives = "electron"
    order = 22.5
    equation = "mu + g t (1 + x) / 2, x = -1 at the left edge, 1 at the right"
    reference = "first-order expansion of the temperature across the chip"
    must_not_change = ("edge",)

    rate_e_per_s: float = parameter(0.0, unit="e-/s", low=0.0, high=1e4, tau=1.0, doc="dark current g added at the right edge")

    def apply(self, signal: isetval.Signal, context: Context) -> isetval.Signal:
        """Add the mean charge of the exposure; shot_noise makes it noisy."""
        if not self.rate_e_per_s:
            return signal
        x_mm, _ = context.xy_mm()
        half_mm = context.sensor.cols * context.sensor.pixel_um / 2000
        added = self.rate_e_per_s * context.time_s() * (1 + x_mm / half_mm) / 2
        return signal.with_values(signal.values + added.astype(signal.values.dtype))


# %% [markdown]
# The battery that every effect of the catalogue passes: the null is the identity, a crop sees what the whole field sees, nothing
# random is hidden, bounds refuse.

# %%
check_effect(WarmSide(rate_e_per_s=3.0))

# %% [markdown]
# In a model it takes its place along the light path by itself. Its signature: darks of 4 s at the left and the right of the sensor.

# %%
from dataclasses import replace

from isetval.core.sensor import Window

model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
warm = model.with_effect(WarmSide(rate_e_per_s=3.0))
print([e.name for e in warm.effects])
dark = isetval.load_campaign(data_folder() / "demo" / "plan.toml").only(["A_dark2"]).shots[0]
gain = model.effect("conversion_gain").gain_dn_per_e
for col, truth_e in ((0, 0.0), (1976, 6.0), (3952, 12.0)):
    place = replace(dark, window=Window(1464, col, 80, 80))
    added = (warm.expected(place) - model.expected(place)).mean() / gain
    print(f"column {col}: {added:.2f} e- added, {truth_e:g} by the equation")
    assert np.isclose(added, truth_e, atol=0.15)  # 80 columns of the field: 12 e- x 40/4032
