"""The same data give the same models, on any Python and any BLAS, whatever number of threads.

The values were recorded on CPython 3.11 and x86-64. Each has the tolerance that the rounding of
other kernels of the linear algebra needs: Nehalem's, Sandybridge's and Haswell's were compared, by
OPENBLAS_CORETYPE. Of centres, what they explain is recorded and not which they are, since the last
digit of a product decides between near ties. Where a change of the method moves values on purpose,
this writes new ones and prints how far they are from the old ones::

    python tests/test_fingerprint.py
"""

import json
from pathlib import Path

import numpy as np
import pytest
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from threadpoolctl import threadpool_info, threadpool_limits

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    calibrate,
    cylindrical_to_cartesian,
    position_residuals,
)

FILE = Path(__file__).with_name("fingerprint.json")
RECORDED = json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}


def spread(n_rows, n_columns):
    """Numbers in (-1, 1) of a closed form: no generator, no version of it."""
    roots = np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0][:n_columns])
    return 2 * (np.arange(1, n_rows + 1)[:, None] * roots % 1) - 1


def noise(n_rows, n_columns, size):
    return size * spread(n_rows + 50, n_columns)[50:]


def arm_data():
    arm = Arm.from_name("aacmm6")
    angles = 2 * spread(240, 6)
    elevation = PoseFeatures(arm).fit_transform(angles)[:, 2]
    bend = np.stack(
        [0.05 * np.cos(elevation), 0.03 * np.sin(angles[:, 2]), -0.04 * np.cos(angles[:, 3])],
        axis=1,
    )
    residuals = cylindrical_to_cartesian(bend, arm.azimuth(angles)) + noise(240, 3, 0.004)
    return arm, angles, residuals


def fingerprint():
    """Numbers by which each method is known, and the absolute tolerance of each."""
    X = spread(150, 2)
    Y = np.stack([np.sin(3 * X[:, 0]) + X[:, 1], np.cos(2 * X[:, 1])], axis=1)
    Y += noise(150, 2, 0.05)
    network = RBFNetRegressor(random_state=0).fit(X, Y)
    given = RBFNetRegressor(25, length_scale=[0.4, 0.6], alpha=1e-3, shared=True).fit(X, Y)
    new = spread(200, 2)[195:]
    arm, angles, residuals = arm_data()
    chain = make_pipeline(
        PoseFeatures(arm, encoding="periodic", append_azimuth=True),
        CylindricalResidualTarget(make_pipeline(StandardScaler(), RBFNetRegressor(25))),
    ).fit(angles, residuals)
    inner = chain[-1].regressor_[-1]
    theta = angles.copy()
    theta[:, 1] += np.deg2rad(6 / 3600) * np.cos(angles[:, 1] - 0.5)
    # Numbers of columns that no joint has: of those of a joint they would be an error of it.
    moved = arm.forward(theta) - arm.forward(angles) + 0.003 * spread(290, 9)[50:, 6:]
    harmonics = ArmResidualRegressor(arm, orders=12, causes=["gravity", "kinematics"]).fit(
        angles, moved
    )
    nominal = arm.replace(a=arm.a.round(0), d=arm.d.round(0))
    result = calibrate(nominal, angles, points=arm.forward(angles) + noise(240, 3, 0.02) + 1000)
    groups = np.arange(240) // 24
    # How many centres there are before others are combinations of them depends on the rounding.
    explained = float(np.sum(inner.error_reduction_))
    return {
        "given widths, explained": (np.cumsum(given.error_reduction_), 1e-9),  # 3e-16 found
        "given widths, coefficients": (given.coef_[0, :5], 1e-6),  # 1e-11
        "given widths, predictions": (given.predict(new), 1e-9),  # 2e-14
        "network inverse widths": (1 / network.length_scale_, 1e-3),  # 4e-8
        "network predictions": (network.predict(new), 1e-5),  # 1e-8, of a noise of 0.05
        "network deviations": (network.predict(new, return_std=True)[1], 1e-5),  # 2e-8
        "chain, explained": (explained, 1e-6),  # 3e-8
        "chain predictions": (chain.predict(angles[:4] + 0.1), 1e-5),  # 1e-7
        "harmonics": (harmonics.harmonics_[["joint", "order"]].tolist(), 0),
        "harmonics predictions": (harmonics.predict(angles[:4] + 0.1), 1e-9),  # 1e-15
        "calibrated d": (result.arm.d, 1e-8),  # 5e-13
        "calibrated scatter": (result.scatter_after_mm, 1e-9),  # 3e-14
        "residuals": (position_residuals(residuals, groups)[:3], 1e-12),  # 0
    }


@pytest.fixture(scope="module")
def found():
    return fingerprint()


@pytest.mark.parametrize("name", RECORDED)
def test_as_recorded(found, name):
    value, tolerance = found[name]
    np.testing.assert_allclose(np.asarray(value), RECORDED[name], rtol=0, atol=tolerance)


def fitted(n_threads):
    """Bytes of models of so many rows that their products are split between threads."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (300, 3))
    y = np.stack([np.sin(4 * X[:, 0]) * X[:, 1], X[:, 2] ** 2], axis=1)
    y += 0.05 * rng.standard_normal(y.shape)
    angles = rng.uniform(-2, 2, (300, 6))
    bends = 0.05 * np.cos(angles[:, :3] + angles[:, 3:]) + 0.01 * rng.standard_normal((300, 3))
    with threadpool_limits(n_threads, user_api="blas"):
        used = {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}
        if used != {n_threads}:
            pytest.skip(f"BLAS cannot be given {n_threads} threads here")
        apart, shared = (
            RBFNetRegressor(60, shared=bool(s), random_state=0).fit(X, y) for s in (0, 1)
        )
        model = ArmResidualRegressor(Arm.from_name("aacmm6"), orders=8).fit(angles, bends)
        return [apart.coef_, apart.length_scale_, shared.coef_, shared.centers_, model.coef_]


def test_number_of_blas_threads_changes_nothing():
    for one, two in zip(fitted(1), fitted(2), strict=True):
        np.testing.assert_array_equal(one, two)


if __name__ == "__main__":
    values = {name: np.asarray(value).tolist() for name, (value, _) in fingerprint().items()}
    for name in values.keys() & RECORDED.keys():
        new, old = np.asarray(values[name]), np.asarray(RECORDED[name])
        moved = np.max(np.abs(new - old)) if new.shape == old.shape else f"{old.shape} {new.shape}"
        print(name, moved)
    FILE.write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
