# %% [markdown]
# # The default lens as a ray-transfer file
#
# Question: what does the project's own lens look like as an ISET ray-transfer file, and is the file sound?
# Data: `data/lens/default_lens.toml` (the project's own prescription, see `default_lens_design.py`).
# Result: `data/lens/default_lens.json`, five wavelengths, and the hold-out error of every fit.
# Run time: under a minute.

# %%
from __future__ import annotations

from pathlib import Path

from isetval.lens.auditing import audit
from isetval.lens.prescription import Prescription
from isetval.lens.prescription_rays import ray_transfer

FOLDER = Path(__file__).resolve().parents[1] / "data" / "lens"
WAVELENGTHS_NM = (450.0, 500.0, 550.0, 600.0, 650.0)
TABLE_END_MM = 3.57  # the sensor corner is at 3.528


# %%
def main() -> None:
    """Trace, fit, save, and print fits and audit."""
    prescription = Prescription.load(FOLDER / "default_lens.toml")
    focal, back = prescription.paraxial()
    print(f"focal length {focal:.4f} mm, back focal distance {back:.4f} mm")
    lens, fits = ray_transfer(
        prescription,
        sensor_radius_mm=TABLE_END_MM,
        wavelengths_nm=WAVELENGTHS_NM,
        degrees=(5, 7, 9),
        description=prescription.source,
    )
    for wavelength, fit in fits.items():
        errors = {d: f"{e[0]:.2f} um {e[1]:.3f} mrad" for d, e in fit.holdout.items()}
        print(f"{wavelength:g} nm: degree {fit.degree}, hold-out errors {errors}")
    lens.save(FOLDER / "default_lens.json")
    print("\n".join(audit(lens).lines()))


if __name__ == "__main__":
    main()
