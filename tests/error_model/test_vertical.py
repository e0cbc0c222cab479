"""The vertical: stated, found by the data, and in whatever is made of a model."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal
from sklearn.base import clone

from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate, plan_poses, position_residuals
from sklearn_raacmm.datasets import SimulatedArm, make_single_point
from sklearn_raacmm.error_model import _fit
from sklearn_raacmm.error_model._columns import LOAD, Terms, columns_of
from sklearn_raacmm.error_model._fit import (
    _VARIANCES,
    _evidence_and_coef,
    _left_of_gravity,
    better_vertical,
)
from sklearn_raacmm.error_model._sums import Rows
from sklearn_raacmm.utils import FindingWarning

from ._arms import ARM, draw_angles

TURN = np.pi / 2  # of the base about its x axis: frame 0 bends about its own axes, now others


def on_a_turned_base(arm):
    """The same arm described from a base that is turned about x, in the modified convention."""
    alpha = arm.alpha.copy()
    alpha[0] += TURN
    return arm.replace(alpha=alpha, up=Rotation.from_rotvec([TURN, 0, 0]).apply(np.array(arm.up)))


@pytest.mark.parametrize("up", [(0, 0, 1), (1, 0.5, -0.3)])
def test_what_a_base_frame_is_called_changes_no_correction(up):
    """An exact law: turn base, vertical and residuals, and predictions turn with them.

    Before they fade: blocks that are left out are found from points by chance.
    """
    arm = Arm.from_name("panda", up=up, probe=(10, -20, 150))
    turned, turn = on_a_turned_base(arm), Rotation.from_rotvec([TURN, 0, 0])
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (200, 7))
    assert_allclose(turned.forward(X), turn.apply(arm.forward(X)), atol=1e-9)
    torques = np.cross(
        arm.frames(X)[:, 1:, :, 2], arm.forward(X)[:, None] - arm.frames(X)[:, 1:, :, 3]
    )
    turns = -1e-7 * torques @ arm.up * [3, 2, 1, 1, 0, 0, 0]
    y = np.einsum("nij,nj->ni", arm.jacobian(X), turns) + rng.normal(0, 0.01, (200, 3))
    fits = [
        ArmResidualRegressor(one, causes=["gravity"], orders=3).fit(X[:150], residuals[:150])
        for one, residuals in ((arm, y), (turned, turn.apply(y)))
    ]
    one, other = (fit.linear_model_.predict(X)[0] for fit in fits)
    assert_allclose(other, turn.apply(one), atol=1e-5)
    assert np.linalg.norm(one) > 0.1 * np.linalg.norm(y)


@pytest.fixture(scope="module")
def on_a_wall():
    """A simulated arm on a wall, whose description says that it stands upright; and the model."""
    machine = SimulatedArm("gravity", random_state=0, up=(1, 0, 0))
    test = make_single_point(8, 25, machine=machine, random_state=0)
    upright = ArmResidualRegressor(test.arm.replace(up=(0, 0, 1)), orders=4)
    with pytest.warns(FindingWarning, match=r"Gravity seems to pull against \(1\.00, "):
        upright.fit(test.data, test.target, groups=test.groups)
    return test, upright


def test_the_data_show_where_gravity_pulls(on_a_wall):
    test, found = on_a_wall
    stated = ArmResidualRegressor(test.arm, orders=4)
    stated.fit(test.data, test.target, groups=test.groups)
    assert stated.linear_model_.terms.up == ()
    assert "vertical" not in [finding.code for finding in stated.findings_]
    up = found.linear_model_.terms.up
    assert np.arccos(up @ test.arm.up) < np.deg2rad(2)  # and not the opposite direction
    fresh = make_single_point(
        6, 20, machine=test.simulation.machine, random_state=np.random.RandomState(5)
    )
    perfect = fresh.simulation.perfect_correction
    left = [fresh.target, *(perfect - model.predict(fresh.data) for model in (found, stated))]
    none, found, stated = (np.linalg.norm(position_residuals(one, fresh.groups)) for one in left)
    assert found < 1.1 * stated < 0.15 * none


def test_a_direction_is_found_beside_another_top_of_the_evidence():
    """At 45 degrees; from upright alone, which is stated, the search ends elsewhere."""
    machine = SimulatedArm("gravity", random_state=833, up=(1, 0, 1))
    test = make_single_point(8, 25, machine=machine, random_state=833)
    found = calibrate(test.nominal_arm.replace(up=(0, 0, 1)), test.data, test.groups)
    y = found.residuals(test.data, groups=test.groups)
    model = ArmResidualRegressor(found.arm, orders=4)
    with pytest.warns(FindingWarning, match=r"Gravity seems to pull against \(0\.7"):
        model.fit(test.data, y, groups=test.groups)
    assert np.arccos(model.linear_model_.terms.up @ test.arm.up) < np.deg2rad(3)


def test_the_search_ends_at_a_top_of_the_evidence(monkeypatch):
    """Of errors along one direction, whose evidence hardly rises beside the axis it begins at."""
    arm, rng = Arm.from_name("ur10"), np.random.default_rng(1)
    theta = arm.random_poses(150)
    other = arm.replace(alpha=arm.alpha + rng.normal(0, 1e-4, 6))
    y = other.forward(theta) - arm.forward(theta) + rng.normal(0, 0.01, (150, 3))
    y += 0.1 * np.sin(theta[:, 1:2]) * [1.0, 0.5, 0.2]
    left, lost = [], []

    def spied(*given):
        left[:] = _left_of_gravity(*given)
        return left

    def with_check(fitted):
        if len(found := better_vertical(fitted)):
            tried = [*rng.normal(size=(400, 3)), np.array(found)]
            tried = [_evidence_and_coef(up / np.linalg.norm(up), *left)[0] for up in tried]
            lost.append(max(tried) - tried[-1])
        return found

    monkeypatch.setattr(_fit, "_left_of_gravity", spied)
    monkeypatch.setattr(_fit, "better_vertical", with_check)
    with pytest.warns(FindingWarning, match="Gravity seems to pull"):
        ArmResidualRegressor(arm, orders=4).fit(theta, y, groups=False)
    assert len(lost)
    assert max(lost) < 0.1


def test_a_vertical_that_is_known_is_not_sought(on_a_wall, monkeypatch):
    """As fits of some rows have it of a fit of all; upright arms keep every bit of the model."""
    test, found = on_a_wall
    stood = clone(found)
    stood._vertical = found.linear_model_.terms.up
    upright = ArmResidualRegressor(test.arm, orders=4)
    sought = clone(upright).fit(test.data, test.target, groups=test.groups)
    monkeypatch.setattr(_fit, "better_vertical", None)
    stood.fit(test.data, test.target, groups=test.groups)
    assert "vertical" not in [finding.code for finding in stood.findings_]
    assert_allclose(stood.predict(test.data), found.predict(test.data), atol=1e-6)
    upright._vertical = ()
    upright.fit(test.data, test.target, groups=test.groups)
    assert_array_equal(upright.predict(test.data), sought.predict(test.data))


def test_a_model_moves_to_another_mount():
    """Compliances are the arm's: what the wall has shown corrects the same arm upright."""
    rng = np.random.default_rng(0)
    X, angles = rng.uniform(-2, 2, (300, 6)), rng.uniform(-2, 2, (100, 6))
    wall, upright = (
        SimulatedArm("gravity", random_state=0, up=up) for up in ((1, 0, 0), (0, 0, 1))
    )

    def sagged(machine, angles):
        moved = machine.deviations(angles)
        return -(moved["torsion"] + moved["sag"])

    model = ArmResidualRegressor(wall.true_arm, causes=["gravity"], orders=2)
    model.fit(X, sagged(wall, X) + rng.normal(0, 0.002, (300, 3)))
    moved = model.with_arm(upright.true_arm).linear_model_
    left = moved.predict(angles)[0] - sagged(upright, angles)
    assert np.linalg.norm(left) < 0.01 * np.linalg.norm(sagged(upright, angles))


def test_a_test_upright_corrects_the_same_arm_on_a_ceiling():
    """What cones hid upright is no doubt there: nearly all of the correction is used."""
    machine, hanging = (SimulatedArm("gravity", random_state=0, up=(0, 0, up)) for up in (1, -1))
    test = make_single_point(8, 15, machine=machine, random_state=0)
    found = calibrate(test.nominal_arm, test.data, test.groups)
    y = found.residuals(test.data, groups=test.groups)
    model = ArmResidualRegressor(found.arm, orders=2).fit(test.data, y, groups=test.groups)
    moved = model.with_arm(found.arm.replace(up=(0, 0, -1)))
    other = make_single_point(4, 15, machine=hanging, random_state=1)
    points = found.arm.forward(other.data)
    unfaded, used = moved.linear_model_.predict(other.data)[0], moved.predict(other.data)
    bare, best, left = (
        np.linalg.norm(position_residuals(points - shift, other.groups))
        for shift in (0, unfaded, used)
    )
    assert best < 0.3 * bare
    assert left < 1.3 * best


def test_another_probe_hides_the_same_fields():
    """As much of the scale and of motions of the base, whichever probe is there, is not shown."""
    test = make_single_point(6, 12, random_state=0)
    model = ArmResidualRegressor(test.arm, orders=2)
    linear = model.fit(test.data, test.target, groups=test.groups).linear_model_
    moved = model.with_arm(test.arm.replace(probe=(0, 0, 250)))
    longer = moved.linear_model_
    assert longer.scale_sd == pytest.approx(linear.scale_sd, rel=0.05)
    one, other = (np.sqrt(m.unseen_variance(test.data).mean()) for m in (linear, longer))
    assert 0.8 * one < other < 1.5 * one
    again = moved.with_arm(test.arm).linear_model_
    for kept in ("half", "gauge_free_half"):
        before, after = (
            np.square(m.columns(test.data) @ getattr(m, kept)) for m in (linear, again)
        )
        assert_allclose(after.sum(axis=2), before.sum(axis=2), rtol=0.02)


def test_what_the_data_found_belongs_to_one_mount(on_a_wall):
    _, found = on_a_wall
    longer = found.with_arm(found.arm.replace(probe=(0, 0, 200)))
    assert longer.linear_model_.terms.up == found.linear_model_.terms.up
    elsewhere = found.with_arm(found.arm.replace(up=(0, 1, 0)))
    assert elsewhere.linear_model_.terms.up == ()


def test_the_probe_of_a_plan_leans_from_the_vertical():
    arm = Arm.from_name("aacmm6", up=(1, 0, 0))
    plan = plan_poses(arm, 2, 4, lean_deg=60, random_state=0)
    line = plan.positions[plan.groups - 1] - arm.frames(plan.angles)[:, -1, :, 3]
    lean = np.degrees(np.arccos(-line[:, 0] / np.linalg.norm(line, axis=1)))
    assert lean.max() <= 60


@pytest.mark.parametrize("known", [None, 0.3])
def test_evidence_of_a_direction_is_that_of_the_normal_distribution(known):
    """With all other columns, and constants of positions, written out as one covariance."""
    rng = np.random.default_rng(3)
    theta, y, weights = draw_angles(ARM, 24), rng.normal(size=(24, 3)), rng.uniform(0.5, 2, 24)
    columns = columns_of(ARM, Terms(np.array([(0, 1), (4, 3)]), True, False, True))
    loads = np.flatnonzero(columns.table["kind"] == LOAD)
    prior, noise = rng.uniform(1e4, 4e4, len(columns.table)), 0.7
    state = SimpleNamespace(prior=np.roll(prior, -columns.n_waves), noise_variance=noise)
    codes = None if known is None else np.arange(24) % 5
    rows = Rows(ARM, theta, y, weights, codes, ridge=known or 0.0)
    left = _left_of_gravity(rows, columns, loads, state)
    up = np.array([0.6, 0.0, 0.8])
    rest = np.setdiff1d(np.arange(len(prior)), loads)
    A = np.moveaxis(columns.at(theta)[:, :, rest], 1, 0)
    turned = columns_of(ARM, columns.terms._replace(up=tuple(up.tolist())))
    L = np.moveaxis(turned.at(theta)[:, :, loads], 1, 0)
    covariance = np.kron(np.eye(3), np.diag(noise / weights))
    A, L = A.reshape(72, -1), L.reshape(72, -1)
    covariance += A * prior[rest] @ A.T
    if known is not None:
        same = (codes[:, None] == codes).astype(float)
        covariance += np.kron(np.eye(3), noise / known * same)

    def density(v):
        return multivariate_normal(np.zeros(72), covariance + v * L @ L.T).logpdf(y.T.ravel())

    found, coef, squares = _evidence_and_coef(up, *left)
    rises = [density(v) - density(0.0) for v in _VARIANCES]
    assert found == pytest.approx(max(rises), abs=1e-6)
    v = _VARIANCES[np.argmax(rises)]
    expected = v * L.T @ np.linalg.solve(covariance + v * L @ L.T, y.T.ravel())
    assert_allclose(coef, expected, atol=1e-6 * np.abs(expected).max())
    posterior = v * np.eye(len(loads)) - v * v * L.T @ np.linalg.solve(covariance + v * L @ L.T, L)
    assert_allclose(squares, np.outer(coef, coef) + posterior, atol=1e-6 * np.abs(squares).max())
