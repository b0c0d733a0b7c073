"""Fixed rows and columns are one draw of the specimen: their share of sigma is common to planes, darks and flats."""

import numpy as np
import pytest

from isetval.core.campaign import Exposure, Shot
from isetval.core.capture import Capture
from isetval.core.metric import MetricTable
from isetval.measure.campaign import measure_shot

SPECIMENS, ROWS, BLACK = 150, 48, 64
WINDOW = (1000, 2000, ROWS, ROWS)
FAMILIES = ("dark_fixed_row_variance", "flat_fixed_row_variance", "dark_mean", "dark_gradient")


def shot(name, role):
    return Shot(
        name=name, role=role, window=WINDOW, exposure=Exposure(time_s=0.01), frames=3, light="lamp" if role == "flat" else None
    )


def captures(rng, row_dn, level_dn):
    frames = [BLACK + level_dn + row_dn[:, None] + 1.5 * rng.standard_normal((ROWS, ROWS)) for _ in range(3)]
    return [Capture.from_array(np.rint(f).astype(np.uint16), cfa="RGGB", black_dn=BLACK, window=WINDOW[:2]) for f in frames]


@pytest.fixture(scope="module")
def tables():
    rng = np.random.default_rng(77)
    out = []
    for _ in range(SPECIMENS):
        row_dn = 0.8 * rng.standard_normal(ROWS)
        blocks = [
            block
            for name, role, level in (("d", "dark", 0.0), ("f", "flat", 40.0))
            for _, block in measure_shot(shot(name, role), captures(rng, row_dn, level))
        ]
        out.append(MetricTable(tuple(blocks)))
    return out


@pytest.mark.parametrize("family", FAMILIES)
def test_the_mean_over_planes_scatters_as_the_covariance_says(tables, family):
    keys = [m.key() for m in tables[0].metrics if m.family == family and m.region != "column"]
    values, stated = [], []
    for table in tables:
        place = {m.key(): i for i, m in enumerate(table.metrics)}
        rows = [place[k] for k in keys]
        values.append(table.values[rows].mean())
        stated.append(table.covariance()[np.ix_(rows, rows)].mean())
    assert np.sqrt(np.mean(stated)) / np.std(values) == pytest.approx(1, abs=4 / np.sqrt(2 * SPECIMENS) + 0.05)


def test_darks_and_flats_see_the_same_rows(tables):
    found, stated = [], []
    for table in tables:
        families = [m.family for m in table.metrics]
        dark, flat = (families.index(f"{role}_fixed_row_variance") for role in ("dark", "flat"))
        found.append((table.values[dark], table.values[flat]))
        covariance = table.covariance()
        stated.append(covariance[dark, flat] / np.sqrt(covariance[dark, dark] * covariance[flat, flat]))
    assert np.mean(stated) == pytest.approx(np.corrcoef(np.array(found).T)[0, 1], abs=0.1)
    assert np.mean(stated) > 0.8


@pytest.mark.parametrize(("row_dn", "least"), [(0.0, 0.0), (0.5, 0.5), (3.0, 0.9)])
def test_planes_on_the_same_rows_share_row_noise(row_dn, least):
    """R and Gr lie on the same rows, R and B do not; stated correlations are those of repeated series."""
    rng = np.random.default_rng(78)
    names = ("mean", "gradient", "frame_drift", "row_noise_variance")
    values, stated = [], []
    for _ in range(SPECIMENS):
        frames = [40 + row_dn * rng.standard_normal(ROWS)[:, None] + 1.5 * rng.standard_normal((ROWS, ROWS)) for _ in range(4)]
        series = [Capture.from_array(np.rint(f).astype(np.uint16), cfa="RGGB", black_dn=0, window=WINDOW[:2]) for f in frames]
        dark = Shot(name="d", role="dark", window=WINDOW, exposure=Exposure(time_s=0.01), frames=4)
        table = MetricTable(tuple(block for _, block in measure_shot(dark, series)))
        place = {(m.name, m.channel): i for i, m in enumerate(table.metrics) if m.region != "column"}
        rows = [place[name, plane] for name in names for plane in ("R", "Gr", "B")]
        values.append(table.values[rows])
        covariance = table.covariance()[np.ix_(rows, rows)]
        stated.append(covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance))))
    found, said = np.corrcoef(np.array(values).T), np.mean(stated, axis=0)
    for i in range(0, 12, 3):
        assert said[i, i + 1] == pytest.approx(found[i, i + 1], abs=3.5 / np.sqrt(SPECIMENS))
        assert said[i, i + 2] == pytest.approx(found[i, i + 2], abs=3.5 / np.sqrt(SPECIMENS))
        assert said[i, i + 1] > least * (0.8 if i == 9 else 1)
