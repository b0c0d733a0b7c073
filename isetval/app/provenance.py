"""What a result was made from: command, versions, and the SHA-256 of every input."""

from __future__ import annotations

import importlib.metadata
import platform
import sys
from collections.abc import Iterable, Mapping
from typing import Any

from isetval.core.version import VERSION

_NAMED = ("numpy", "scipy", "pandas", "rawpy", "opencv-contrib-python-headless", "mitsuba")
METRIC_VERSIONS = {
    "chart": 1,
    "dark": 6,
    "find_edges": 3,
    "flat_fields": 7,
    "noise_by_level": 3,
    "patches": 2,
    "photon_transfer": 8,
    "relative_illumination": 2,
    "sfr": 4,
    "uniform_patches": 1,
}
"""A changed number is a changed metric version, and a line in CHANGELOG.md."""


def versions() -> dict[str, str]:
    """Versions of isetval, Python and the libraries that numbers depend on."""
    out = {"isetval": VERSION, "python": platform.python_version(), "platform": sys.platform}
    for name in _NAMED:
        try:
            out[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            out[name] = "not installed"
    return out


def provenance(argv: Iterable[str], inputs: Mapping[str, str]) -> dict[str, Any]:
    """The part of a result that says where it comes from.

    Parameters
    ----------
    argv : words of the command line, without the program's name
    inputs : path -> SHA-256
    """
    return {
        "command": ["isetval", *argv],
        "versions": versions(),
        "metric_versions": METRIC_VERSIONS,
        "inputs": {path: {"sha256": digest} for path, digest in inputs.items()},
    }
