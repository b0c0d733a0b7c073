"""The slanted edge runs on one BLAS thread and leaves the numbers of threads as they were."""

import numpy as np
import pytest
from edge_cases import AIRY, clean
from edge_charts import chart
from threadpoolctl import ThreadpoolController, threadpool_limits

from isetval.measure.edge import find_edges, sfr, sfr_batch, spectrum
from isetval.scenes.edge_truth import EdgeTruth


def blas_threads() -> set[int]:
    return {library.num_threads for library in ThreadpoolController().select(user_api="blas").lib_controllers}


@pytest.fixture
def seen(monkeypatch):
    """BLAS threads at every linear solve; the solvers stay the real ones."""
    inside: list[set[int]] = []
    for module, name in ((np.linalg, "solve"), (np.linalg, "cholesky"), (spectrum, "solve_lower")):
        real = getattr(module, name)

        def watched(*args, _real=real, **options):
            inside.append(blas_threads())
            return _real(*args, **options)

        monkeypatch.setattr(module, name, watched)
    with threadpool_limits(limits=2, user_api="blas"):
        if blas_threads() != {2}:
            pytest.skip("this BLAS cannot run two threads")
        yield inside


CAPTURE = clean(EdgeTruth(AIRY, angle_deg=5.0))


@pytest.mark.parametrize(
    "measure",
    [
        lambda: sfr(CAPTURE),
        lambda: sfr_batch([CAPTURE, CAPTURE], [None, None]),
        lambda: find_edges(chart(200, 200, extras=False).capture(snr=60)),
    ],
    ids=["sfr", "sfr_batch", "find_edges"],
)
def test_one_thread_inside_and_two_again_afterwards(seen, measure):
    assert measure()
    assert len(seen) > 3
    assert set().union(*seen) == {1}
    assert blas_threads() == {2}


def test_covariance_of_a_result(seen):
    result = sfr(CAPTURE)
    seen.clear()
    assert result.mtf_covariance([0.1, 0.2]).shape == (2, 2)
    assert result.mtf_sigma.shape == result.mtf.shape
    assert seen
    assert set().union(*seen) == {1}
    assert blas_threads() == {2}
