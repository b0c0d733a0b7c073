"""The numbers of an EMVA 1288 datasheet as a camera model: what it states, and a mark on what it does not."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from isetval.camera.model import CameraModel
from isetval.camera.model_file import make_effect
from isetval.core.errors import InputError
from isetval.core.sensor import Sensor
from isetval.core.writing import write_whole
from isetval.effects.dark_charge import DarkCurrentNonuniformity
from isetval.files.emva_datasheet import quantities, recognises

if TYPE_CHECKING:
    from isetval.measure.noise.emva import EmvaTable

Step = tuple[str, dict[str, Any]]

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
    "dark_current_nonuniformity_e_per_s": ("dcnu.pixel",),
}

CLEAR = 3.0  # sigmas above which a part of the pattern is taken into the model
# their sigma says whether there is such a pattern at all; other numbers every camera has.  Roots of a variance: at v +- s the
# root is known to s / (2 sqrt(v)), so that three sigmas of the variance are six of the root
PATTERNS = {
    "dsnu_e": 2 * CLEAR,
    "dsnu_row_e": 2 * CLEAR,
    "dsnu_column_e": 2 * CLEAR,
    "prnu_percent": 2 * CLEAR,
    "dark_current_e_per_s": CLEAR,
    "dark_current_nonuniformity_e_per_s": 2 * CLEAR,
}


def numbers_of(table: EmvaTable) -> dict[str, float]:
    """Numbers of a measured table by the names of `SYMBOLS`: what is said of all planes, else the mean over them.

    A pattern is taken where it stands out of its sigma in every plane: one pattern acts on all of them.

    Raises
    ------
    InputError
        If the series gave no gain or no dark noise.
    """
    found = {}
    for name, symbols in SYMBOLS.items():
        finite = [r for r in table.rows if math.isfinite(r.value)]
        named = ([r for r in finite if r.symbol.lower() == s] for s in (f"{symbols[0]}.mean", *symbols))
        rows = next(filter(None, named), [])
        if rows and (name not in PATTERNS or all(r.value > PATTERNS[name] * r.sigma for r in rows)):
            found[name] = float(np.mean([r.value for r in rows]))
    if lacking := [name for name in ("gain_dn_per_e", "dark_noise_e") if name not in found]:
        raise InputError(f"the series give no {' and no '.join(lacking)}")
    return found


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


def emva_camera(
    name: str,
    sensor: Sensor,
    found: Mapping[str, float],
    folder: Path,
    *,
    said: str,
    lacking: str,
    fitted_to: Sequence[str] = (),
) -> CameraModel:
    """The linear model that EMVA 1288 assumes, with numbers ``found`` by the names of `SYMBOLS`; ``qe.csv`` goes into ``folder``.

    ``said`` is the source of each number, ``lacking`` the reason why one is a guess, ``fitted_to`` what captures they are of.
    """
    write_whole(folder / "qe.csv", _qe_table(found.get("qe_percent"), sensor, said, lacking))
    told: dict[str, Any] = {"source": said} | ({"fitted_to": list(fitted_to)} if fitted_to else {})
    steps = _steps(found, told, {"source": f"estimated: {lacking}"})
    return CameraModel(name, sensor, tuple(make_effect(step, values, name, folder) for step, values in steps))


def _steps(found: Mapping[str, float], told: dict[str, Any], guessed: dict[str, Any]) -> list[Step]:
    return [
        ("aperture", {"f_number": 8.0, "source": "stated: EMVA 1288, a disc seen under f/8, no lens"}),
        ("quantum_efficiency", {"file": "qe.csv"} | (told if "qe_percent" in found else guessed)),
        ("cfa", {}),
        *sensor_steps(found, told),
    ]


def _uneven_dark_current(found: Mapping[str, float], told: Mapping[str, Any]) -> list[Step]:
    """Spread over the pixels in units of the mean, where both are known: then the lowest rate is zero, and none is below."""
    sigma, mean = found.get("dark_current_nonuniformity_e_per_s"), found.get("dark_current_e_per_s", 0.0)
    if sigma is None:
        return []
    spread = next(p for p in DarkCurrentNonuniformity.parameters() if p.name == "spread")
    relative = {"spread": float(np.clip(sigma / mean, spread.low, spread.high))} if mean > 0 else {}
    return [("dark_current_nonuniformity", {"sigma_e_per_s": sigma, **relative, **told})]


def sensor_steps(found: Mapping[str, float], told: Mapping[str, Any]) -> list[Step]:
    """Effects behind the colour filters, in order, with their parameters; ``told`` is said of each that ``found`` gives."""

    def given(key: str, effect: str, parameter: str, factor: float = 1.0) -> list[Step]:
        return [(effect, {parameter: found[key] * factor, **told})] if key in found else []

    gain = found["gain_dn_per_e"]
    return [
        *given("prnu_percent", "prnu", "sigma_percent"),
        *given("dark_current_e_per_s", "dark_current", "rate_e_per_s"),
        *_uneven_dark_current(found, told),
        ("shot_noise", {"source": "law: Poisson statistics"}),
        *given("well_e", "full_well", "well_e"),
        *given("dsnu_e", "dsnu", "sigma_e"),
        *given("dark_noise_e", "read_noise", "sigma_e"),
        *given("gain_dn_per_e", "conversion_gain", "gain_dn_per_e"),
        *given("dsnu_row_e", "row_fpn", "sigma_dn", gain),
        *given("dsnu_column_e", "column_fpn", "sigma_dn", gain),
        ("black_level", {}),
        ("quantization", {}),
    ]


def _qe_table(percent: float | None, sensor: Sensor, source: str, lacking: str) -> str:
    """The one number of the light at all wavelengths: it was measured in one narrow band."""
    value = 0.5 if percent is None else percent / 100
    columns = ["MONO"] if sensor.cfa == "MONO" else ["R", "G", "B"]
    said = f"{lacking}, 0.5 is a guess" if percent is None else f"{percent:.4g} % at the one wavelength of the light; {source}"
    rows = [f"{wave}," + ",".join(f"{value:g}" for _ in columns) for wave in (380, 780)]
    return "\n".join([f"# quantum efficiency: {said}", "wavelength_nm," + ",".join(columns), *rows]) + "\n"
