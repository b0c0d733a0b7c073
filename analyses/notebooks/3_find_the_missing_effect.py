# %% [markdown]
# # Compare, and find the missing effect
# A camera has more dark current than its model knows. The same plan is shot by the camera and by the model, both are measured
# by the same estimators, and the difference is traced to a cause. (About two minutes: every candidate of the catalogue is tried.)

# %%
import isetval
from isetval.core.toml import data_folder

names = ["dark0", "dark1", "dark2", *(f"flat{i}" for i in range(6)), "level1", "level1r"]
plan = isetval.load_campaign(data_folder() / "demo" / "plan.toml").only([f"{s}_{n}" for s in "AB" for n in names])
model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
camera = model.with_effect(model.effect("dark_current").changed(rate_e_per_s=2.0))
captures = isetval.simulate(camera, plan, seed=3, draw=True)  # draw: the laboratory's errors are drawn from their priors
captures

# %% [markdown]
# ## Where does the model fail?
# Mean-square z is 1 where measurement and simulation differ only by noise.

# %%
before = isetval.compare(model, captures)
before

# %% [markdown]
# ## What is missing?
# Session A is diagnosed, session B confirms.

# %%
found = isetval.diagnose(model, captures)
assert found.effects[0].name == "dark_current"
found

# %%
rate = found.effects[0].parameters["rate_e_per_s"]
print(f"dark current {rate.value:.3f} +- {rate.sigma:.3f} {rate.unit}; true 2.0, the model had {rate.nominal}")
assert abs(rate.value - 2.0) < 5 * rate.sigma

# %% [markdown]
# ## The better model
# `apply` gives a new model; `save` writes it with where its numbers come from. The error falls on session B too, to which
# nothing was fitted.

# %%
better = found.apply()
isetval.compare([model, better], captures)
