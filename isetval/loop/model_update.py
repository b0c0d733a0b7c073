"""Adding an effect to a model file: value, sigma and where they come from."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from isetval.camera.model import CameraModel
from isetval.camera.model_file import make_effect
from isetval.camera.model_writer import save_model
from isetval.core.cache import file_hash
from isetval.core.effect import Effect
from isetval.core.errors import InputError
from isetval.core.toml import PACKAGE_PREFIX
from isetval.core.writing import write_whole
from isetval.effects.free_form import PREFIX, freed
from isetval.files.result_file import Diagnosed, checked, read_result
from isetval.loop.model_update_color import KIND, spectral_qe_values


@dataclass(frozen=True, eq=False)
class NewValues:
    """Values of an effect's parameters, what is known of their errors, and their origin.

    ``tables`` are files that the values name, by name: they are written beside the model.
    """

    effect: str
    values: Mapping[str, Any]
    sigma: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    fitted_to: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    tables: Mapping[str, str] = field(default_factory=dict)

    def words(self) -> str:
        """The values on one line."""
        said = {k: v if isinstance(v, str) else f"{v:.5g}" for k, v in self.values.items()}
        parts = [f"{k} {v}" + (f" +- {self.sigma[k]:.2g}" if k in self.sigma else "") for k, v in said.items()]
        return f"{self.effect} with {', '.join(parts)}" if parts else self.effect


def from_result(effect: str, path: Path | str) -> NewValues:
    """The values that a result holds: those of a diagnosis, or filters and mixing that were fitted to charts.

    Raises
    ------
    InputError
        If the file is none of them, or does not tell of the effect.
    """
    result = read_result(path)
    return from_spectral_qe(effect, result, Path(path)) if result.get("kind") == KIND else from_diagnosis(effect, path)


def named_effects(path: Path | str) -> list[str]:
    """The effects that a diagnosis names.

    Raises
    ------
    InputError
        If the file is no diagnosis, or names none.
    """
    result = read_result(path)
    if "verdict" not in result or not isinstance(result.get("effects"), list):
        raise InputError(f"{path}: is no result of 'isetval diagnose'; make one with -o, or name the effect to add")
    checked(result, Diagnosed, path)
    if not result["effects"]:
        raise InputError(f"{path}: names no effect (verdict {result['verdict']}); there is nothing to add")
    return [str(entry["name"]) for entry in result["effects"]]


def from_diagnosis(effect: str, path: Path | str) -> NewValues:
    """The values that a diagnosis found.

    Raises
    ------
    InputError
        If the file is no diagnosis, or does not name the effect.
    """
    result = read_result(path)
    if "verdict" not in result or not isinstance(result.get("effects"), list):
        raise InputError(f"{path}: is no result of 'isetval diagnose'; make one with -o")
    checked(result, Diagnosed, path)
    named = {entry["name"]: entry for entry in result["effects"]}
    if effect not in named:
        also = sorted({e for entry in named.values() for e in entry["equivalent"]})
        hint = f"; {effect} is only named as indistinguishable, so set its values with --set" if effect in also else ""
        raise InputError(
            f"{path}: names {', '.join(named) or 'no effect'} (verdict {result['verdict']}), "
            f"not {effect}{hint or '; add one of those'}"
        )
    parameters = named[effect]["parameters"]
    if unknown := [name for name, p in parameters.items() if p["value"] is None]:
        raise InputError(f"{path}: gives no value for {', '.join(unknown)} of {effect}; set it with --set {unknown[0]}=...")
    return NewValues(
        effect,
        {name: p["value"] for name, p in parameters.items()} | dict(named[effect].get("choices") or {}),
        {name: p["sigma"] for name, p in parameters.items() if p.get("sigma") is not None},
        source=f"diagnosed from the campaign {result.get('campaign', '(unnamed)')}",
        fitted_to=tuple(map(str, named[effect].get("fitted_to") or [result.get("campaign", "diagnosis")])),
        provenance={
            "diagnosis": Path(path).name,
            "diagnosis_sha256": file_hash(path),
            "model_sha256": str(result.get("model_sha256", "")),
            "posterior": named[effect]["posterior"],
        },
    )


def from_spectral_qe(effect: str, result: Mapping[str, Any], path: Path) -> NewValues:
    """What a fit of the filters to charts says of an effect.

    Raises
    ------
    InputError
        If the result holds nothing of the effect.
    """
    found = spectral_qe_values(effect, result, str(path))
    return NewValues(
        effect,
        found.values,
        found.sigma,
        source=f"fitted to charts ({result.get('source') or path.name})",
        fitted_to=tuple(map(str, result.get("fitted_to") or ())),
        provenance={"result": path.name, "result_sha256": file_hash(path)},
        tables=found.tables,
    )


def from_settings(effect: str, settings: Sequence[str], *, option: str = "--set") -> NewValues:
    """Values from ``k=v`` words; ``option`` is where they were given, for messages.

    Raises
    ------
    InputError
        For a word that is no ``k=v``, a value that is no number, or an unknown parameter.
    """
    effect_class = type(make_effect(effect, {}, "add"))
    numbers = {p.name: p.unit for p in effect_class.parameters()}
    values: dict[str, Any] = {}
    for word in settings:
        key, mark, value = word.partition("=")
        if not mark:
            raise InputError(f"{option} {word}: no value; write parameter=value, as {next(iter(numbers), 'file')}=0.1")
        if key in numbers:
            try:
                values[key] = float(value)
            except ValueError:
                raise InputError(f"{option} {word}: {value!r} is no number; {key} needs one in {numbers[key]}") from None
        elif key in effect_class.files():
            values[key] = value if value.startswith(PACKAGE_PREFIX) else str(Path(value).resolve())
        elif key == "source" or key in effect_class.chosen():
            values[key] = value
        else:
            words = [name for name in effect_class.chosen() if name not in numbers]
            known = [*numbers, *effect_class.files(), *words, "source"]
            near = difflib.get_close_matches(key, known, n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise InputError(f"{option} {word}: effect {effect} has no {key!r}; it has {', '.join(known)}{hint}")
    source = str(values.pop("source", "set by hand"))
    return NewValues(effect, values, source=source)


def add_effect(model: CameraModel, new: NewValues, *, output: Path | str) -> CameraModel:
    """The model with the effect added or changed, written to ``output`` with the comments of its own file.

    Raises
    ------
    InputError
        If a value is out of bounds, the chain becomes badly ordered, or the file cannot be written.
    """
    new = _with_tables(new, Path(output))
    standing = model.effect(new.effect)
    effect = _changed(standing, new) if standing is not None else _made(new)
    name = Path(output).stem
    made = replace(model.with_effect(effect), name=name if name != model.name else f"{name}+{new.effect}")
    step: dict[str, Any] = {"sigma": dict(new.sigma)} if new.sigma else {}
    if new.provenance:
        step["provenance"] = dict(new.provenance)
    for file, text in new.tables.items():
        write_whole(file, text)
    save_model(made, output, steps={new.effect: step} if step else None)
    return replace(made, path=Path(output))


def _with_tables(new: NewValues, output: Path) -> NewValues:
    """The values with their tables' places beside the model: under their own names, or the model's where those are taken.

    Raises
    ------
    InputError
        If both names are taken.
    """
    places = {}
    for name in new.tables:
        free = [p for p in (output.parent / name, output.parent / f"{output.stem}_{name}") if not p.exists()]
        if not free:
            raise InputError(f"{output.parent}: holds {name} and {output.stem}_{name} already; write the model to another folder")
        places[name] = str(free[0].resolve())
    values = {key: places.get(value, value) if isinstance(value, str) else value for key, value in new.values.items()}
    return replace(new, values=values, tables={places[name]: text for name, text in new.tables.items()})


def _changed(effect: Effect, new: NewValues) -> Effect:
    if any(name.startswith(PREFIX) for name in new.values):
        effect = freed(effect)
    return effect.changed(**new.values, source=new.source, fitted_to=new.fitted_to)


def _made(new: NewValues) -> Effect:
    null = type(make_effect(new.effect, {}, "add"))
    start = {p.name: p.null for p in null.parameters() if p.tau is not None and not p.shape} if new.fitted_to else {}
    where = f"effect {new.effect}"
    effect = make_effect(new.effect, start | dict(new.values), where)
    return effect.changed(source=new.source, fitted_to=new.fitted_to)
