"""The frames that an EMVA 1288 descriptor names: where they lie now, their levels, and the black level of the darks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path, PurePosixPath

import numpy as np

from isetval.core.campaign import Shot
from isetval.core.capture import Capture
from isetval.core.errors import InputError
from isetval.core.sensor import Sensor
from isetval.core.toml import inside
from isetval.files.emva_lines import FILE_NAME, Series
from isetval.files.image_file import SUFFIXES, read_image

DEPTH_BITS = 16  # of the samples that files have room for
UNEVEN = 0.1  # ours: the four places of a 2 x 2 cell differ by some percent at most in one colour (PRNU, uneven readout)


@dataclass(frozen=True)
class FrameFinder:
    """Finds the frames of a descriptor that was written elsewhere.

    A name is taken as it stands; where no such file lies in the folder, the longest end of its path that does, in letters of
    either case and with any suffix of a picture (sets are copied from Windows disks and converted).
    """

    folder: Path

    @cached_property
    def _lying(self) -> dict[str, list[str]]:
        """Paths of the folder's pictures by what they are looked up by."""
        found: dict[str, list[str]] = {}
        for path in sorted(self.folder.rglob("*")):
            if path.suffix.lower() in SUFFIXES and path.is_file():
                name = path.relative_to(self.folder).as_posix()
                for key in {name.lower(), str(PurePosixPath(name.lower()).with_suffix(""))}:
                    found.setdefault(key, []).append(name)
        return found

    def __call__(self, written: str) -> str:
        """The frame's path in the folder, with forward slashes; as it is written where there is none.

        Raises
        ------
        InputError
            If the path leads out of the folder, and no end of it is found inside.
        """
        name = written.replace("\\", "/")
        parts = PurePosixPath(name).parts
        if ".." not in parts and not name.startswith("/") and (self.folder / name).is_file():
            return inside(self.folder, name).relative_to(self.folder).as_posix()
        if ".." not in parts:
            for k in range(len(parts)):
                end = PurePosixPath(*parts[k:]).as_posix().lower()
                for key in (end, str(PurePosixPath(end).with_suffix(""))):
                    if len(names := self._lying.get(key, [])) == 1:
                        return inside(self.folder, names[0]).relative_to(self.folder).as_posix()
        if parts and parts[0].endswith(":"):
            raise InputError(
                f"{self.folder}: the frame {written!r} is on another computer's disk; copy the frames beside the descriptor"
            )
        inside(self.folder, name)
        return name


def found_frames(folder: Path, series: Sequence[Series]) -> tuple[list[tuple[str, ...]], str]:
    """Where the frames of each series lie, and a sentence on those that lie elsewhere than written (empty where none does).

    Raises
    ------
    InputError
        If a path leads out of the folder, or two names lead to the same file.
    """
    find = FrameFinder(folder)
    written: dict[str, str] = {}
    out, moved = [], []
    for one in series:
        names = tuple(find(name) for name in one.files)
        for said, name in zip(one.files, names, strict=True):
            if written.setdefault(name, said) != said:
                raise InputError(f"{folder}: the frames {written[name]!r} and {said!r} are one file, {name}; give each its own")
            if name != said.replace("\\", "/"):
                moved.append((said, name))
        out.append(names)
    if not moved:
        return out, ""
    said, name = moved[0]
    return out, f"{len(moved)} frames do not lie where the descriptor says and were found by their names: {said!r} is {name}"


@dataclass(frozen=True, eq=False)
class FrameReader:
    """Reads a frame of a shot with what the descriptor states."""

    folder: Path
    sensor: Sensor
    shots: dict[str, Shot]

    def __call__(self, name: str, file: str) -> Capture:
        """Frame ``file`` of the shot ``name``; refused where its size is not the stated one."""
        said = {
            "cfa": self.sensor.cfa,
            "black_dn": self.sensor.black_dn[0][0],
            "bits": self.sensor.bits,
            "pixel_um": self.sensor.pixel_um,
        }
        capture = read_image(inside(self.folder, file), said)
        if capture.mosaic.shape != (self.sensor.rows, self.sensor.cols):
            found, wanted = " x ".join(map(str, capture.mosaic.shape)), f"{self.sensor.rows} x {self.sensor.cols}"
            raise InputError(f"{file}: has {found} pixels, the descriptor says {wanted} (rows x columns); correct one of them")
        provenance = dict(capture.provenance) | {"sidecar": FILE_NAME, "black_used": "mean of the shortest dark frames"}
        return Capture(capture.mosaic, self.sensor, (0, 0), self.shots[name].exposure, provenance)


def frame_of_level(read: FrameReader, share: float) -> Capture | None:
    """The first frame that can be read of the flats' level at ``share`` of their number, by photons; None without one."""
    flats = sorted((s for s in read.shots.values() if s.role == "flat"), key=lambda s: s.photons_per_pixel or 0.0)
    for shot in flats[round(share * (len(flats) - 1)) :][:1]:
        for file in shot.files:
            try:
                return read(shot.name, file)
            except InputError:
                continue
    return None


def deepest(read: FrameReader) -> FrameReader:
    """The reader with all the bits that a file has room for: what the codes are, whatever the descriptor says."""
    return replace(read, sensor=replace(read.sensor, bits=DEPTH_BITS, white_dn=2.0**DEPTH_BITS - 1))


def check_codes(bright: Capture | None, bits: int, path: Path) -> None:
    """Refuse frames whose codes exceed the stated bits; None says nothing.

    Raises
    ------
    InputError
        With what the codes look like: shifted to the upper bits of the file, or of more bits.
    """
    highest = 0 if bright is None else int(bright.mosaic.max())
    if bright is None or highest < 2**bits:
        return
    file = bright.provenance.get("file")
    step = int(np.bitwise_or.reduce(bright.mosaic, axis=None))
    zeros = (step & -step).bit_length() - 1
    what = f"{path}: {file} holds codes to {highest}, the line n states {bits} bits (codes to {2**bits - 1})"
    if zeros >= DEPTH_BITS - bits:
        raise InputError(
            f"{what}; all are multiples of {2**zeros}, shifted up by {zeros} bits: divide them by {2**zeros}, and save"
        )
    raise InputError(f"{what}; write {max(highest.bit_length(), bits)} bits there, or save the frames as the camera gives them")


def looks_colored(lit: Capture, black_dn: float) -> str:
    """A sentence where the four places of a 2 x 2 cell see different light, which one channel does not; empty otherwise."""
    means = [float(lit.mosaic[r::2, c::2].mean()) - black_dn for r in (0, 1) for c in (0, 1)]
    if lit.sensor.cfa != "MONO" or min(means) <= 0 or max(means) < (1 + UNEVEN) * min(means):
        return ""
    shares = ", ".join(f"{m / max(means):.2f}" for m in means)
    return (
        f"the four places of each 2 x 2 cell differ ({shares} of the brightest): this looks like a colour mosaic, whose pattern "
        "the format does not state; name a camera model with its cfa (--camera), else the mosaic counts as PRNU"
    )


def black_dn(read: FrameReader, shots: Sequence[Shot], path: Path) -> tuple[float, str]:
    """Mean of the dark frames of the shortest exposure, and the sentence that says so.

    Raises
    ------
    InputError
        If no dark frame can be read.
    """
    darks = sorted((s for s in shots if s.role == "dark"), key=lambda s: s.exposure.time_s or 0.0)
    reasons = []
    for shot in darks:
        means = []
        for file in shot.files:
            try:
                mosaic = read(shot.name, file).mosaic
            except InputError as error:
                reasons.append(str(error))
                continue
            means.append(float(mosaic.mean()))
        if means:
            words = f"mean of {len(means)} dark frames of the shortest exposure ({shot.name}), an error that all shots share: "
            words += 'a nuisance "black_level.offset_dn" of scope "campaign" (isetval campaign init drafts it)'
            return float(np.mean(means)), f"black level {np.mean(means):.3f} DN: {words}"
    why = f"none can be read; the first: {reasons[0]}" if reasons else "it lists none"
    raise InputError(f"{path}: needs a dark series for the black level, and {why}")
