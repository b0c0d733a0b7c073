"""Where a capture comes from: facts for people, some of them worked out only when they are asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any


class Provenance(Mapping[str, Any]):
    """Facts that nobody changes.

    Parameters
    ----------
    known : mapping
    later : mapping, optional
        Name -> function that gives the fact: called once, when it is first looked at, and then let go with all it holds.
    """

    def __init__(self, known: Mapping[str, Any], later: Mapping[str, Callable[[], Any]] | None = None) -> None:
        self._later = dict(later or {})
        self._facts = dict.fromkeys(self._later) | dict(known)

    @classmethod
    def of(cls, facts: Mapping[str, Any]) -> Provenance:
        """Facts of any kind; what is to come stays to come."""
        return facts if isinstance(facts, Provenance) else cls(facts)

    def __getitem__(self, name: str) -> Any:
        make = self._later.get(name)
        if make is not None:
            self._facts[name] = make()
            self._later.pop(name, None)
        return self._facts[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._facts)

    def __len__(self) -> int:
        return len(self._facts)

    def __repr__(self) -> str:
        return f"Provenance({dict(self)})"

    def __or__(self, other: Mapping[str, Any]) -> dict[str, Any]:
        return dict(self) | dict(other)

    def __ror__(self, other: Mapping[str, Any]) -> dict[str, Any]:
        return dict(other) | dict(self)

    def __reduce__(self) -> tuple[type[Provenance], tuple[dict[str, Any]]]:
        return Provenance, (dict(self),)
