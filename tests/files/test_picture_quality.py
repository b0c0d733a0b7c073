"""Quality remarks: planted faults are named, ordinary pictures are left in peace."""

import json

import numpy as np
import pytest

from isetval import Capture, read_dng
from isetval.files.bad_pixels import bad_pixels
from isetval.files.dng import describe_capture, write_dng
from isetval.files.picture_quality import clipping, code_use, line_remarks

ROWS, COLS = 120, 160


def photons(mean_e, *, seed=1, gain_dn_per_e=0.4, read_dn=1.5, black_dn=64):
    """A plain camera: Poisson electrons, gain, read noise, rounding."""
    rng = np.random.default_rng(seed)
    mean_e = np.broadcast_to(np.asarray(mean_e, float), (ROWS, COLS))
    dn = black_dn + gain_dn_per_e * rng.poisson(mean_e) + read_dn * rng.standard_normal((ROWS, COLS))
    return np.clip(np.round(dn), 0, 1023).astype(np.uint16)


def scenes():
    row, col = np.mgrid[:ROWS, :COLS]
    rng = np.random.default_rng(2)
    flat = np.full((ROWS, COLS), 800.0)
    yield "dark", photons(0)
    yield "almost noiseless dark", photons(0, read_dn=0.2)
    yield "flat", photons(flat)
    yield "vignette", photons(flat * (1 - 0.7 * ((row / ROWS - 0.5) ** 2 + (col / COLS - 0.5) ** 2) / 0.5))
    yield "edge", photons(np.where(col + 0.1 * row > 90, 1500, 150))
    yield "edge along the rim", photons(np.where(row + 0.1 * col > 6, 1500, 150))
    yield "patches", photons(np.kron(rng.uniform(50, 2000, (6, 8)), np.ones((20, 20))))
    yield "row noise", np.clip(photons(flat) + np.round(4 * rng.standard_normal((ROWS, 1))), 0, 1023).astype(np.uint16)
    yield "saturated", np.minimum(photons(flat * 4), 1023)


@pytest.mark.parametrize(("name", "mosaic"), list(scenes()), ids=lambda v: v if isinstance(v, str) else "")
def test_ordinary_pictures_are_left_in_peace(name, mosaic):
    capture = Capture.from_array(mosaic)
    assert line_remarks(capture.mosaic) == []
    assert sum(bad_pixels(capture).values()) == 0
    assert code_use(capture.mosaic).missing_count == 0


@pytest.mark.parametrize(
    "where", [np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]], ids=["first row", "last row", "first column", "last column"]
)
@pytest.mark.parametrize("fault", ["stuck", "shifted", "garbage"])
def test_bad_rim_lines(where, fault):
    mosaic = photons(800)
    line = mosaic[where].astype(int)
    # sigma of a pixel is about sqrt(0.4^2 * 800 + 1.5^2) = 11 DN; the median of a line is good to 1.3 DN
    mosaic[where] = {
        "stuck": np.zeros_like(line),
        "shifted": line + 25,
        "garbage": np.random.default_rng(3).integers(0, 1024, line.shape),
    }[fault]
    (remark,) = line_remarks(mosaic)
    rows = where == 0 or where == -1
    last = where == -1 or (isinstance(where, tuple) and where[1] == -1)
    index = ((ROWS if rows else COLS) - 1) if last else 0
    assert remark.code == ("outlier_row" if rows else "outlier_column")
    assert f"{'row' if rows else 'column'} {index} " in remark.message
    assert {"stuck": "holds 0 everywhere", "shifted": " DN from its neighbors", "garbage": "neighbors"}[fault] in remark.message


def test_hot_and_dead_pixels_are_counted():
    """Planted far apart and inside each plane; 100 DN is 9 sigma of this flat's 11 DN above the largest neighbor."""
    mosaic = photons(800)
    hot = [(10, 10), (33, 51), (80, 121), (90, 44)]
    dead = [(50, 20), (61, 99)]
    for place in hot:
        mosaic[place] = 900
    for place in dead:
        mosaic[place] = 0
    assert bad_pixels(Capture.from_array(mosaic)) == {"hot": 4, "dead": 2}
    assert bad_pixels(Capture.from_array(mosaic, cfa="MONO")) == {"hot": 4, "dead": 2}


def test_clipping_counts_every_plane():
    mosaic = photons(800)
    mosaic[0:20:2, 0:10:2] = 0
    mosaic[1:21:2, 0:10:2] = 1023
    mosaic[1:3, 1] = 1500
    counts = {c.plane: (c.pixels, c.at_zero, c.at_white) for c in clipping(Capture.from_array(mosaic))}
    quarter = ROWS * COLS // 4
    assert counts == {"R": (quarter, 50, 0), "Gr": (quarter, 0, 1), "Gb": (quarter, 0, 50), "B": (quarter, 0, 1)}


def test_stretched_codes_are_missed():
    """Multiplying by 4/3 after the converter leaves every fourth code empty."""
    narrow = np.arange(0, 300)
    mosaic = np.random.default_rng(4).choice(narrow, (200, 200))
    stretched = np.floor(mosaic * 4 / 3).astype(np.uint16)
    codes = code_use(stretched)
    wanted = [v for v in range(398) if v not in set(np.floor(narrow * 4 / 3).astype(int).tolist())]
    # only up to the 99 % quantile
    assert list(codes.missing) == wanted[: len(codes.missing)]
    assert codes.missing_count == pytest.approx(len(wanted), abs=2)


def test_a_description_is_plain_json_and_says_everything_once(tmp_path):
    mosaic = photons(800)
    mosaic[0] = 0
    capture = read_dng(write_dng(tmp_path / "a.dng", Capture.from_array(mosaic, time_s=0.1, iso=55)))
    description = json.loads(json.dumps(describe_capture(capture), allow_nan=False))
    codes = [w["code"] for w in description["warnings"]]
    assert sorted(codes) == ["clipped_at_zero", "outlier_row"]
    assert description["black_dn"] == {"R": 64, "Gr": 64, "Gb": 64, "B": 64}
    assert description["clipped"]["R"]["at_zero"] == COLS // 2
    assert description["clipped"]["B"]["share_at_zero"] == 0
    assert description["provenance"]["black_used"] == "tag"
    assert description["exposure"] == {"time_s": 0.1, "iso": 55, "f_number": None, "focus_m": None}


@pytest.mark.parametrize("tiles", [False, True], ids=["strips", "tiles"])
@pytest.mark.parametrize("shape", [(6, 6), (9, 7), (2 * 300, 44), (131, 262)], ids=str)
@pytest.mark.parametrize("cfa", ["RGGB", "MONO"])
def test_bad_pixels_are_those_of_a_filter_over_the_whole_plane(shape, cfa, tiles, monkeypatch):
    """Strips, tiles and whole numbers count the same as scipy's rank filters with a hole in the middle."""
    monkeypatch.setattr("isetval.files.bad_pixels.LARGE_PIXELS", 0 if tiles else 1 << 20)
    from scipy import ndimage

    from isetval.core.capture import plane_view, planes_of

    rng = np.random.default_rng(8)
    mosaic = np.minimum(rng.poisson(300.0, shape), 65535).astype(np.uint16)
    some = mosaic.size // (40 if mosaic.size < 30_000 else 4000) + 2  # few: most tiles hold none
    mosaic.ravel()[rng.integers(0, mosaic.size, some)] = rng.integers(0, 65536, some)
    capture = Capture.from_array(mosaic, cfa=cfa, bits=16, white_dn=65535)
    ring = np.ones((3, 3), bool)
    ring[1, 1] = False
    hot = dead = 0
    for plane in planes_of(capture):
        whole = plane_view(capture, plane)[0].astype(float)
        high, low = (f(whole, footprint=ring)[1:-1, 1:-1] for f in (ndimage.maximum_filter, ndimage.minimum_filter))
        middle, span = whole[1:-1, 1:-1], high - low
        limit = np.maximum(8 * np.maximum(span, np.median(span)) / 2.85, 8)
        hot += int((middle - high > limit).sum())
        dead += int((low - middle > limit).sum())
    assert bad_pixels(capture) == {"hot": hot, "dead": dead}
    assert hot + dead > 100 or mosaic.size < 100 or mosaic.size > 30_000
    assert hot + dead > 0 or mosaic.size < 100
