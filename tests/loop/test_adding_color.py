"""Results of spectral_qe go into a model: filters as a table beside it, mixing and gains as parameters."""

import json

import numpy as np
import pytest

import isetval
from isetval.app.cli import main
from isetval.core.errors import InputError
from isetval.core.scene import read_spectra
from isetval.core.toml import data_folder
from isetval.loop.model_update_color import save_spectral_qe
from isetval.measure.color import spectral_qe

CAMERA = data_folder() / "pixel4a" / "camera.toml"
TRUTH = np.array([[1.05, 0.03, 0.01], [0.08, 0.98, 0.06], [0.0, 0.05, 0.9]])  # rows: from, columns: to


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A fit to responses that were mixed by a known matrix."""
    rng = np.random.default_rng(4)
    nm = np.arange(400.0, 701.0, 10.0)
    table = read_spectra(data_folder() / "pixel4a" / "qe.csv")
    qe = np.column_stack([table[c].at(nm) for c in "RGB"])
    spectra = np.exp(rng.normal(0, 1, (72, 4)) @ np.vander((nm - 550) / 150, 4).T * 0.3)
    exact = spectra @ qe @ TRUTH
    sigma = 0.003 * exact
    result = spectral_qe(exact + sigma * rng.standard_normal(exact.shape), spectra, qe=qe, sigma=sigma)
    path = tmp_path_factory.mktemp("qe") / "result.json"
    save_spectral_qe(result, path, wavelength_nm=nm, source="a chart of our own", fitted_to=("lab",))
    return path, qe @ TRUTH, nm


def test_filters_are_written_beside_the_new_model(fitted, tmp_path):
    path, truth, nm = fitted
    assert main(["add", str(CAMERA), "quantum_efficiency", "--from", str(path), "-o", str(tmp_path / "m2.toml"), "-q"]) == 0
    curves, sigma = (read_spectra(tmp_path / name) for name in ("qe.csv", "qe_sigma.csv"))
    for i, channel in enumerate("RGB"):
        pull = (curves[channel].at(nm) - truth[:, i]) / np.maximum(sigma[channel].at(nm), 1e-5)
        assert np.sqrt(np.mean(pull**2)) < 3  # three numbers of M move a whole curve together
        assert curves[channel].at(nm) == pytest.approx(truth[:, i], abs=0.01)
    effect = isetval.load_model(tmp_path / "m2.toml").effect("quantum_efficiency")
    assert (effect.file, effect.fitted_to) == ("qe.csv", ("lab",))
    assert "a chart of our own" in effect.source
    assert "a chart of our own" in (tmp_path / "qe.csv").read_text()


def test_a_table_that_is_there_is_not_overwritten(fitted, tmp_path):
    (tmp_path / "qe.csv").write_text("mine")
    words = ["add", str(CAMERA), "quantum_efficiency", "--from", str(fitted[0]), "-o", str(tmp_path / "m2.toml"), "-q"]
    assert main(words) == 0
    assert (tmp_path / "qe.csv").read_text() == "mine"
    assert isetval.load_model(tmp_path / "m2.toml").effect("quantum_efficiency").file == "m2_qe.csv"
    assert main(words) == 3


def test_mixing_and_gains_rebuild_the_matrix(fitted, tmp_path):
    model = isetval.load_model(CAMERA)
    for effect in ("spectral_crosstalk", "channel_gain"):
        words = ["add", str(CAMERA), effect, "--from", str(fitted[0]), "-o", str(tmp_path / f"{effect}.toml"), "-q"]
        assert main(words) == 0
        model = model.with_effect(isetval.load_model(tmp_path / f"{effect}.toml").effect(effect))
    mixing, gain = model.effect("spectral_crosstalk"), model.effect("channel_gain")
    gains = np.array([1 + gain.d_red, 1.0, 1 + gain.d_blue])
    rebuilt = gains[:, None] * mixing.matrix()  # on column vectors, up to the green gain
    assert rebuilt == pytest.approx(TRUTH.T / TRUTH[1, 1], abs=0.02)


def test_what_a_result_does_not_tell_is_refused(fitted, tmp_path):
    content = json.loads(fitted[0].read_text())
    broken = tmp_path / "broken.json"
    broken.write_text(json.dumps({k: v for k, v in content.items() if k != "matrix"}))
    from isetval.loop.model_update import from_result

    with pytest.raises(InputError, match="not of read_noise"):
        from_result("read_noise", fitted[0])
    with pytest.raises(InputError, match="no whole result"):
        from_result("quantum_efficiency", broken)
