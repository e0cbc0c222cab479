"""Waves of order 400, where a strain-wave gear has them, against 50 digits: C, ONNX and predict."""

import mpmath
import numpy as np
import pytest

from sklearn_raacmm import Arm, ArmResidualRegressor
from sklearn_raacmm.error_model import Effect, Terms
from sklearn_raacmm.error_model._columns import columns_of

from ._chains import ways_out


@pytest.fixture(scope="module", params=["aacmm6", "panda"])
def fitted(request):
    """A model with waves of high order on three joints, and poses of any turn."""
    arm = Arm.from_name(request.param, probe=(3, -8, 120))
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (150, arm.n_joints))
    waves = Terms(np.array([[0, 400], [2, 1], [2, 399], [5, 397]]), False, False, False)
    y = columns_of(arm, waves).at(X) @ [30.0, -20, 25, 15, -40, 10, 200, 150]
    y += 0.001 * rng.normal(size=y.shape)
    causes = ["gravity", "kinematics"]
    model = ArmResidualRegressor(arm, orders=[1, 397, 399, 400], causes=causes, fade=0)
    new = np.concatenate([X[:3], rng.uniform(-12, 12, (3, arm.n_joints))])
    return model.fit(X, y), new


def frame_matrices(arm, row):
    """Frames of the arm as matrices, from the definition of the parameters."""
    found = [mpmath.eye(4)]
    for i in range(arm.n_joints):
        theta = arm.joint_signs[i] * mpmath.mpf(row[i]) + mpmath.mpf(arm.theta_offset[i])
        turn, twist, along_x, along_z = (mpmath.eye(4) for _ in range(4))
        for matrix, first, angle in ((turn, 0, theta), (twist, 1, mpmath.mpf(arm.alpha[i]))):
            c, s = mpmath.cos(angle), mpmath.sin(angle)
            matrix[first, first] = matrix[first + 1, first + 1] = c
            matrix[first, first + 1], matrix[first + 1, first] = -s, s
        along_x[0, 3], along_z[2, 3] = mpmath.mpf(arm.a[i]), mpmath.mpf(arm.d[i])
        steps = (turn, along_z, along_x, twist)
        if arm.convention == "modified":
            steps = (twist, along_x, turn, along_z)
        found.append(found[-1] * steps[0] * steps[1] * steps[2] * steps[3])
    return found


def cross(u, v):
    turns = ((1, 2), (2, 0), (0, 1))
    return mpmath.matrix([u[i] * v[j] - u[j] * v[i] for i, j in turns])


def in_50_digits(model, row):
    """The sum of all columns times their coefficients at one pose."""
    linear = model.linear_model_
    frames = frame_matrices(linear.arm, row)
    probe = (frames[-1] * mpmath.matrix([*linear.arm.probe, 1]))[:3, 0]
    places = [frame[:3, 3] for frame in frames] + [probe]
    total = mpmath.matrix(3, 1)
    table = linear.layout.table
    names = ["kind", "frame", "axis", "unit", "joint", "order", "load"]
    for coef, column in zip(linear.coef, table[names].tolist(), strict=True):
        kind, frame, axis, unit, joint, order, load = column
        u, origin = frames[frame][:3, axis], places[frame]
        value = u if kind == Effect.SHIFT else cross(u, probe - origin)
        if kind == Effect.LOAD:
            value = value * mpmath.fdot(u, cross(places[load] - origin, mpmath.matrix([0, 0, -1])))
        if order:
            wave = mpmath.cos if order > 0 else mpmath.sin
            value = value * wave(abs(int(order)) * mpmath.mpf(row[joint]))
        total += mpmath.mpf(coef) * mpmath.mpf(unit) * value
    return [float(x) for x in total]


def test_every_way_has_them(fitted, tmp_path):
    model, X = fitted
    with mpmath.workdps(50):
        exact = np.array([in_50_digits(model, row) for row in X.tolist()])
    high = model.linear_model_.terms.harmonics[:, 1] > 390
    assert np.count_nonzero(high) >= 3
    assert np.ptp(exact, axis=0).min() > 0.02  # mm
    for way, found, _ in [("predict", model.predict(X), None), *ways_out(tmp_path, model, X)]:
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-12, err_msg=way)
