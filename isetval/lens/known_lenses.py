"""Lens data that ships with the project: the default lens, and what makers state about known lens files."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache

from isetval.core.toml import data_folder
from isetval.lens.ray_transfer import RayTransferLens
from isetval.lens.transfer_file import load_lens

DEFAULT_LENS = "default_lens.json"


@dataclass(frozen=True)
class StatedFacts:
    """What is said about a lens outside its file.

    Attributes
    ----------
    f_number : mapping
        Name of the statement -> f-number.
    focus_object_m : mapping
        Film distance (mm, film to rear vertex) -> object distance (m) it is said to focus.
    film_mm : float or None
        Film distance at which the f-number holds.
    focal_length_mm, sensor_diagonal_mm : float or None
    source : str
    """

    f_number: Mapping[str, float] = field(default_factory=dict)
    focus_object_m: Mapping[float, float] = field(default_factory=dict)
    film_mm: float | None = None
    focal_length_mm: float | None = None
    sensor_diagonal_mm: float | None = None
    source: str = ""


@lru_cache(maxsize=1)
def default_lens() -> RayTransferLens:
    """The project's own lens, computed from the prescription in ``data/lens/default_lens.toml``."""
    return load_lens(data_folder() / "lens" / DEFAULT_LENS)


def stated_facts(lens_name: str) -> StatedFacts:
    """What the stored statements (``data/lens/*_stated.toml``) say about a lens of this name; empty if nothing."""
    for file in sorted((data_folder() / "lens").glob("*_stated.toml")):
        content = tomllib.loads(file.read_text(encoding="utf-8"))
        if lens_name in content.get("lens_names", []):
            return _facts(content)
    return StatedFacts()


def _facts(content: Mapping[str, object]) -> StatedFacts:
    """Statements from TOML content."""
    numbers = content.get("f_number", {})
    focus = content.get("focus", [])
    if not isinstance(numbers, dict) or not isinstance(focus, list):
        raise ValueError("f_number must be a table and focus an array of tables")
    film, focal, diagonal = (content.get(k) for k in ("film_mm", "focal_length_mm", "sensor_diagonal_mm"))
    return StatedFacts(
        f_number={str(k): float(v) for k, v in numbers.items()},
        focus_object_m={float(entry["film_mm"]): float(entry["object_m"]) for entry in focus},
        film_mm=None if film is None else float(str(film)),
        focal_length_mm=None if focal is None else float(str(focal)),
        sensor_diagonal_mm=None if diagonal is None else float(str(diagonal)),
        source=str(content.get("source", "")),
    )
