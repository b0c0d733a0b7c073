"""Remarks for people: those that many shots share are said once, and a capture's quality before anything else."""

from __future__ import annotations

import re
from collections.abc import Sequence

SHOT = re.compile(r"shot (?P<shot>\S+?): (?P<text>.*)", re.S)
NUMBER = re.compile(r"\d+(?:\.\d+)?")
MANY = 3  # shots beyond which a remark that differs in its numbers alone is said once


def gathered(notes: Sequence[str]) -> list[str]:
    """The remarks; of those that differ only in the shot and in numbers, the first with the number of its like."""
    kinds: dict[str, list[str]] = {}
    for note in notes:
        found = SHOT.fullmatch(note)
        kinds.setdefault(NUMBER.sub("#", found["text"]) if found else note, []).append(note)
    out: list[str] = []
    for own in kinds.values():
        matches = [match for note in own if (match := SHOT.fullmatch(note))]
        if len(matches) <= MANY:
            out += dict.fromkeys(own)
            continue
        first, last = matches[0], matches[-1]
        out.append(f"{len(matches)} shots, {first['shot']} to {last['shot']}; the first: {first['text']}")
    return out


def quality_first(notes: Sequence[str]) -> tuple[list[str], list[str]]:
    """Verdicts on the quality of captures, and the other remarks."""
    verdicts = [note for note in notes if ": capture quality" in note]
    return verdicts, [note for note in notes if note not in verdicts]
