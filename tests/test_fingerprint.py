"""The same data give the same models, on any Python and any BLAS.

The values were recorded on CPython 3.11 and x86-64. Indices have to be the same. Coefficients and
predictions may differ by what other versions of NumPy, SciPy and their BLAS round differently.
Where a change of the method moves them on purpose, this writes new ones and prints how far they are
from the old ones::

    python tests/test_fingerprint.py
"""

import json
from pathlib import Path

import numpy as np
import pytest
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

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
RECORDED = json.loads(FILE.read_text()) if FILE.exists() else {}


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
    """Numbers by which each method is known, as plain lists."""
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
    moved = arm.forward(theta) - arm.forward(angles) + noise(240, 3, 0.003)
    harmonics = ArmResidualRegressor(arm, orders=12, causes=["gravity", "kinematics"]).fit(
        angles, moved
    )
    nominal = arm.replace(a=arm.a.round(0), d=arm.d.round(0))
    result = calibrate(nominal, angles, points=arm.forward(angles) + noise(240, 3, 0.02) + 1000)
    groups = np.arange(240) // 24
    return {
        "given widths, centres": given.center_indices_.tolist(),
        "given widths, coefficients": given.coef_[0, :5].tolist(),
        "given widths, predictions": given.predict(new).tolist(),
        "network inverse widths": (1 / network.length_scale_).tolist(),
        "network predictions": network.predict(new).tolist(),
        "network deviations": network.predict(new, return_std=True)[1].tolist(),
        "chain centres": inner.center_indices_.tolist(),
        "chain predictions": chain.predict(angles[:4] + 0.1).tolist(),
        "harmonics": harmonics.harmonics_[["joint", "order"]].tolist(),
        "harmonics predictions": harmonics.predict(angles[:4] + 0.1).tolist(),
        "calibrated d": result.arm.d.tolist(),
        "calibrated scatter": result.scatter_after_mm,
        "residuals": position_residuals(residuals, groups)[:3].tolist(),
    }


# Absolute, in the unit of each. Widths that are found differ in their eighth digit from one BLAS to
# another, and so do the last centres, which gain a millionth of the variance: the network without
# given widths is the same to a tenth of the noise (0.05) only, the others to rounding.
TOLERANCES = {
    "given widths, coefficients": 1e-6,
    "given widths, predictions": 1e-9,
    "network inverse widths": 1e-3,
    "network predictions": 5e-3,
    "network deviations": 5e-3,
    "chain predictions": 1e-5,
    "harmonics predictions": 1e-7,
    "calibrated d": 1e-6,
    "calibrated scatter": 1e-8,
    "residuals": 1e-12,
}


def differences(found, recorded):
    return {
        name: float(np.max(np.abs(np.subtract(found[name], recorded[name])))) for name in TOLERANCES
    }


@pytest.fixture(scope="module")
def found():
    return fingerprint()


@pytest.mark.parametrize("name", RECORDED)
def test_as_recorded(found, name):
    if name in TOLERANCES:
        np.testing.assert_allclose(found[name], RECORDED[name], rtol=0, atol=TOLERANCES[name])
    else:
        assert json.loads(json.dumps(found[name])) == RECORDED[name]


if __name__ == "__main__":
    values = fingerprint()
    print(differences(values, RECORDED) if RECORDED else "recorded")
    FILE.write_text(json.dumps(values, indent=1) + "\n")
