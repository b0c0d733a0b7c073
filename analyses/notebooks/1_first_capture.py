# %% [markdown]
# # A first capture
# One raw file: read it, look at it, measure an edge. Instead of your own DNG this notebook makes one with the Pixel 4a model, so
# that it runs anywhere; `isetval.read_capture("IMG_0001.dng")` reads yours, and PGM, PNG and TIFF as well.

# %%
import tempfile
from pathlib import Path

import isetval
from isetval.core.toml import data_folder

folder = Path(tempfile.mkdtemp())
model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
plan = isetval.load_campaign(data_folder() / "demo" / "plan.toml").only(["A_edge_center_v_z0"])
isetval.write_dng(folder / "edge.dng", isetval.simulate(model, plan, seed=1).captures.read("A_edge_center_v_z0")[0])

# %% [markdown]
# A capture is the raw mosaic and what is needed to read it: sensor, window on the sensor, exposure. Nothing was demosaiced.

# %%
capture = isetval.read_dng(folder / "edge.dng")
print(capture.mosaic.shape, capture.sensor.cfa, capture.sensor.black_dn, capture.sensor.white_dn, capture.exposure)
isetval.plots.plot_frame(capture)

# %% [markdown]
# The slanted-edge SFR. A result shows itself: one line, its curve with a 95 % band, and a table in which every number has a
# standard deviation and a unit.

# %%
result = isetval.measure.sfr(capture, channel="G")
result

# %%
result.to_frame().head()

# %% [markdown]
# The same edge by ISO 12233:2023: the default fits a smooth edge-spread function and is the more exact one; the standard's number
# is given beside it, so that it can be compared with other tools.

# %%
iso = isetval.measure.sfr(capture, channel="G", method="iso12233:2023")
print(result)
print(iso)
assert abs(result.mtf50_cy_px - iso.mtf50_cy_px) < 4 * iso.mtf50_sigma
isetval.plots.plot_sfr({"default": result, "ISO 12233:2023": iso})
