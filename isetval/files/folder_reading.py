"""Reading a laboratory's folder: every raw file at every level, and a sentence for each that cannot be used."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from isetval.core.errors import InputError
from isetval.files.captures import FileCaptures
from isetval.files.file_facts import FileFacts, facts_of
from isetval.files.raw_files import files_below, nothing_in

Progress = Callable[[str, int, int], None]
TURNS_DEG = {1: 0.0, 3: 180.0, 6: 90.0, 8: 270.0}  # Exif orientation, how the camera was turned
PICTURES = (".jpg", ".jpeg", ".heic", ".mp4", ".tif", ".tiff", ".png", ".npy")  # whose levels nobody stated


@dataclass(frozen=True, eq=False)
class FolderFacts:
    """What a folder holds: facts of the files of one camera, captures to look at again, and what was left out and why.

    ``others`` are files of the same levels with pixels of another size (resampled or binned pictures): they need a
    campaign of their own, since a campaign has one sensor.
    """

    folder: Path
    facts: tuple[FileFacts, ...]
    captures: FileCaptures
    refused: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]
    others: tuple[tuple[FileFacts, ...], ...] = ()

    def parts(self) -> tuple[FolderFacts, ...]:
        """The folder once for each size of pixels; what was left out is told with the first."""
        own = replace(self, others=())
        return (own, *(replace(own, facts=facts, refused=(), notes=()) for facts in self.others))


def read_folder(folder: Path, *, progress: Progress | None = None) -> FolderFacts:
    """Read all raw files below a folder.

    Raises
    ------
    InputError
        If there is no folder, no raw file in it, or none that can be read.
    """
    from isetval.files.capture_file import read_capture

    if not folder.is_dir():
        raise InputError(f"{folder}: is no folder; name the folder that holds the raw files")
    files = [path.relative_to(folder).as_posix() for path in files_below(folder)]
    if not files:
        raise InputError(nothing_in(folder))
    captures = FileCaptures({"": files}, lambda _, file: read_capture(folder / file), folder=folder)
    facts = []
    for i, file in enumerate(files):
        capture = captures.look_ahead("", file)
        if capture is not None:
            try:
                parent = Path(file).parent.as_posix()
                facts.append(facts_of(file, "" if parent == "." else parent, capture, rotation_deg=_turned(folder / file)))
            except Exception as error:  # one odd file must not lose the others
                captures.refuse(file, error)
        if progress is not None:
            progress(f"reading {file}", i + 1, len(files))
    if not facts:
        file, reason = captures.skipped[0]
        raise InputError(f"{folder}: none of its {len(files)} raw files can be read; the first: {file}: {reason}")
    facts, copies = _without_copies(facts)
    mine, resampled, others = _one_camera(facts)
    read = {folder / file for file in files}
    rest = [path for path in folder.rglob("*") if path.is_file() and path.suffix.lower() in PICTURES and path not in read]
    notes = (
        [f"{len(rest)} pictures without a sidecar of levels ({rest[0].name} ...) are no raw data and were not looked at"]
        if rest
        else []
    )
    return FolderFacts(folder, tuple(mine), captures, (*captures.skipped, *copies, *others), tuple(notes), resampled)


def _without_copies(facts: Sequence[FileFacts]) -> tuple[list[FileFacts], list[tuple[str, str]]]:
    """Files but for copies of others, byte by byte, and a sentence for each copy: noise seen twice would count as agreement."""
    first: dict[str, str] = {}
    copies = {}
    for fact in facts:
        if fact.digest and fact.noisy and first.setdefault(fact.digest, fact.file) != fact.file:
            copies[fact.file] = f"is a copy of {first[fact.digest]}, byte by byte; its noise would be counted twice"
    return [fact for fact in facts if fact.file not in copies], list(copies.items())


def _turned(path: Path) -> float:
    """How the camera was turned, by the file's orientation tag."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as tiff:
            tag = tiff.pages[0].tags.get(274)
            return TURNS_DEG.get(int(tag.value), 0.0) if tag is not None else 0.0
    except (tifffile.TiffFileError, OSError, ValueError):
        return 0.0


def _one_camera(
    facts: Sequence[FileFacts],
) -> tuple[list[FileFacts], tuple[tuple[FileFacts, ...], ...], list[tuple[str, str]]]:
    """The files of the camera that took most, those of the same camera in other pixels, and a sentence for each of the rest."""

    def camera(fact: FileFacts) -> tuple[object, ...]:
        return (fact.camera, fact.sensor.white_dn, fact.sensor.bits, fact.sensor.pixel_um, fact.sensor.cfa == "MONO")

    most = Counter(camera(fact) for fact in facts).most_common(1)[0][0]
    twins = [key for key in dict.fromkeys(map(camera, facts)) if key != most and (*key[:3], key[4]) == (*most[:3], most[4])]
    resampled = tuple(tuple(fact for fact in facts if camera(fact) == key) for key in twins)

    def words(key: tuple[object, ...]) -> str:
        return f"{key[0] or 'an unnamed camera'} with {key[2]} bits, white at {key[1]:g} DN and pixels of {key[3]:g} um"

    others = [
        (
            fact.file,
            f"was taken by {words(camera(fact))}, most files by {words(most)}; make a campaign of its own for it",
        )
        for fact in facts
        if camera(fact) != most and camera(fact) not in twins
    ]
    return [fact for fact in facts if camera(fact) == most], resampled, others
