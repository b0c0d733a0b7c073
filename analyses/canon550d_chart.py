"""A real colour chart of one raw file against a model of its camera, patch by patch: what fails, and which way.

Question: how far does a model get whose gain comes from the picture's own noise and whose filters are another camera's?
Data: a public 14-bit raw of a 24-patch chart (``canon550d_colorchecker.dng``, ../shared/data/real/README.md), from ``--data``.
Model: ``data/canon550d/camera.toml``.  Light, reflectances and exposure time are unknown: published colours, equal energy.
Result: ``reports/canon550d_chart.json``: levels are off by 11 % rms in green, 15 % in red and blue.  All colours that reflect
little in a channel's band, and the black patch, are brighter than the model: mixing of colours, flare, or filters broader than
those of the other camera; one picture in one light cannot tell these apart.

    python analyses/canon550d_chart.py [--data FILE]
"""

# %%
from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from pathlib import Path

import isetval
from isetval.app.cli import main as isetval_command

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data" / "real" / "canon550d_colorchecker.dng"
MODEL = ROOT / "data" / "canon550d" / "camera.toml"


# %%
def run(data: Path) -> dict[str, object]:
    """The comparison: rms error by colour, and each patch's measured and simulated level."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copyfile(data, Path(folder) / data.name)
        if isetval_command(["campaign", "init", folder, "--camera", str(MODEL), "-q"]) != 0:
            raise SystemExit("campaign init refused the file; its sentence stands above")
        found = isetval.compare(isetval.load_model(MODEL), isetval.load_campaign(folder), say=print)
    rows = found.table[found.table["name"] == "patch_mean"]
    relative = rows["simulated"] / rows["measured"] - 1
    by_color = {
        channel: 100 * float((relative[rows["channel"] == channel] ** 2).mean() ** 0.5) for channel in ("R", "Gr", "Gb", "B")
    }
    keys = ["channel", "patch", "measured", "simulated", "sigma", "z"]
    return {
        "ladder": [vars(row) for row in found.ladder],
        "rms_percent_by_color": by_color,
        "nuisances": {k: list(v) for k, v in found.nuisances["canon550d"].items()},
        "patches": rows[keys].to_dict(orient="records"),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA, help="the raw file (default: %(default)s)")
    options = parser.parse_args()
    if not options.data.is_file():
        raise SystemExit(f"{options.data}: the file is not there; name it with --data")
    made = run(options.data)
    worst = sorted(made["patches"], key=lambda row: -abs(row["simulated"] / row["measured"] - 1))  # type: ignore[index, call-overload]
    for row in worst[:12]:
        print(f"{row['channel']:2s} {row['patch']:14s} measured {row['measured']:7.1f} DN, simulated {row['simulated']:7.1f} DN")
    print("rms error by colour in percent:", {k: round(v, 1) for k, v in made["rms_percent_by_color"].items()})  # type: ignore[attr-defined]
    (ROOT / "reports" / "canon550d_chart.json").write_text(json.dumps(made, indent=1, default=float) + "\n")
