"""
Chart
=====

Patch means with their error bars, from one simulated frame of a chart.
"""

from matplotlib import pyplot as plt

import isetval
from isetval.core.toml import data_folder

model = isetval.load_model("isetval:pixel4a")
plan = isetval.load_campaign(data_folder() / "demo" / "plan.toml").only(["A_chart_sphere"])
target = plan.shots[0].target
capture = isetval.simulate(model, plan, seed=1).captures.read("A_chart_sphere")[0]
result = isetval.measure.chart(capture, boxes=[p.box for p in target.patches], names=[p.name for p in target.patches])
print(result)
figure, axes = plt.subplots(figsize=(6.5, 4.2), layout="constrained")
_ = result.plot(axes)
