# %% [markdown]
# # Plan a measurement
# Before anything is photographed, `identify` tells what a plan would show of every effect of the catalogue, what it could not tell
# apart, and which capture would help. (A minute or two.)

# %%
import isetval
from isetval.core.toml import data_folder

model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
whole = isetval.load_campaign(data_folder() / "demo" / "plan.toml")
flats = [f"A_flat{i}" for i in range(6)]
plan = whole.only(["A_dark0", *flats])
found = isetval.identify(model, plan, with_next_captures=False)
found

# %% [markdown]
# One dark of a millisecond cannot know the dark current. A dark of 4 s can:

# %%
longer = isetval.identify(model, whole.only(["A_dark0", "A_dark2", *flats]), with_next_captures=False)


def sigma_of(result, effect):
    """Standard deviation of an effect's first parameter with a plan."""
    return next(p.sigma for p in result.parameters if p.effect == effect)


print(f"dark current: +- {sigma_of(found, 'dark_current'):.3g} e-/s with one short dark")
print(f"dark current: +- {sigma_of(longer, 'dark_current'):.3g} e-/s with a dark of 4 s")
assert sigma_of(longer, "dark_current") < 0.1 * sigma_of(found, "dark_current")

# %%
frame = longer.to_frame()
frame[frame.observable].sort_values("sigma")[["effect", "parameter", "sigma", "smallest_detectable", "unit"]].head(12)

# %%
print("not seen with this plan:", ", ".join(longer.unobservable))
