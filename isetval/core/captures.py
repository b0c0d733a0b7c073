"""The captures of a campaign: an object that hands out the frames of a shot when they are asked for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol

from isetval.core.capture import Capture


class Captures(Protocol):
    """What a campaign holds of its frames; nothing is opened before a shot is read."""

    @property
    def files(self) -> Mapping[str, tuple[str, ...]]:
        """Names of the files of each shot; empty for captures that were never written."""
        ...

    @property
    def skipped(self) -> Sequence[tuple[str, str]]:
        """(file, reason) of all that could not be read so far."""
        ...

    @property
    def hashes(self) -> Mapping[str, str]:
        """Path -> SHA-256 of the bytes that were read so far."""
        ...

    def read(self, name: str) -> Sequence[Capture]:
        """Frames of the shot ``name`` that can be read, none for a shot without captures."""
        ...

    def later(self, name: str) -> Sequence[Capture]:
        """The same frames, each decoded at the moment it is looked at."""
        ...

    def only(self, names: Iterable[str]) -> Captures:
        """The captures of the named shots."""
        ...

    def __contains__(self, name: object) -> bool: ...

    def __getitem__(self, name: str) -> Sequence[Capture]: ...


class MemoryCaptures(dict[str, Sequence[Capture]]):
    """Captures that are in memory: those of a simulation."""

    @property
    def files(self) -> Mapping[str, tuple[str, ...]]:
        """No files."""
        return {}

    @property
    def skipped(self) -> Sequence[tuple[str, str]]:
        """Nothing is ever skipped."""
        return ()

    @property
    def hashes(self) -> Mapping[str, str]:
        """No files, no hashes."""
        return {}

    def read(self, name: str) -> Sequence[Capture]:
        """Frames of the shot ``name``, or none."""
        return self.get(name, ())

    def later(self, name: str) -> Sequence[Capture]:
        """The same frames: they are in memory anyway."""
        return self.read(name)

    def only(self, names: Iterable[str]) -> MemoryCaptures:
        """The captures of the named shots."""
        return MemoryCaptures({name: self[name] for name in names if name in self})
