"""
Relative illumination
=====================

Flats at six places of the field tell the fall-off of the lens, plane by plane, with its error bars; beside it the law of cosines.
"""

import numpy as np
from matplotlib import pyplot as plt

import isetval
from isetval.core.toml import data_folder

model = isetval.load_model("isetval:pixel4a")
plan = isetval.load_campaign(data_folder() / "demo" / "plan.toml")
names = [shot.name for shot in plan.shots if shot.name.startswith("A_field")]
campaign = isetval.simulate(model, plan.only(names), seed=1)
flats = [frame for name in names for frame in campaign.captures.read(name)]
result = isetval.measure.relative_illumination(flats)
print(result)
figure, axes = plt.subplots(figsize=(6.5, 4.2), layout="constrained")
result.plot(axes)
radius_mm = np.linspace(0, 3.4, 50)
focal_mm = model.value("cos4.focal_mm")
axes.plot(radius_mm, (1 + (radius_mm / focal_mm) ** 2) ** -2, "k--", lw=1, label="cos$^4$")
_ = axes.legend()
