# %% [markdown]
# # From a folder of a laboratory to a campaign
# A campaign is a folder of raw files with a `campaign.toml` that says what was photographed. `isetval campaign init FOLDER` drafts
# it from what the files say. Here the folder is made by the model; give your own path instead.

# %%
import tempfile
from pathlib import Path

import isetval
from isetval.core.toml import data_folder
from isetval.files.campaign_writer import write_campaign
from isetval.files.draft import draft_campaign, write_draft

names = ["A_dark0", "A_dark1", *(f"A_flat{i}" for i in range(6)), "A_edge_center_v_z0"]
plan = isetval.load_campaign(data_folder() / "demo" / "plan.toml").only(names)
model = isetval.load_model(data_folder() / "pixel4a" / "camera.toml")
folder = write_campaign(isetval.simulate(model, plan, seed=2), Path(tempfile.mkdtemp()) / "captures", model=model)
(folder / "campaign.toml").unlink()  # a laboratory's folder has none
print(len(list(folder.glob("*.dng"))), "raw files")

# %% [markdown]
# Drafting reads every file, groups frames of one set-up, tells darks, flats, edges and charts apart, and says what no file can say.

# %%
draft = draft_campaign(folder, camera="isetval:pixel4a/camera.toml")
path = write_draft(draft, folder)
for shot in draft.shots:
    print(shot.role, shot.name, shot.comment)
for what, needs, _ in draft.unknown:
    print(f"not known: {what}: {needs}")

# %%
print(path.read_text()[:1200])

# %% [markdown]
# It can be measured at once. The table has one row a number, with its standard deviation, unit and conditions.

# %%
campaign = isetval.load_campaign(folder)
table = isetval.measure_campaign(campaign)
assert {shot.role for shot in campaign.shots} == {"dark", "flat", "edge"}
table

# %% [markdown]
# The gain that the ruler reads off the flats is the model's (0.1707 DN/e-, camera.toml).

# %%
frame = table.to_frame()
gain = frame[frame.name == "gain_dn_per_e"].set_index("channel")[["value", "sigma", "unit"]]
assert len(gain) == 4
assert ((gain.value - 0.1707).abs() < 5 * gain.sigma).all()
gain
