"""Remarks for people: those that many shots or files share are said once, and a capture's quality before anything else."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

OWNER = re.compile(r"(?:shot (?P<shot>\S+?)|(?P<file>[^:\s][^:]*\.\w{2,4})): (?P<text>.*)", re.S)
NUMBER = re.compile(r"\d+(?:\.\d+)?")
VERDICT = re.compile(r"capture quality: (?P<verdict>\w+)(?: \((?P<why>[^)]*)\))?")
MANY = 3  # shots or files beyond which a remark that differs in its numbers alone is said once


def gathered(notes: Sequence[str]) -> list[str]:
    """The remarks; of those that differ only in the shot or file and in numbers, the first with the number of its like."""
    kinds: dict[str, list[str]] = {}
    for note in notes:
        _, name, text = _parts(note)
        kinds.setdefault(NUMBER.sub("#", text) if name else note, []).append(note)
    out: list[str] = []
    for own in kinds.values():
        kind, first, text = _parts(own[0])
        if len(own) <= MANY or not first:
            out += dict.fromkeys(own)
        else:
            out.append(f"{len(own)} {kind}s, {first} to {_parts(own[-1])[1]}; the first: {text}")
    return out


def _parts(note: str) -> tuple[str, str, str]:
    """``shot`` or ``file``, its name, and what is said of it; a file's remark on its own shot without the shot."""
    found = OWNER.fullmatch(note)
    if not found:
        return "", "", note
    if found["shot"]:
        return "shot", found["shot"], found["text"]
    return "file", found["file"], found["text"].removeprefix(f"shot {found['file']}: ")


def quality_first(notes: Sequence[str]) -> tuple[list[str], list[str]]:
    """Verdicts on the quality of captures (of many, how often each was given and why), and the other remarks."""
    verdicts = [note for note in notes if ": capture quality" in note]
    others = [note for note in notes if note not in verdicts]
    if len(verdicts) <= MANY:
        return verdicts, others
    said = Counter(match["verdict"] for note in verdicts if (match := VERDICT.search(note)))
    why = Counter(reason for note in verdicts if (match := VERDICT.search(note)) for reason in (match["why"] or "").split(", "))
    words = ", ".join(f"{count} {verdict}" for verdict, count in said.most_common())
    reasons = ", ".join(f"{reason} in {count}" for reason, count in why.most_common() if reason)
    return [f"capture quality of {len(verdicts)} files: {words}" + (f" ({reasons})" if reasons else "")], others


def warnings_of(files: Mapping[str, Any]) -> list[str]:
    """What the readers warn of; of many files with one kind of warning, the first and how many there are."""
    kinds: dict[str, list[str]] = {}
    for about in files.values():
        for warning in about.get("warnings", ()):
            kinds.setdefault(str(warning.get("code", "")), []).append(str(warning["message"]))
    out: list[str] = []
    for own in kinds.values():
        alike = list(dict.fromkeys(own))
        out += alike if len(alike) <= MANY else [f"{len(own)} files; the first: {own[0]}"]
    return out
