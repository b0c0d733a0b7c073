"""Remarks for people: those that many shots or files share are said once, and a capture's quality before anything else."""

from __future__ import annotations

import re
from collections.abc import Sequence

OWNER = re.compile(r"(?:shot (?P<shot>\S+?)|(?P<file>[^:\s][^:]*\.\w{2,4})): (?P<text>.*)", re.S)
NUMBER = re.compile(r"\d+(?:\.\d+)?")
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
    """Verdicts on the quality of captures, and the other remarks."""
    verdicts = [note for note in notes if ": capture quality" in note]
    return verdicts, [note for note in notes if note not in verdicts]
