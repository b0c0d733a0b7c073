"""Which Mitsuba variant can be used here, found without risking this process.

Mitsuba 3.9 accepts libLLVM 15 and 16 and then aborts the process in the middle of a render, which no
``except`` can catch.  So a variant other than ``scalar_*`` is chosen only after a real 4 x 4 pixel render
with it has succeeded in a child process.  The answer is cached by Mitsuba version, library path and its
modification time; without such a file (CUDA) by the driver, and a failure then for this process alone: nothing would
tell that it was mended.  Nothing here imports Mitsuba.
"""

from __future__ import annotations

import glob
import importlib.metadata
import os
import re
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from isetval.core import cache
from isetval.core.cache import content_hash
from isetval.core.errors import InputError, MissingPartError

SCALAR = "scalar_spectral"
JIT_VARIANTS = ("cuda_ad_spectral", "llvm_ad_spectral")
CURE = "install libLLVM 19 (Debian and Ubuntu: apt install libllvm19), or point DRJIT_LIBLLVM_PATH at another libLLVM"
CUDA_CURE = (
    "CUDA needs an NVIDIA driver with its ray tracer: nvidia-smi must list a GPU and libnvoptix.so.1 be there "
    "(in a container: NVIDIA_DRIVER_CAPABILITIES=all), or DRJIT_LIBOPTIX_PATH point at it"
)
_DRIVER_FILE = Path("/proc/driver/nvidia/version")
_DRIVER_NAMES = ("CUDA_VISIBLE_DEVICES", "DRJIT_LIBCUDA_PATH", "DRJIT_LIBOPTIX_PATH")
_PLACES = (
    "/usr/lib/*/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/lib64/llvm*/lib*/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM.dylib",
)


@dataclass(frozen=True)
class Probe:
    """One variant tried with one library: did a render in a child process succeed, and what was said."""

    variant: str
    library: str
    passed: bool
    message: str
    cached: bool = False


@dataclass(frozen=True)
class VariantChoice:
    """The variant to use, the libLLVM to use with it ("" for none), why, and everything that was tried."""

    variant: str
    library: str
    reason: str
    probes: tuple[Probe, ...] = ()
    cure: str = ""


def mitsuba_version() -> str:
    """Version of the installed Mitsuba without importing it.

    Raises
    ------
    MissingPartError
        If Mitsuba is not installed.
    """
    try:
        return importlib.metadata.version("mitsuba")
    except importlib.metadata.PackageNotFoundError:
        raise MissingPartError("mitsuba is not installed; run: pip install mitsuba") from None


def llvm_libraries() -> tuple[str, ...]:
    """Paths of the libLLVM files on this machine, each file once, the named one first, then the newest."""
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    found: dict[str, str] = {}
    for place in _PLACES:
        for path in glob.glob(place):
            found.setdefault(os.path.realpath(path), path)
    paths = sorted((p for p in found if os.path.isfile(p)), key=lambda p: (_major(p), p), reverse=True)
    if named:
        paths = [named, *(p for p in paths if p != os.path.realpath(named))]
    return tuple(paths)


def _major(path: str) -> int:
    numbers = re.findall(r"(?:LLVM[-.]?|so\.|llvm-?)(\d+)", os.path.basename(path)) or re.findall(r"llvm-?(\d+)", path)
    return int(numbers[0]) if numbers else 0


def probe_variant(variant: str, library: str = "", *, timeout_s: float = 90.0, use_cache: bool = True) -> Probe:
    """Try a 4 x 4 pixel, 1 sample render with ``variant`` and libLLVM ``library`` in a child process."""
    version = mitsuba_version()
    modified = os.stat(library).st_mtime_ns if library and os.path.exists(library) else 0
    driver = None if library else _driver()
    key = content_hash(["probe-2", version, sys.version_info[:2], variant, library, modified, driver])
    path = cache.cache_folder() / "variants" / f"{key}.json"
    known = (_FAILED.get(str(path)) or cache.load_json(path)) if use_cache else None
    if isinstance(known, dict) and {"passed", "message"} <= known.keys():
        return Probe(variant, library, bool(known["passed"]), str(known["message"]), True)
    passed, message = _render_in_child(variant, library, timeout_s)
    probe = Probe(variant, library, passed, message)
    if use_cache and (passed or library):
        cache.save_json(path, asdict(probe) | {"mitsuba": version})
    elif use_cache:
        _FAILED[str(path)] = asdict(probe)
    return probe


_FAILED: dict[str, dict[str, object]] = {}


def _driver() -> tuple[str | None, ...]:
    """The NVIDIA driver's version, and the variables that choose among its devices and libraries."""
    try:
        version = _DRIVER_FILE.read_text().splitlines()[0]
    except (OSError, IndexError):
        version = ""
    return (version, *(os.environ.get(name) for name in _DRIVER_NAMES))


def _render_in_child(variant: str, library: str, timeout_s: float) -> tuple[bool, str]:
    environment = dict(os.environ)
    if library:
        environment["DRJIT_LIBLLVM_PATH"] = library
    root = str(Path(__file__).resolve().parents[3])
    environment["PYTHONPATH"] = os.pathsep.join(p for p in (root, environment.get("PYTHONPATH", "")) if p)
    command = [sys.executable, "-m", "isetval.scenes.rendered.mitsuba_backend", "--probe", variant]
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=timeout_s, check=False)
    except subprocess.TimeoutExpired:
        return False, f"no answer within {timeout_s:g} s"
    except OSError as error:
        return False, f"the child process did not start: {error}"
    if done.returncode == 0 and done.stdout.strip().endswith("probe passed"):
        return True, "4 x 4 pixel render succeeded"
    return False, _last_words(done.stderr or done.stdout, done.returncode)


def _last_words(text: str, code: int) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    telling = [line for line in lines if "LLVM ERROR" in line or "Error" in line or "error" in line]
    raised = [line for line in lines if re.match(r"[\w.]*(Error|Exception): ", line)]
    words = (raised or telling or lines or ["no message"])[-1][:200]
    if raised and lines[-1] != raised[-1]:  # of a message of many lines the last one tells why
        words = f"{words} ... {lines[-1][:100]}"
    end = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
    return f"{end}: {words}"


def choose_variant(wanted: str | None = None, *, probe: bool = True) -> VariantChoice:
    """The variant to render with.

    Parameters
    ----------
    wanted : str, optional
        ``None`` or ``"scalar_spectral"``: scalar, always there; ``"auto"``: the fastest that passes the probe
        (CUDA, then LLVM, then scalar); or a variant by name.  The environment variable ``ISETVAL_VARIANT``
        takes the place of None and of ``"auto"``.
    probe : bool
        False forbids child processes: anything but scalar is then refused or passed over.

    Raises
    ------
    MissingPartError
        If a variant asked for by name does not pass.
    InputError
        For a name that is not a spectral variant.
    """
    source = "asked for"
    if wanted in (None, "auto") and os.environ.get("ISETVAL_VARIANT"):
        wanted, source = os.environ["ISETVAL_VARIANT"], "ISETVAL_VARIANT"
    if wanted in (None, SCALAR):
        return VariantChoice(SCALAR, "", "the default, needs no system library" if wanted is None else source)
    if wanted != "auto" and wanted not in JIT_VARIANTS:
        raise InputError(f"variant is {wanted!r}; it needs 'auto', {SCALAR!r} or one of {', '.join(JIT_VARIANTS)}")
    probes: list[Probe] = []
    for variant in JIT_VARIANTS if wanted == "auto" else (str(wanted),):
        if not probe:
            continue
        for library in _libraries_for(variant):
            probes.append(probe_variant(variant, library))
            if probes[-1].passed:
                reason = f"{source}; " if wanted != "auto" else ""
                return VariantChoice(variant, library, f"{reason}probe render in a child process succeeded", tuple(probes))
    if wanted != "auto":
        llvm = str(wanted).startswith("llvm")
        words = "; ".join(f"{p.library}: {p.message}" if p.library else p.message for p in probes)
        words = words or ("not tried" if not probe else "no library found" if llvm else "no NVIDIA driver found")
        raise MissingPartError(f"variant {wanted} ({source}) failed its probe render ({words}); {CURE if llvm else CUDA_CURE}")
    cure = f"{CURE}; {CUDA_CURE}" if any(p.variant.startswith("cuda") for p in probes) else CURE
    return VariantChoice(SCALAR, "", "no faster variant passed its probe render", tuple(probes), cure)


def _libraries_for(variant: str) -> tuple[str, ...]:
    if variant.startswith("llvm"):
        return llvm_libraries()
    return ("",) if _has_nvidia_driver() else ()


def _has_nvidia_driver() -> bool:
    return any(os.path.exists(p) for p in ("/dev/nvidiactl", "/dev/dxg", "/proc/driver/nvidia/version"))
