"""
Dark frames
===========

Mean of darks against exposure time: black level and dark current, by plane.
"""

from matplotlib import pyplot as plt

import isetval
from isetval.core.toml import data_folder

model = isetval.load_model("isetval:pixel4a")
plan = isetval.load_campaign(data_folder() / "demo" / "plan.toml").only(["A_dark0", "A_dark1", "A_dark2"])
shot = isetval.simulate(model, plan, seed=1)
frames = [frame for s in plan.shots for frame in shot.captures.read(s.name)]
result = isetval.measure.dark(frames)
print(result)
figure, axes = plt.subplots(figsize=(6.5, 4.2), layout="constrained")
_ = result.plot(axes)
