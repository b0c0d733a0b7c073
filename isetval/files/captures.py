"""Captures that lie in files: decoded when their shot is read, each file once, broken ones listed and left out."""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import overload

from isetval.core.campaign import Campaign
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.memory import give_back_freed

HELD_PIXELS = 400_000_000  # 800 MB of frames: what a shot may keep in memory; longer series are decoded frame by frame
AHEAD_PIXELS = 70_000_000  # 140 MB of frames kept for the shots to come: a worker with its maps and libraries stays below 600 MB
AGAIN_PIXELS = 30_000_000  # 60 MB of frames beyond that were decoded last: a pair of 12 MP is looked at several times in a row,
# and windows of a plan of 400 frames are measured a second time in a smaller region
Reader = Callable[[str, str], Capture]
"""(shot name, file name) -> the capture."""


@dataclass(eq=False)
class _Record:
    """What happened to the files so far: shared by all parts of one campaign."""

    skipped: dict[str, str] = field(default_factory=dict)
    hashes: dict[str, str] = field(default_factory=dict)
    ahead: dict[str, Capture] = field(default_factory=dict)
    last: _LastDecoded = field(default_factory=lambda: _LastDecoded())


class FileCaptures:
    """The captures of shots whose frames are files.

    Parameters
    ----------
    files : mapping
        Shot name -> its files, in order of the frames.
    read : callable
        (shot name, file name) -> Capture.
    folder : Path, optional
        What file names are relative to, for ``hashes``.
    """

    def __init__(self, files: Mapping[str, Sequence[str]], read: Reader, *, folder: Path | None = None) -> None:
        self._files = {name: tuple(own) for name, own in files.items()}
        self._read, self._folder = read, folder
        self._record = _Record()

    @property
    def files(self) -> Mapping[str, tuple[str, ...]]:
        """Names of the files of each shot."""
        return self._files

    @property
    def skipped(self) -> Sequence[tuple[str, str]]:
        """(file, reason) of all that could not be read so far."""
        own = {file for files in self._files.values() for file in files}
        return tuple((file, reason) for file, reason in self._record.skipped.items() if file in own)

    @property
    def hashes(self) -> Mapping[str, str]:
        """Path -> SHA-256 of the bytes that were decoded."""
        return {str(self._folder / file if self._folder else file): sha for file, sha in self._record.hashes.items()}

    def __contains__(self, name: object) -> bool:
        return bool(self._files.get(str(name)))

    def __getitem__(self, name: str) -> Sequence[Capture]:
        if name not in self._files:
            raise KeyError(name)
        return self.read(name)

    def only(self, names: Iterable[str]) -> FileCaptures:
        """The captures of the named shots; what was read or skipped is known to both."""
        wanted = set(names)
        part = FileCaptures({n: f for n, f in self._files.items() if n in wanted}, self._read, folder=self._folder)
        part._record = self._record
        return part

    def read(self, name: str) -> Sequence[Capture]:
        """Frames of a shot without those that cannot be read; in memory, unless they are too many for it."""
        frames: list[Capture] = []
        good: list[str] = []
        held = 0
        for file in self._files.get(name, ()):
            capture = self._tried(name, file, kept=True)
            if capture is None:
                continue
            good.append(file)
            held += capture.mosaic.size
            if held <= HELD_PIXELS:
                frames.append(capture)
        return tuple(frames) if len(frames) == len(good) else Frames(good, self._from_last(name))

    def later(self, name: str) -> Sequence[Capture]:
        """Frames of a shot that was read before, each decoded again when it is looked at."""
        good = [file for file in self._files.get(name, ()) if file not in self._record.skipped]
        return Frames(good, self._from_last(name))

    def _from_last(self, name: str) -> Callable[[str], Capture]:
        last = self._record.last
        return lambda file: last.get((name, file), lambda: self._again(name, file))

    def grouped(self, files: Mapping[str, Sequence[str]]) -> FileCaptures:
        """The same files as the frames of other shots."""
        part = FileCaptures(files, self._read, folder=self._folder)
        part._record = self._record
        return part

    def take(self, name: str, file: str) -> Capture | None:
        """One frame that nobody else asks for; None where it cannot be read, with the reason in ``skipped``."""
        return self._tried(name, file)

    def refuse(self, file: str, error: Exception) -> None:
        """Leave a file out that was decoded but cannot be used."""
        self._record.skipped[file] = str(error) if isinstance(error, InputError) else defect_words(error)
        self._record.ahead.pop(file, None)

    def look_ahead(self, name: str, file: str) -> Capture | None:
        """One frame before its shot is read; kept for that, within the bound of memory."""
        capture = self._tried(name, file)
        held = sum(c.mosaic.size for c in self._record.ahead.values())
        if capture is not None and held + capture.mosaic.size <= AHEAD_PIXELS:
            self._record.ahead[file] = capture
        return capture

    def _tried(self, name: str, file: str, *, kept: bool = False) -> Capture | None:
        """A frame, or None with its reason in ``skipped``; a defect of ours is said to be one."""
        if file in self._record.ahead:
            return self._record.ahead.pop(file)

        def again() -> Capture:
            return self._again(name, file)

        try:
            stamp = self._stamp(file) if kept else None
            return again() if stamp is None else self._record.last.get((name, file, *stamp), again)
        except InputError as error:
            self._record.skipped[file] = str(error).removeprefix(f"{file}: ").removeprefix(f"{Path(file).name}: ")
        except Exception as error:  # one odd file must not lose the others
            self._record.skipped[file] = defect_words(error)
        return None

    def _stamp(self, file: str) -> tuple[int, int] | None:
        """Time and size of a file, by which a changed one is told; None where it cannot be looked at."""
        try:
            status = os.stat(self._folder / file) if self._folder is not None else None
        except OSError:
            return None
        return None if status is None else (status.st_mtime_ns, status.st_size)

    def _again(self, name: str, file: str) -> Capture:
        """A frame whose bytes are those of the first time."""
        capture = self._read(name, file)
        sha = str(capture.provenance.get("sha256", ""))
        if self._record.hashes.setdefault(file, sha) != sha:
            raise InputError(f"{file}: has changed while it was measured; leave the files alone and start again")
        self._record.skipped.pop(file, None)
        return capture


def defect_words(error: Exception) -> str:
    """The sentence for what is no fault of the file."""
    return f"a defect of isetval ({type(error).__name__}: {error}); please report it with the file"


class _LastDecoded:
    """The frames decoded last, of all series of a campaign, within `AGAIN_PIXELS`."""

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[str | int, ...], Capture] = OrderedDict()
        self._pixels = 0
        self._lock = threading.Lock()

    def get(self, key: tuple[str | int, ...], decode: Callable[[], Capture]) -> Capture:
        """The frame of a key, decoded unless it is one of the last."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        capture = decode()
        with self._lock:
            if key not in self._kept:
                self._pixels += capture.mosaic.size
            self._kept[key] = capture
            before = len(self._kept)
            while self._pixels > AGAIN_PIXELS and len(self._kept) > 1:
                self._pixels -= self._kept.popitem(last=False)[1].mosaic.size
            if len(self._kept) < before:
                give_back_freed()
        return capture


class Frames(Sequence[Capture]):
    """Frames that are decoded when they are looked at."""

    def __init__(self, files: Sequence[str], frame: Callable[[str], Capture]) -> None:
        self._files, self._frame = tuple(files), frame

    @overload
    def __getitem__(self, index: int) -> Capture: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Capture]: ...
    def __getitem__(self, index: int | slice) -> Capture | Sequence[Capture]:
        if isinstance(index, slice):
            return Frames(self._files[index], self._frame)
        return self._frame(self._files[index])

    def __len__(self) -> int:
        return len(self._files)


def input_hashes(campaign: Campaign) -> dict[str, str]:
    """SHA-256 of the campaign's own file, and of the bytes of all captures that were decoded so far."""
    from isetval.core.cache import file_hash

    name = campaign.provenance.get("descriptor", "campaign.toml")
    file = None if campaign.folder is None else campaign.folder / str(name)
    own = {str(file): file_hash(file)} if file is not None and file.is_file() else {}
    given = {name for shot in campaign.shots if shot.given is not None for name in shot.given.files}
    tables = {str(campaign.folder / name): file_hash(campaign.folder / name) for name in given} if campaign.folder else {}
    return own | tables | dict(campaign.captures.hashes)
