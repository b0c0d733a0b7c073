"""
Where a model fails, and what its error bars are made of
========================================================

A camera with more dark current than its model knows: mean-square z of every family, and the error budget of three of them.
"""

import numpy as np
from matplotlib import pyplot as plt

import isetval
from isetval.core.toml import data_folder

model = isetval.load_model("isetval:pixel4a")
plan = isetval.load_campaign(data_folder() / "demo" / "plan.toml").only(["A_dark0", "A_dark2", "A_flat2", "A_flat4"])
camera = model.with_effect(model.effect("dark_current").changed(rate_e_per_s=2.0))
found = isetval.compare(model, isetval.simulate(camera, plan, seed=3), regions=True)
print(found)
figure, (ladder, budget) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
found.plot(ladder)
rows = [row for row in found.budget if row.family in ("dark_mean", "flat_mean", "flat_temporal_variance")]
left = np.zeros(len(rows))
for part in ("sampling", "specimen", "simulation", "light"):
    share = np.array([getattr(row, part) for row in rows])
    budget.barh([row.family for row in rows], share, left=left, label=part)
    left += share
budget.set_xlabel("share of the variance")
_ = budget.legend(fontsize="small", loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4)
