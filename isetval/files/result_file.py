"""Results that the command line wrote, read back: one schema for each kind, so that a damaged file ends in one sentence.

What is read may come from anybody.  Fields that no reader here uses may be anything and are kept.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec

from isetval.core.errors import InputError
from isetval.core.json_file import read_json

REMEDY = "results are written with -o NAME.json"
Number = float | None
Words = str | None


class Input(msgspec.Struct, frozen=True):
    """An input file of a result."""

    sha256: str


class Provenance(msgspec.Struct, frozen=True):
    """What a result was made from."""

    command: list[str] = []
    versions: dict[str, str] = {}
    metric_versions: dict[str, int] = {}
    inputs: dict[str, Input] = {}


class Condition(msgspec.Struct, frozen=True):
    """What rows of all tables say of where they hold."""

    channel: Words = ""
    shot: Words = ""
    region: Words = ""
    patch: Words = ""
    role: Words = ""
    setup: Words = ""
    unit: Words = ""
    measurement_session: Words = ""
    frequency_cy_px: Number = None
    exposure_s: Number = None
    level: Number = None
    field_x_mm: Number = None
    field_y_mm: Number = None
    focus_um: Number = None


class MetricRow(Condition, kw_only=True, frozen=True):
    """A measured number."""

    name: str
    value: Number
    sigma: Number
    unit: str
    file: str = ""
    family: str = ""
    reason: str = ""


class ComparedRow(Condition, kw_only=True, frozen=True):
    """A number measured and simulated."""

    model: str
    family: str
    name: str
    measured: Number
    simulated: Number
    sigma: Number
    z: Number


class LadderRow(msgspec.Struct, frozen=True):
    """How far a model is off in a family."""

    model: str
    family: str
    role: str
    n: int
    mean_square_z: Number
    rms_relative_error: Number


class Skipped(msgspec.Struct, frozen=True):
    """A file that was left out."""

    file: str
    reason: str


class Quality(msgspec.Struct, frozen=True):
    """A remark of a reader."""

    message: str
    code: str = ""


class Exposed(msgspec.Struct, frozen=True):
    """How a file was exposed."""

    time_s: Number = None
    iso: Number = None


class Origin(msgspec.Struct, frozen=True):
    """Which camera made a file."""

    make: Words = None
    model: Words = None
    serial: Words = None
    date_time: Words = None


class Described(msgspec.Struct, frozen=True):
    """A file that was measured."""

    sha256: str = ""
    warnings: list[Quality] = []
    shape: list[int] | None = None
    exposure: Exposed = Exposed()
    provenance: Origin = Origin()


class Measured(msgspec.Struct, frozen=True):
    """Of ``isetval measure``."""

    metrics: list[MetricRow]
    files: dict[str, Described] = {}
    skipped: list[Skipped] = []
    notes: list[str] = []
    settings: dict[str, Any] = {}
    campaign: Words = None
    provenance: Provenance = Provenance()


class Estimate(msgspec.Struct, frozen=True):
    """A parameter with what is known of its error: null for what the data do not bound."""

    value: Number
    sigma: Number = None
    unit: str = ""
    nominal: Number = None


class NamedEffect(msgspec.Struct, frozen=True):
    """An effect that a diagnosis names."""

    name: str
    parameters: dict[str, Estimate]
    posterior: float
    equivalent: list[str]
    present_in_model: bool = False
    choices: dict[str, Any] | None = None
    fitted_to: list[str] | None = None


class Candidate(msgspec.Struct, frozen=True):
    """A line of the table of candidates."""

    name: str
    dchi2: Number
    p_corrected: float
    observable: bool
    estimate: dict[str, Estimate]
    posterior: Number = None


class NextCapture(msgspec.Struct, frozen=True):
    """A capture that would tell two candidates apart."""

    capture: str
    separates: tuple[str, str]
    rho_before: float
    rho_after: float


class Gate(msgspec.Struct, frozen=True):
    """Whether repeats agree."""

    run: bool = False
    failed: bool = False
    mean_square_z: Number = None
    n: int = 0
    allowed: Number = None
    reason: Words = None
    nominal_mean_square_z: Number = None


class Diagnosed(msgspec.Struct, frozen=True):
    """Of ``isetval diagnose``."""

    verdict: Literal["consistent", "attributed", "ambiguous", "partial", "unexplained", "gate_failed", "unfinished"]
    effects: list[NamedEffect]
    candidates: list[Candidate] = []
    unobservable: list[str] = []
    next_captures: list[NextCapture] = []
    leftover: Words = None
    not_looked_at: list[str] = []
    ladder: list[LadderRow] = []
    gate: Gate | None = None
    campaign: Words = None
    model: Words = None
    model_sha256: Words = None
    notes: list[str] = []
    settings: dict[str, Any] = {}
    provenance: Provenance = Provenance()


class Compared(msgspec.Struct, frozen=True):
    """Of ``isetval compare``."""

    models: list[str]
    table: list[ComparedRow]
    ladder: list[LadderRow]
    gate: Gate | None = None
    campaign: Words = None
    nuisances: dict[str, dict[str, tuple[Number, Number]]] = {}
    notes: list[str] = []
    settings: dict[str, Any] = {}
    provenance: Provenance = Provenance()


class Hidden(msgspec.Struct, frozen=True):
    """What a demo hid."""

    name: str
    parameters: dict[str, Estimate]


class Shown(msgspec.Struct, frozen=True):
    """Of ``isetval demo``."""

    seed: int
    diagnosis: Diagnosed
    after: Compared
    hidden: Hidden
    before: Compared | None = None
    provenance: Provenance = Provenance()


class AnsweredEffect(msgspec.Struct, frozen=True):
    """An effect that an answer to a challenge names."""

    name: str
    parameters: dict[str, Estimate]
    equivalent: list[str]


class Answer(msgspec.Struct, frozen=True):
    """An answer to a challenge: of a diagnosis what is scored."""

    effects: list[AnsweredEffect]
    verdict: Words = None


class TrueEffect(msgspec.Struct, frozen=True):
    """A hidden effect of a challenge."""

    name: str
    parameters: dict[str, float]
    also: list[str] = []


class Truth(msgspec.Struct, frozen=True):
    """The sealed answer of a challenge."""

    kind: str
    effects: list[TrueEffect]
    seed: int
    nonce: str


class Commitment(msgspec.Struct, frozen=True):
    """What a challenge committed to."""

    commitment: str


def read_result(path: Path | str, *, filled: bool = False) -> dict[str, Any]:
    """A result file of the command line, held against the schema of what it says it is.

    ``filled``: with the parts that may be left out in their places.

    Raises
    ------
    InputError
        If the file is missing, is not a JSON object, or a part of it is not what its kind has.
    """
    content = read_json(path, remedy=REMEDY)
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds no result of isetval (a JSON object is needed)")
    schema = _schema(content)
    return checked(content, schema, path, filled=filled)


def read_as(path: Path | str, schema: type[msgspec.Struct]) -> dict[str, Any]:
    """A JSON object of one kind.

    Raises
    ------
    InputError
        As `read_result`.
    """
    content = read_json(path, remedy=REMEDY)
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds no result of isetval (a JSON object is needed)")
    return checked(content, schema, path)


def checked(content: dict[str, Any], schema: type[msgspec.Struct], path: Path | str, *, filled: bool = False) -> dict[str, Any]:
    """The content if it fits the schema; ``filled`` as `read_result`.

    Raises
    ------
    InputError
        With the place, what was found and what is needed.
    """
    try:
        found = msgspec.convert(content, schema)
    except msgspec.ValidationError as error:
        raise InputError(f"{path}: {_sentence(str(error))}; {REMEDY}") from None
    return dict(_filled(content, msgspec.to_builtins(found))) if filled else content


def _filled(content: Any, whole: Any) -> Any:
    """The content with what only the schema's defaults have."""
    if isinstance(content, dict) and isinstance(whole, dict):
        return {**whole, **content, **{key: _filled(content[key], whole[key]) for key in content.keys() & whole.keys()}}
    if isinstance(content, list) and isinstance(whole, list | tuple):
        return [_filled(a, b) for a, b in zip(content, whole, strict=True)]
    return content


def _schema(content: Mapping[str, Any]) -> type[msgspec.Struct]:
    """The schema of what a result looks like."""
    if content.get("kind") == "demo":
        return Shown
    if "verdict" in content:
        return Diagnosed
    if "ladder" in content:
        return Compared
    return Measured if content.get("kind") == "measure" else _Any


class _Any(msgspec.Struct, frozen=True):
    """Any result: what rerun and report take from all of them."""

    kind: Words = None
    provenance: Provenance = Provenance()


def _sentence(words: str) -> str:
    """The library's words with the place first: ``metrics[0].value: Expected `float`, got `str```."""
    found = re.fullmatch(r"(.*?) - at `(?:key in )?\$\.?(.*)`", words, re.S)
    place, said = (found[2][:200], found[1]) if found else ("", words)
    return f"{place or 'the result'}: {said[:1].lower()}{said[1:300]}"
