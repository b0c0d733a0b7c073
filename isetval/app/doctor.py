"""What is installed, and which Mitsuba variant is used and why."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from isetval.app.provenance import versions
from isetval.core.errors import MissingPartError
from isetval.core.toml import data_folder


@dataclass(frozen=True)
class Checkup:
    """One part: ``state`` is ok, absent (optional) or broken; ``remedy`` says what to do."""

    part: str
    state: str
    found: str
    remedy: str = ""


def examine() -> tuple[list[Checkup], Mapping[str, Any]]:
    """Every part of the installation, and the choice of the Mitsuba variant (a render in a child process)."""
    from isetval.scenes.rendered.variants import choose_variant

    checks = [*_libraries(), _data(), _opencv(), *_tools()]
    try:
        choice = choose_variant("auto")
        words = f"{choice.variant}{' with ' + choice.library if choice.library else ''}: {choice.reason}"
        checks.append(Checkup("mitsuba variant", "ok", words, choice.cure))
        return checks, asdict(choice)
    except MissingPartError as error:
        checks.append(Checkup("mitsuba variant", "broken", str(error), "unset ISETVAL_VARIANT, or mend what it names"))
        return checks, {"error": str(error)}


def _libraries() -> list[Checkup]:
    out = []
    for name, version in versions().items():
        if name in ("isetval", "platform"):
            continue
        state = "broken" if version == "not installed" else "ok"
        out.append(Checkup(name, state, version, f"pip install {name}" if state == "broken" else ""))
    out.append(Checkup("cores", "ok", str(os.cpu_count())))
    out.append(Checkup("interpreter", "ok", sys.executable))
    return out


def _data() -> Checkup:
    folder = data_folder()
    there = (folder / "pixel4a" / "camera.toml").is_file() and (folder / "demo" / "plan.toml").is_file()
    return Checkup("embedded data", "ok" if there else "broken", str(folder), "" if there else "install isetval again")


def _opencv() -> Checkup:
    """A second OpenCV wheel replaces cv2 without a word."""
    import importlib.metadata

    names = {dist.metadata["Name"].lower() for dist in importlib.metadata.distributions() if dist.metadata["Name"]}
    wheels = sorted(n for n in names if n.startswith("opencv-"))
    if len(wheels) == 1:
        return Checkup("opencv wheel", "ok", wheels[0])
    remedy = "pip uninstall all of them, then pip install opencv-contrib-python-headless"
    return Checkup("opencv wheel", "broken", ", ".join(wheels) or "none", remedy)


def _tools() -> list[Checkup]:
    out = []
    for names, use in (
        (("chromium", "chromium-browser", "google-chrome"), "looks at the report in tests"),
        (("exiftool",), "checks DNGs in tests"),
    ):
        path = next((found for name in names if (found := shutil.which(name))), None)
        out.append(Checkup(names[0], "ok" if path else "absent", path or f"optional: {use}"))
    return out
