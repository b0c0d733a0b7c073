"""The directories of a TIFF, walked before anything is read from them: a file may be hostile, so all of it has a budget.

Layout: TIFF 6.0, section 2.  The budgets are far above what cameras write and keep every later step within
seconds and within a small multiple of the file's size.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

from isetval.core.errors import InputError
from isetval.files.picture_file import Buffer, refusal

MOST_DIRECTORIES = 64  # phones write 2 to 6, Adobe's converter up to 12
MOST_SUB_DIRECTORIES = 32  # of one directory
MOST_TAGS = 1000  # of one directory; DNG, Exif and TIFF/EP together know some 400
MOST_VALUES = 100_000  # of one tag of numbers: the offsets of 100,000 strips, a color table of 46 x 46 x 46
NUMBER_BYTES = {3: 2, 4: 4, 5: 8, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}  # TIFF types but text and plain bytes
SUB_DIRECTORIES, POINTERS = 330, (34665, 34853, 40965)  # SubIFDs; Exif, GPS and interoperability directories
REMEDY = "use the original file; this one is damaged or made to cost memory and time"


@dataclass
class _Walk:
    """One walk over a file: where it has been, and what is left to see."""

    path: object
    data: Buffer
    order: str
    seen: set[int] = field(default_factory=set)

    def refuse(self, found: str, needed: str) -> InputError:
        return refusal(self.path, found, needed, REMEDY)

    def directory(self, at: int) -> tuple[list[tuple[int, int, int, int]], int]:
        """Entries (tag, type, number of values, place of the value field) and the place of the next directory."""
        if at in self.seen:
            raise self.refuse(f"its directories form a loop at byte {at}", "directories that end")
        self.seen.add(at)
        if len(self.seen) > MOST_DIRECTORIES:
            raise self.refuse(f"it has more than {MOST_DIRECTORIES} directories", f"at most {MOST_DIRECTORIES}")
        if at + 2 > len(self.data):
            return [], 0
        (count,) = struct.unpack_from(self.order + "H", self.data, at)
        if count > MOST_TAGS:
            raise self.refuse(f"its directory at byte {at} has {count} tags", f"at most {MOST_TAGS}")
        end = at + 2 + 12 * count
        if end > len(self.data):
            return [], 0
        entries = [(*struct.unpack_from(self.order + "HHI", self.data, p), p + 8) for p in range(at + 2, end, 12)]
        following = struct.unpack_from(self.order + "I", self.data, end)[0] if end + 4 <= len(self.data) else 0
        return entries, following

    def longs(self, count: int, field_at: int) -> tuple[int, ...]:
        """The values of a tag of 32-bit numbers, as many as lie in the file."""
        place = field_at if count == 1 else struct.unpack_from(self.order + "I", self.data, field_at)[0]
        count = min(count, max(0, len(self.data) - place) // 4)
        if count < 1:
            return ()
        return struct.unpack_from(f"{self.order}{count}I", self.data, place)


def check_directories(path: object, data: Buffer) -> None:
    """Refuse a TIFF whose directories exceed the budgets; damage that only loses a tag is left to the parser.

    Raises
    ------
    InputError
        For loops, too many directories, sub-directories, tags, or values of one tag.
    """
    if bytes(data[:4]) not in (b"II*\0", b"MM\0*") or len(data) < 8:
        return
    walk = _Walk(path, data, "<" if bytes(data[:2]) == b"II" else ">")
    left = list(walk.longs(1, 4))
    while left:
        at = left.pop()
        if at:
            entries, following = walk.directory(at)
            left += [following, *_children(walk, entries)]


def _children(walk: _Walk, entries: list[tuple[int, int, int, int]]) -> Iterator[int]:
    """Places of the directories that a directory names; its tags are counted on the way."""
    for tag, kind, count, field_at in entries:
        size = NUMBER_BYTES.get(kind, 0) * count
        if count > MOST_VALUES and 0 < size <= len(walk.data):
            raise walk.refuse(f"tag {tag} has {count} values", f"at most {MOST_VALUES}")
        if tag == SUB_DIRECTORIES and kind in (4, 13):
            if count > MOST_SUB_DIRECTORIES:
                raise walk.refuse(f"a directory has {count} sub-directories", f"at most {MOST_SUB_DIRECTORIES}")
            yield from walk.longs(count, field_at)
        elif tag in POINTERS and kind in (4, 13) and count == 1:
            yield from walk.longs(1, field_at)
