"""Calibrations whose rows are summed up in blocks, against the same rows at once."""

import tracemalloc

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import Arm, calibrate
from sklearn_raacmm.calibration import _fit, _set_ups
from sklearn_raacmm.calibration._fit import triangle
from sklearn_raacmm.calibration._set_ups import thinned
from sklearn_raacmm.datasets import make_features, make_single_point

AACMM6 = Arm.from_name("aacmm6")


def tracked(n, seed=0):
    """Angles and points of a tracker, with 0.02 mm of noise, of an arm off its table."""
    rng = np.random.default_rng(seed)
    a, d = (length + rng.normal(0, 0.2, 6) for length in (AACMM6.a, AACMM6.d))
    angles = rng.uniform(-2, 2, (n, 6))
    points = AACMM6.replace(a=a, d=d).forward(angles)[:, [1, 2, 0]] + [1000, 0, 0]
    return angles, points + rng.normal(0, 0.02, points.shape)


def given(kind):
    """The arguments of a calibration."""
    if kind == "tracker":
        angles, points = tracked(300)
        points[7] += 1.0
        labels = np.arange(300) % 2
        return (AACMM6, angles), {"points": points, "tools": labels, "stations": 1 - labels}
    if kind == "cones":
        test = make_single_point(8, 20, bars=[500], random_state=0)
        return (test.nominal_arm, test.data, test.groups), {"lengths": test.lengths}
    test = make_features(random_state=0)
    features = {"lengths": test.lengths, "features": test.features}
    return (test.nominal_arm, test.data, test.groups), features


@pytest.mark.parametrize("kind", ["tracker", "cones", "features"])
def test_blocks_of_rows_give_what_all_rows_at_once_do(kind, monkeypatch):
    known, options = given(kind)
    whole = calibrate(*known, **options)
    monkeypatch.setattr(_fit, "_BLOCK", 64)
    monkeypatch.setattr(_fit, "_HELD", 0)
    blocks = calibrate(*known, **options)
    assert blocks.unidentified_combinations == whole.unidentified_combinations
    assert (blocks.rank, blocks.outliers) == (whole.rank, whole.outliers)
    for name in ("values", "standard_deviations", "residuals_mm", "length_errors_mm"):
        assert_allclose(getattr(blocks, name), getattr(whole, name), rtol=1e-8, atol=1e-9)


def test_a_million_rows_would_fit_in_a_gibibyte(monkeypatch, tmp_path):
    # Not a million here: so many bytes a row. They are read from a file.
    for limit, rows in ((_fit, {"_BLOCK": 1024, "_HELD": 0}), (_set_ups, {"_MOST_ROWS": 1000})):
        for name, value in rows.items():
            monkeypatch.setattr(limit, name, value)
    angles, points = tracked(20_000)
    for name, array in (("angles", angles), ("points", points)):
        np.save(tmp_path / name, array)
    mapped = [np.load(tmp_path / f"{name}.npy", mmap_mode="r") for name in ("angles", "points")]
    calibrate(AACMM6, mapped[0][:500], points=mapped[1][:500])  # what is imported and kept
    tracemalloc.start()
    result = calibrate(AACMM6, mapped[0], points=mapped[1])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert result.sigma_mm == pytest.approx(0.02, rel=0.02)
    assert peak < 900 * len(angles)


def test_a_tracker_that_moved_is_found_among_many_rows(monkeypatch):
    monkeypatch.setattr(_set_ups, "_MOST_ROWS", 200)
    angles, points = tracked(1000)
    points[600:] += [0.5, 0, 0]
    with pytest.warns(UserWarning, match="jump"):
        result = calibrate(AACMM6, angles, points=points, accept="moved-station")
    (found,) = (one for one in result.findings if one.code == "moved-station")
    assert 600 <= found.rows[0] < 610


def test_thinned_rows_are_of_every_code_and_in_their_order(monkeypatch):
    monkeypatch.setattr(_set_ups, "_MOST_ROWS", 100)
    codes = np.arange(1000) % 10  # every tenth row would be of one code
    rows = thinned(codes, 1000)
    assert len(rows) == 100
    assert (np.diff(rows) > 0).all()
    assert np.bincount(codes[rows]).tolist() == [10] * 10
    assert thinned(None, 50).tolist() == list(range(50))


def test_triangle_of_blocks_is_that_of_all_rows():
    rows = np.random.default_rng(0).normal(size=(50, 4))
    root = triangle(rows[i : i + 3] for i in range(0, 50, 3))
    assert_allclose(root.T @ root, rows.T @ rows, rtol=1e-12)
    assert_allclose(root, np.triu(root))
