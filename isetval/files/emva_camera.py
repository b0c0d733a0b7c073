"""The numbers of an EMVA 1288 datasheet as a camera model: what it states, and a mark on what it does not."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from isetval.camera.model import CameraModel
from isetval.camera.model_file import make_effect
from isetval.core.errors import InputError
from isetval.core.sensor import Sensor
from isetval.core.writing import write_whole
from isetval.files.emva_datasheet import quantities, recognises

SYMBOLS = {
    "gain_dn_per_e": ("k",),
    "dark_noise_e": ("sigma_d",),
    "well_e": ("mu_e.sat", "u_esat", "mu_e_sat", "sat_capacity"),
    "qe_percent": ("qe", "eta"),
    "dsnu_e": ("dsnu1288.pixel", "dsnu1288", "dsnu"),
    "dsnu_row_e": ("dsnu1288.row",),
    "dsnu_column_e": ("dsnu1288.column",),
    "prnu_percent": ("prnu1288.pixel", "prnu1288", "prnu"),
    "dark_current_e_per_s": ("mu_c", "u_i", "mu_i", "mu_i.mean"),
}


def read_emva_camera(path: Path | str, folder: Path | str, sensor: Sensor) -> CameraModel:
    """A model of ``sensor`` with the datasheet's gain, noise, capacity and non-uniformity; ``qe.csv`` goes into ``folder``.

    Raises
    ------
    InputError
        If the file is no datasheet of EMVA 1288, or states no gain or no dark noise.
    """
    path, folder = Path(path), Path(folder)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    if not recognises(text):
        raise InputError(f"{path}: is neither an XML of EMVA 1288 results nor a CSV with the columns symbol and value")
    stated = {key.lower(): value for key, value in quantities(text, str(path)).items()}
    found = {name: stated[s] for name, symbols in SYMBOLS.items() for s in symbols[::-1] if s in stated}
    if missing := [SYMBOLS[name][0] for name in ("gain_dn_per_e", "dark_noise_e") if name not in found]:
        raise InputError(f"{path}: states no {' and no '.join(missing)}; it has {', '.join(stated) or 'nothing'}")
    return emva_camera(path.stem, sensor, found, folder, said=f"measured: {path.name}", lacking=f"{path.name} does not state it")


def emva_camera(name: str, sensor: Sensor, found: Mapping[str, float], folder: Path, *, said: str, lacking: str) -> CameraModel:
    """The linear model that EMVA 1288 assumes, with numbers ``found`` by the names of `SYMBOLS`; ``qe.csv`` goes into ``folder``.

    ``said`` is the source of each number, ``lacking`` the reason why one is a guess.
    """
    write_whole(folder / "qe.csv", _qe_table(found.get("qe_percent"), sensor, said, lacking))
    steps = _steps(found, {"source": said}, {"source": f"estimated: {lacking}"})
    return CameraModel(name, sensor, tuple(make_effect(step, values, name, folder) for step, values in steps))


def _steps(found: Mapping[str, float], told: dict[str, str], guessed: dict[str, str]) -> list[tuple[str, dict[str, Any]]]:
    steps: list[tuple[str, dict[str, Any]]] = [
        ("aperture", {"f_number": 8.0, "source": "stated: EMVA 1288, a disc seen under f/8, no lens"}),
        ("quantum_efficiency", {"file": "qe.csv"} | (told if "qe_percent" in found else guessed)),
        ("cfa", {}),
    ]
    if "prnu_percent" in found:
        steps.append(("prnu", {"sigma_percent": found["prnu_percent"]} | told))
    if "dark_current_e_per_s" in found:
        steps.append(("dark_current", {"rate_e_per_s": found["dark_current_e_per_s"]} | told))
    steps.append(("shot_noise", {"source": "law: Poisson statistics"}))
    if "well_e" in found:
        steps.append(("full_well", {"well_e": found["well_e"]} | told))
    if "dsnu_e" in found:
        steps.append(("dsnu", {"sigma_e": found["dsnu_e"]} | told))
    steps += [
        ("read_noise", {"sigma_e": found["dark_noise_e"]} | told),
        ("conversion_gain", {"gain_dn_per_e": found["gain_dn_per_e"]} | told),
    ]
    for key, pattern in (("dsnu_row_e", "row_fpn"), ("dsnu_column_e", "column_fpn")):
        if key in found:
            steps.append((pattern, {"sigma_dn": found[key] * found["gain_dn_per_e"]} | told))
    steps += [
        ("black_level", {}),
        ("quantization", {}),
    ]
    return steps


def _qe_table(percent: float | None, sensor: Sensor, source: str, lacking: str) -> str:
    """The one number of the light at all wavelengths: it was measured in one narrow band."""
    value = 0.5 if percent is None else percent / 100
    columns = ["MONO"] if sensor.cfa == "MONO" else ["R", "G", "B"]
    said = f"{lacking}, 0.5 is a guess" if percent is None else f"{percent:.4g} % at the one wavelength of the light; {source}"
    rows = [f"{wave}," + ",".join(f"{value:g}" for _ in columns) for wave in (380, 780)]
    return "\n".join([f"# quantum efficiency: {said}", "wavelength_nm," + ",".join(columns), *rows]) + "\n"
