"""The choice of the next poses, against posteriors computed afresh."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.linear_model import LinearRegression

from sklearn_raacmm import Arm, ArmResidualRegressor, next_poses

ARM = Arm.from_name("aacmm6")


@pytest.fixture(scope="module", params=[False, True])
def planned(request):
    """Return a fitted model, candidates, and their positions."""
    rng = np.random.default_rng(0)
    theta = rng.uniform(-1, 1, (120, 6))
    y = rng.normal(0, 0.01, (120, 3))
    model = ArmResidualRegressor(
        ARM, orders=2, causes=["kinematics", "wobble"], offsets=request.param
    )
    model.fit(theta, y, groups=np.arange(120) % 10)
    candidates = rng.uniform(-2, 2, (40, 6))
    return model, candidates, np.repeat(np.arange(8), 5) if request.param else None


@pytest.mark.parametrize("criterion", ["I", "D"])
def test_choice_is_that_of_the_posterior_computed_afresh(planned, criterion):
    model, X, groups = planned
    chosen, std = next_poses(model, X, 3, groups=groups, criterion=criterion)
    codes = np.arange(len(X)) if groups is None else groups
    columns = model.linear_model_.columns(X)
    aim = columns.reshape(-1, columns.shape[2])
    half = model.linear_model_.gauge_free_half
    covariance = half @ half.T
    # With offsets the scale is held: no variance at all along it.
    precision = np.linalg.inv(covariance + 1e-9 * np.eye(len(covariance)))
    taken = []
    for step in range(3):
        values, spreads = {}, {}
        for label in sorted(set(codes.tolist()) - set(taken)):
            rows = columns[codes == label]
            if groups is not None:
                rows = rows - rows.mean(axis=0)
            rows = rows.reshape(-1, columns.shape[2]) / model.noise_sd_
            covariance = np.linalg.inv(precision + rows.T @ rows)
            spreads[label] = np.sqrt(np.trace(aim @ covariance @ aim.T) / len(X))
            logdet = np.linalg.slogdet(covariance)[1]
            values[label] = (spreads[label] if criterion == "I" else logdet, rows)
        best = min(values, key=lambda label: values[label][0])
        assert chosen[step] == best
        assert_allclose(std[step + 1], spreads[best], rtol=1e-4)
        rows = values[best][1]
        precision = precision + rows.T @ rows
        taken.append(best)
    now = model.linear_model_.predict(X, return_std=True)[1]
    assert_allclose(std[0], np.sqrt(np.square(now).sum(axis=1).mean()), rtol=1e-8)


def test_bad_input_is_refused(planned):
    model, X, groups = planned
    with pytest.raises(ValueError, match="n_poses == 41, must be"):
        next_poses(model, X, 41, groups=groups)
    with pytest.raises(ValueError, match='"I" or "D"'):
        next_poses(model, X, 2, groups=groups, criterion="A")
    with pytest.raises(
        TypeError, match="LinearRegression holds no linear model in use and cannot be planned"
    ):
        next_poses(LinearRegression().fit(X, X), X, 2)
    if groups is not None:
        with pytest.raises(ValueError, match="give groups"):
            next_poses(model, X, 2)
        with pytest.raises(ValueError, match="groups names 39 samples"):
            next_poses(model, X, 2, groups=groups[1:])
    else:
        assert_array_equal(next_poses(model, X, 2)[0], next_poses(model, X.tolist(), 2)[0])


# -- registration and calibration --------------------------------------------------------------


def place_columns(angles):
    """Moves of base and probe, by differences, times the priors of 1000 mm at the reach."""
    points, step = ARM.forward(angles), 1e-3
    columns = [np.broadcast_to(axis, points.shape) for axis in np.eye(3)]
    reach = np.hypot(ARM.a, ARM.d).sum() + np.linalg.norm(ARM.probe)
    columns += [np.cross(axis, points) / reach for axis in np.eye(3)]
    for axis in np.eye(3):
        columns.append((ARM.replace(probe=ARM.probe + step * axis).forward(angles) - points) / step)
    return np.stack(columns, axis=2) * 1000.0


@pytest.mark.parametrize("criterion", ["I", "D"])
def test_registration_is_planned_by_its_posterior(criterion):
    rng = np.random.default_rng(5)
    X, targets, measured = (rng.uniform(-2, 2, (n, 6)) for n in (30, 20, 4))
    chosen, std = next_poses(
        ARM, X, 4, targets=targets, criterion=criterion, free=["base", "probe"], measured=measured
    )
    columns, aim = (place_columns(q) for q in (X, targets))
    old = place_columns(measured).reshape(-1, 9) / 0.05
    precision = np.eye(9) + old.T @ old
    aim, taken = aim.reshape(-1, 9), []
    for step in range(4):
        rows = [c / 0.05 for c in columns]
        covariances = [np.linalg.inv(precision + r.T @ r) for r in rows]
        spreads = [np.sqrt(np.trace(aim @ c @ aim.T) / 20) for c in covariances]
        values = spreads if criterion == "I" else [np.linalg.slogdet(c)[1] for c in covariances]
        values = [np.inf if i in taken else v for i, v in enumerate(values)]
        best = int(np.argmin(values))
        assert chosen[step] == best
        assert std[step + 1] == pytest.approx(spreads[best], rel=1e-3)
        precision = precision + rows[best].T @ rows[best]
        taken.append(best)


def test_a_single_point_test_shows_no_base():
    rng = np.random.default_rng(0)
    X, groups = rng.uniform(-2, 2, (40, 6)), np.repeat(np.arange(8), 5)
    chosen, std = next_poses(ARM, X, 3, groups=groups, free=["base", "probe", "theta_offset"])
    without = next_poses(ARM, X, 3, groups=groups, free=["probe", "theta_offset"])
    assert_array_equal(chosen, without[0])
    assert_allclose(std, without[1])


def test_a_model_without_terms_and_wrong_names_get_one_sentence():
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (60, 6))
    bare = ArmResidualRegressor(ARM, orders=[50], causes=[]).fit(X, rng.normal(0, 0.01, (60, 3)))
    assert len(bare.coef_) == 0
    with pytest.raises(ValueError, match="no terms that a measurement could narrow"):
        next_poses(bare, X, 2)
    assert len(next_poses(bare, X, 2, free=["base"])[0]) == 2
    with pytest.raises(TypeError, match="give free"):
        next_poses(ARM, X, 2)
    for free in ("tool", ["base", "tool"], []):
        with pytest.raises(ValueError, match="free must name some of base, a, alpha"):
            next_poses(ARM, X, 2, free=free)
    with pytest.raises(ValueError, match="measured poses count one by one"):
        next_poses(ARM, X, 2, free=["probe"], groups=np.arange(60) // 5, measured=X)
    with pytest.raises(ValueError, match="7"):
        next_poses(ARM, np.zeros((5, 7)), 2, free=["probe"])
