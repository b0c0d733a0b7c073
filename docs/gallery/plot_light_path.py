"""
One exposure along the light path
=================================

Radiance, irradiance, electrons, DN: the same edge behind four effects of the Pixel 4a's model.
"""

from matplotlib import pyplot as plt

import isetval
from isetval.camera.light_path import light_path
from isetval.core.toml import data_folder

model = isetval.load_model("isetval:pixel4a")
plan = isetval.load_campaign(data_folder() / "demo" / "plan.toml")
shot = plan.only(["A_edge_center_v_z0"]).shots[0]
steps = {step.effect: step for step in light_path(model, shot, lights=plan.lights)}
figure, axes = plt.subplots(1, 4, figsize=(11, 3), layout="constrained")
for axis, name in zip(axes, ("scene", "pixel_aperture", "shot_noise", "quantization"), strict=True):
    picture = steps[name].picture
    if steps[name].unit in ("e-", "DN"):  # a mosaic: means of its cells, or it looks like a chequerboard
        picture = (picture[::2, ::2] + picture[1::2, ::2] + picture[::2, 1::2] + picture[1::2, 1::2]) / 4
    axis.imshow(picture, cmap="gray")
    axis.set_title(f"{name}: {steps[name].mean:.3g} {steps[name].unit}", fontsize=8)
    axis.set_axis_off()
