"""Campaign folders with some broken files: measured without them, and the broken ones listed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from isetval.core.campaign import Campaign
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.files.campaign_file import FileCaptures


class Forgiving(Mapping[str, tuple[Capture, ...]]):
    """Captures of a campaign folder; files that cannot be read are listed in ``skipped`` instead of raised."""

    def __init__(self, captures: FileCaptures, campaign: Campaign) -> None:
        self._captures = captures
        self._shots = {shot.name: shot for shot in campaign.shots}
        self.skipped: list[tuple[str, str]] = []

    def __getitem__(self, name: str) -> tuple[Capture, ...]:
        shot = self._shots[name]
        out = []
        for file in shot.files:
            try:
                out.append(self._captures.read(shot, file))
            except InputError as error:
                self.skipped.append((file, str(error)))
        return tuple(out)

    def __iter__(self) -> Iterator[str]:
        return iter(self._captures)

    def __len__(self) -> int:
        return len(self._captures)

    def values(self) -> Any:
        """File names per shot (not the pixels)."""
        return self._captures.values()


def forgiving(campaign: Campaign) -> tuple[Campaign, list[tuple[str, str]]]:
    """The campaign with its broken files left out as they are met, and the list they are entered in."""
    if not isinstance(campaign.captures, FileCaptures):
        return campaign, []
    captures = Forgiving(campaign.captures, campaign)
    return replace(campaign, captures=captures), captures.skipped


def hashes(campaign: Campaign) -> dict[str, str]:
    """SHA-256 of the campaign's file and of all its captures' files."""
    from isetval.core.hashing import file_hash

    if campaign.folder is None:
        return {}
    names = ["campaign.toml"] if (campaign.folder / "campaign.toml").is_file() else []
    names += [file for shot in campaign.shots for file in shot.files]
    return {str(campaign.folder / name): file_hash(campaign.folder / name) for name in dict.fromkeys(names)}
