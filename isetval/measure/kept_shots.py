"""What the analyses found in shots, kept by content: whoever asks for the same captures again waits for none of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isetval.core.cache import cache_folder, content_hash, load_arrays, prune, save_arrays, simulation_hash
from isetval.core.campaign import Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.metric import Block, Differences, Metric
from isetval.measure.works import Work, done, sent_or_done

KEPT_BYTES = 500_000_000  # 40 laboratory campaigns of two sessions with their smaller regions, 12 MB each (`isetval cache`)
TEXT = "text"
Blocks = list[tuple[str, Block]]
Analyzed = tuple[Blocks, list[str]]
"""Blocks of a shot by the names of their analyses, and remarks on what could not be measured."""


@dataclass(eq=False)
class KeptShots:
    """The store of what was found in the cache folder's ``shots``; what cannot be written there is measured again.

    Parameters
    ----------
    asked : str
        Content of all that decides about the numbers beside shot, captures and code: the choices of estimators.
    """

    asked: str
    folder: Path = field(default_factory=lambda: cache_folder() / "shots")
    missed: int = 0

    def key(self, shot: Shot, captures: Sequence[Capture]) -> str | None:
        """Hash of what numbers follow from; None of captures that are decoded as they are looked at, or have no content."""
        if not captures or not isinstance(captures, tuple):
            return None
        frames = [(c.mosaic, c.sensor, c.window, c.exposure) for c in captures]
        try:
            return content_hash((simulation_hash(), self.asked, shot, frames))
        except TypeError:
            return None

    def get(self, key: str | None) -> Analyzed | None:
        """What was found; None if nothing is kept or it cannot be read."""
        arrays = load_arrays(self._path(key)) if key else None
        try:
            return None if arrays is None else (unpacked(arrays), [])
        except (KeyError, TypeError, ValueError, InputError):
            return None

    def put(self, key: str | None, found: Analyzed) -> None:
        """Keep what was found, if it has a form that files hold; what some analysis could not measure is tried again."""
        blocks, remarks = found
        if key is None or remarks:
            return
        with suppress(TypeError):
            save_arrays(self._path(key), packed(blocks))

    def prune(self) -> None:
        """Let go of what was used longest ago, where the folder has become too large; not where nothing new was asked for."""
        if self.missed:
            prune(self.folder, max_bytes=KEPT_BYTES)

    def work(self, measure: Callable[..., Analyzed], shot: Shot, captures: Sequence[Capture], *more: Any) -> Work:
        """``measure(shot, captures, *more)``, whose result is kept by whoever does it; or what is kept of it."""
        key = self.key(shot, captures)
        known = self.get(key)
        self.missed += known is None
        return sent_or_done(_measured, shot, captures, self, key, measure, *more) if known is None else done(known)

    def _path(self, key: str) -> Path:
        return self.folder / f"{key[:32]}.npz"


def _measured(
    shot: Shot, captures: Sequence[Capture], kept: KeptShots, key: str | None, measure: Callable[..., Analyzed], *more: Any
) -> Analyzed:
    found = measure(shot, captures, *more)
    kept.put(key, found)
    return found


def packed(blocks: Blocks) -> dict[str, NDArray[Any]]:
    """Blocks as arrays: one of text (JSON), those of the blocks beside it.

    Raises
    ------
    TypeError
        If an analysis gave something that JSON does not hold or would give back as something else.
    """
    arrays: dict[str, NDArray[Any]] = {}
    told = []
    for i, (name, block) in enumerate(blocks):
        if block.correlation is not None:
            arrays[f"correlation {i}"] = block.correlation
        for k, loadings in enumerate(block.shared.values()):
            arrays[f"shared {i} {k}"] = loadings
        told.append(
            {
                "name": name,
                "metrics": [list(vars(m).values()) for m in block.metrics],
                "shared": list(block.shared),
                "choices": block.choices,
                "differences": asdict(block.differences),
            }
        )
    text = json.dumps(told)
    if _differs(json.loads(text), told):
        raise TypeError("choices that change in a file")
    return arrays | {TEXT: np.frombuffer(text.encode(), np.uint8)}


def unpacked(arrays: Mapping[str, NDArray[Any]]) -> Blocks:
    """From `packed`.

    Raises
    ------
    KeyError, TypeError, ValueError, InputError
        If it is something else.
    """
    blocks = []
    for i, own in enumerate(json.loads(arrays[TEXT].tobytes().decode())):
        block = Block(
            tuple(Metric(*row) for row in own["metrics"]),
            arrays.get(f"correlation {i}"),
            {label: arrays[f"shared {i} {k}"] for k, label in enumerate(own["shared"])},
            own["choices"],
            Differences(**own["differences"]),
        )
        blocks.append((own["name"], block))
    return blocks


def _differs(read: Any, written: Any) -> bool:
    """Whether what was read is of another kind anywhere: a tuple that became a list, a number that became a key of text."""
    if isinstance(written, Mapping):
        return not isinstance(read, dict) or list(read) != list(written) or any(_differs(read[k], v) for k, v in written.items())
    if isinstance(written, list):
        return len(read) != len(written) or any(map(_differs, read, written))
    return type(read) is not type(written) or (read != written and read == read)
