"""Damaged JSON and TOML files for every reader of them: whole originals, mutants, and what may come out.

A mutant ends in a value or in one sentence (`InputError`), within two seconds.  Half of the mutants are damaged as text
(bits, bytes, copies, cuts), half as content: a part dropped, replaced by something of another kind, by a number that is
too large, or buried in lists; the latter still parse, and reach the readers.
"""

import contextlib
import copy
import io
import json
import shutil
import signal
import tempfile
import time
import tomllib
import warnings
from pathlib import Path

import numpy as np
import tomlkit

from isetval import InputError
from isetval.core.toml import data_folder

SECONDS = 2.0
LONGEST_SENTENCE = 2500
ODD = (
    None, True, -1, 0, 1, 2**31, 12147483648, 2**63, 10**400, -(10**30), 1e308, -1e308, 1e-320, 0.5, "", "x", "x" * 5000,
    "../../x",
    "/etc/passwd", "nan", "a\0b", "\x1b[31m", "<script>", [], {}, [[]], [None], {"": None}, [1, 2], ["x"], {"value": "x"},
)  # fmt: skip


def damaged_bytes(data, rng):
    """One to six faults in the text."""
    data = bytearray(data)
    for _ in range(int(rng.integers(1, 7))):
        if len(data) < 4:
            break
        at, kind = int(rng.integers(len(data))), rng.integers(6)
        if kind == 0:
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            data[at] = int(rng.choice(list(b'"[]{},:=.0e-\n#\x00\xff')))
        elif kind == 2:
            other, size = int(rng.integers(len(data))), int(rng.integers(1, 80))
            data[at : at + size] = data[other : other + size]
        elif kind == 3:
            del data[at : at + int(rng.integers(1, 40))]
        elif kind == 4:
            data[at:at] = [b"9" * 40, b"[" * 200, b'{"a":' * 50, b"1e999", b"-"][int(rng.integers(5))]
        elif rng.random() < 0.3:
            del data[at:]
    return bytes(data)


def places(content, path=()):
    """Every place of a nest."""
    out = [path]
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in items:
        out += places(value, (*path, key))
    return out


def damaged_content(content, rng):
    """One to three parts dropped, replaced, doubled or buried."""
    content = copy.deepcopy(content)
    for _ in range(int(rng.integers(1, 4))):
        found = [place for place in places(content) if place]
        if not found:
            break
        place = found[int(rng.integers(len(found)))]
        parent = content
        for key in place[:-1]:
            parent = parent[key]
        kind, key = rng.integers(5), place[-1]
        if kind == 0:
            del parent[key]
        elif kind == 1:
            buried = parent[key]
            for _ in range(int(rng.choice([1, 3, 70]))):
                buried = [buried]
            parent[key] = buried
        elif kind == 2 and isinstance(parent, list):
            parent.insert(key, copy.deepcopy(parent[key]))
        elif kind == 3 and isinstance(parent, dict):
            parent[f"{key}_"] = parent.pop(key)
        else:
            parent[key] = copy.deepcopy(ODD[int(rng.integers(len(ODD)))])
    return content


def as_toml(content):
    """TOML text of a nest; None for what TOML cannot say."""
    try:
        return tomlkit.dumps(content).encode()
    except Exception:
        return None


def mutant(data, suffix, rng):
    """A damaged file."""
    if rng.random() < 0.5:
        return damaged_bytes(data, rng)
    content = tomllib.loads(data.decode()) if suffix == ".toml" else json.loads(data)
    damaged = damaged_content(content, rng)
    if suffix == ".toml":
        return as_toml(damaged) or damaged_bytes(data, rng)
    return json.dumps(damaged).encode()


class Readers:
    """Every reader of JSON and TOML with a whole file for it, in a folder that holds what the files name."""

    def __init__(self, folder):
        self.folder = Path(folder)
        shutil.copytree(data_folder() / "demo", self.folder / "demo")
        shutil.copytree(data_folder() / "pixel4a", self.folder / "pixel4a")
        (self.folder / "light.csv").write_text("wavelength_nm,radiance\n400,0.001\n700,0.001\n")
        results = self._results()
        self.files = {
            "report diagnosis": (".json", results["diagnosis"], self._report),
            "report comparison": (".json", results["comparison"], self._report),
            "report measurement": (".json", results["measurement"], self._report),
            "report demo": (".json", results["demo"], self._report),
            "reveal answer": (".json", results["diagnosis"], self._reveal),
            "reveal truth": (".json", results["truth"], self._truth),
            "add from diagnosis": (".json", results["diagnosis"], self._add),
            "add from filters": (".json", results["filters"], self._add_filters),
            "rerun": (".json", results["measurement"], self._rerun),
            "archive": (".json", results["measurement"], self._archive),
            "lens": (".json", results["lens"], self._lens),
            "imatest": (".json", results["imatest"], self._imatest),
            "model": (".toml", (data_folder() / "pixel4a" / "camera.toml").read_bytes(), self._model),
            "plan": (".toml", (data_folder() / "demo" / "plan.toml").read_bytes(), self._plan),
            "sidecar": (".toml", SIDECAR, self._sidecar),
            "limits": (".toml", LIMITS, self._limits),
            "target": (".toml", TARGET, self._plan_target),
        }

    def path(self, name):
        place = {"model": "pixel4a", "plan": "demo"}.get(name, ".")
        return self.folder / place / f"mutant{self.files[name][0]}"

    def read(self, name, data):
        """``read`` or ``refused`` with the seconds it took; anything else is an error of the reader and is raised."""
        path = self.path(name)
        path.write_bytes(data)
        start = time.perf_counter()
        try:
            with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
                warnings.simplefilter("error")
                self.files[name][2](path)
            word = "read"
        except InputError as error:
            said = str(error)
            if "\n" in said or len(said) > LONGEST_SENTENCE or "\x1b" in said or "\0" in said:
                raise AssertionError(f"no sentence: {said[:300]!r}") from None
            word = "refused"
        return word, time.perf_counter() - start

    def _report(self, path):
        from isetval.app.report import report_html
        from isetval.files.result_file import read_result

        report_html([read_result(path, filled=True)])

    def _reveal(self, path):
        from isetval.app.challenge import score_diagnosis
        from isetval.files.result_file import Answer, read_as

        truth = {"kind": "single", "effects": [{"name": "vignetting", "parameters": {"v": 0.1}}]}
        score_diagnosis(truth, read_as(path, Answer))

    def _truth(self, path):
        from isetval.app.challenge import commitment_of, reveal_challenge
        from isetval.files.result_file import Truth, read_as

        truth = read_as(path, Truth)
        (self.folder / "commitment.json").write_text(json.dumps({"commitment": commitment_of(truth)}))
        reveal_challenge(self.folder, path, diagnosis=json.loads(self.files["reveal answer"][1]))

    def _add(self, path):
        from isetval.loop.model_update import from_result

        from_result("vignetting", path).words()

    def _add_filters(self, path):
        from isetval.loop.model_update import from_result

        for effect in ("quantum_efficiency", "spectral_crosstalk", "channel_gain"):
            from_result(effect, path).words()

    def _rerun(self, path):
        from isetval.app.rerun import command_of, rerun_result
        from isetval.files.result_file import read_result

        result = read_result(path)
        command_of(result)
        rerun_result(result, lambda: (json.loads(self.files["rerun"][1]), {})).lines()

    def _archive(self, path):
        from isetval.app.archive.rows import rows_of_result

        rows_of_result(path)

    def _lens(self, path):
        from isetval.lens import load_lens

        load_lens(path)

    def _imatest(self, path):
        from isetval.files.imatest_file import read
        from isetval.files.metric_file import read_text

        read(read_text(path), str(path), edge=1)

    def _model(self, path):
        import isetval

        isetval.load_model(path)

    def _plan(self, path):
        import isetval

        isetval.load_campaign(path)

    def _plan_target(self, path):
        import isetval

        isetval.load_campaign(path)

    def _sidecar(self, path):
        from isetval.files.sidecar import read_sidecar

        read_sidecar(self.folder / "flat_10ms.png", path)

    def _limits(self, path):
        from isetval.app.limits import broken, load_limits

        broken(load_limits(path), json.loads(self.files["rerun"][1])["metrics"])

    def _results(self):
        measurement = _measurement(self.folder)
        row = {"role": "prediction", "n": 24, "mean_square_z": 36.0, "rms_relative_error": 0.01}
        ladder = [{"model": m, "family": f, **row} for m in ("nominal", "mended") for f in ("all", "flat_mean")]
        table = [
            {"model": m, "name": "mean", "family": "flat_mean", "channel": c, "shot": f"shot{i}", "role": "flat", "setup": "s",
             "region": "", "patch": "", "unit": "DN", "measured": 100.0 + i, "simulated": 101.0, "sigma": 1.0, "z": float(i),
             "frequency_cy_px": None, "exposure_s": 0.01, "level": 1.0, "field_x_mm": 0.3 * i, "field_y_mm": 0.0}
            for m in ("nominal", "mended") for i in range(3) for c in ("R", "Gr", "Gb", "B")
        ]  # fmt: skip
        gate = {"run": True, "failed": False, "mean_square_z": 1.04, "n": 30, "allowed": 0.7}
        comparison = {
            "kind": "compare", "campaign": "lab", "models": ["nominal", "mended"], "table": table, "ladder": ladder,
            "settings": {}, "gate": gate, "notes": [], "nuisances": {"nominal": {"light_level@set-up:s": [0.01, 0.002]}},
            "provenance": {"command": ["isetval", "compare"], "versions": {"isetval": "0"}, "inputs": {"a": {"sha256": "ab"}}},
        }  # fmt: skip
        parameter = {"value": 0.101, "sigma": 0.004, "unit": "1", "nominal": 0.0, "delta": 0.101}
        effect = {"name": "vignetting", "parameters": {"v": parameter}, "posterior": 0.97, "equivalent": ["cos4"], "dchi2": 800.0,
                  "fitted_to": ["lab"], "present_in_model": False, "choices": {}}  # fmt: skip
        candidate = {"name": "vignetting", "dchi2": 800.0, "dof": 1, "p_corrected": 1e-9, "posterior": 0.97, "log_evidence": 1.0,
                     "observable": True, "estimate": {"v": {"value": 0.1, "sigma": None}}}  # fmt: skip
        diagnosis = {
            "kind": "diagnose", "verdict": "attributed", "effects": [effect], "candidates": [candidate], "unobservable": ["lag"],
            "next_captures": [{"capture": "a flat", "separates": ["a", "b"], "rho_before": 0.9, "rho_after": 0.1}],
            "leftover": None, "ladder": ladder, "gate": gate, "campaign": "lab", "model": "nominal", "notes": ["a note"],
        }  # fmt: skip
        hidden = {"name": "vignetting", "parameters": {"v": {"value": 0.1, "unit": "1"}}}
        demo = {"kind": "demo", "seed": 4, "diagnosis": diagnosis, "before": comparison, "after": comparison, "hidden": hidden}
        truth = {
            "kind": "single",
            "effects": [{"name": "vignetting", "parameters": {"v": 0.1}}],
            "seed": 7,
            "nuisances": {},
            "nonce": "ab",
        }
        filters = {"kind": "spectral_qe", "source": "s", "fitted_to": ["a"], "wavelength_nm": [400, 500, 600],
                   "qe": [[0.1, 0.2, 0.3]] * 3,
                   "corrected_qe": [[0.1, 0.2, 0.3]] * 3, "matrix": np.eye(3).tolist(), "sigma": [[0.01] * 3] * 3}  # fmt: skip
        lens = json.loads((data_folder() / "lens" / "default_lens.json").read_text())
        lens["polynomials"] = lens["polynomials"][:1]
        imatest = {"sfrResults": {"mtf50": [0.31, 0.29], "version": "x"}}
        named = {"measurement": measurement, "comparison": comparison, "diagnosis": diagnosis, "demo": demo, "truth": truth}
        named |= {"filters": filters, "lens": lens, "imatest": imatest}
        return {name: json.dumps(value).encode() for name, value in named.items()}


def _measurement(folder):
    """A real result of one small capture."""
    import isetval
    from isetval.app.cli import main

    codes = np.rint(64 + 0.5 * np.random.default_rng(1).poisson(200.0, (32, 32))).astype(int)
    isetval.write_dng(folder / "flat.dng", isetval.Capture.from_array(codes, time_s=0.01, iso=100, bits=10))
    assert main(["measure", str(folder / "flat.dng"), "-q", "-o", str(folder / "m.json")]) == 0
    return json.loads((folder / "m.json").read_text())


SIDECAR = b"""bits = 12
cfa = "RGGB"
black_dn = 64
white_dn = 4095
pixel_um = 1.4
exposure_s = 0.01
iso = 100
name_rule = "flat_(?P<exposure_ms>[0-9]+)ms"
"""
LIMITS = b"""[[limit]]
name = "plane_mean"
channel = "R"
low = 90.0
high = 110.0
[[limit]]
family = "plane"
low = 0
"""
TARGET = b"""name = "targets"
[sensor]
rows = 64
cols = 64
pixel_um = 1.4
cfa = "RGGB"
black_dn = 64
white_dn = 1023
[[nuisance]]
parameter = "light_level"
sigma = 0.02
unit = "relative"
scope = "set-up"
[light.sphere]
radiance = "light.csv"
[target.slant]
kind = "edge"
angle_deg = 5.0
dark_reflectance = 0.05
bright_reflectance = 0.8
[[shot]]
role = "edge"
target = "slant"
light = "sphere"
exposure_s = 0.1
frames = 2
window = [0, 0, 32, 32]
"""


class Slow(BaseException):
    """A reader took too long; no `except Exception` of a reader may hide it."""


def timed(readers, name, data):
    """`Readers.read` with an alarm."""

    def ring(number, frame):
        raise Slow(f"more than {5 * SECONDS} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, 5 * SECONDS)
    try:
        return readers.read(name, data)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@contextlib.contextmanager
def all_readers():
    with tempfile.TemporaryDirectory() as folder:
        yield Readers(folder)
