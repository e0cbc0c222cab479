"""Touches of planes and spheres teach the model as cones do."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import ArmResidualRegressor, position_residuals
from sklearn_raacmm.datasets import SimulatedArm, make_features, make_single_point
from sklearn_raacmm.error_model._checks import check_fit
from sklearn_raacmm.error_model._columns import Terms, columns_of
from sklearn_raacmm.error_model._left_out import centre_beside_table
from sklearn_raacmm.error_model._sums import Noise, candidate_sums, length_equations
from sklearn_raacmm.measurements import Features


def rows_of(test, **fit):
    """The `Rows` of touches, and the residuals that `fit` is given."""
    y = position_residuals(test.arm.forward(test.data), test.groups, features=test.features)
    model = ArmResidualRegressor(test.arm)
    given = {"sample_weight": None, "groups": test.groups, "lengths": (), "probes": None}
    return check_fit(model, test.data, y, *(given | fit).values(), test.features)[0]


def touched(seed=0, **kinds):
    machine = SimulatedArm("eccentricity", random_state=seed)
    return make_features(**kinds, machine=machine, random_state=seed)


def test_sums_are_those_of_explicit_matrices():
    """Planes, spheres and cones together, with noise of each joint and weights."""
    test, rng = touched(n_spheres=2, n_planes=2, n_cones=2, n_touches=8), np.random.default_rng(0)
    rows = rows_of(test)
    noise = Noise(rng.uniform(0, 1e-9, 6), 1e-5, np.ones(6))
    J = test.arm.jacobian(test.data)
    rows = rows._replace(root=noise.roots(J, rows.shown), weights=rng.uniform(0.5, 2, len(J)))
    columns = columns_of(test.arm, Terms(np.array([(1, 1), (4, 3)]), True, False, True))
    (found,) = candidate_sums(rows, columns, np.zeros(len(rows.X), int))
    A = columns.at(test.data)
    A = np.concatenate([A[:, :, 4:], A[:, :, :4], rows.y[:, :, None]], axis=2)
    C = (noise.of_joints * J) @ J.swapaxes(1, 2) + noise.of_rows * np.eye(3)
    gram, n_observations = 0.0, 0.0
    for code in range(6):
        of = np.flatnonzero(rows.codes == code)
        d = rows.shown[of]
        kept = np.square(d).sum(axis=2).ravel() > 0.5  # a plane's touch is one equation
        whole = np.zeros((3 * len(of), 3 * len(of)))
        for i, row in enumerate(of):
            whole[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = d[i] @ C[row] @ d[i].T / rows.weights[row]
        inverse = np.linalg.inv(whole[np.ix_(kept, kept)])
        part = (d @ A[of]).reshape(len(kept), -1)[kept]
        B = (d @ rows.unknowns[of]).reshape(len(kept), -1)[kept]
        T = np.linalg.pinv(B.T @ inverse @ B, 1e-12, hermitian=True)
        gram = gram + part.T @ (inverse - inverse @ B @ T @ B.T @ inverse) @ part
        rank = np.square(d).sum(axis=(1, 2))
        n_observations += rows.weights[of] @ rank - np.linalg.matrix_rank(B)
    size = np.sqrt(gram.diagonal())
    size = np.outer(size, size)
    size = np.where(size > 1e-9 * size.max(), size, 1e-9 * size.max())
    m = len(found.gram)
    for own, expected, scale in (
        (found.gram, gram[:m, :m], size[:m, :m]),
        (found.cross, gram[:m, m:-1], size[:m, m:-1]),
        (found.candidate_moment, gram[m:-1, -1], size[m:-1, -1]),
        (found.rows([0, 1]), gram[m:-1, m:-1], size[m:-1, m:-1]),
        (found.square, gram[-1, -1], size[-1, -1]),
    ):
        assert_allclose(own / scale, expected / scale, atol=1e-9)
    assert found.n_observations == pytest.approx(n_observations)


def test_stated_sizes_and_lengths_are_those_of_forms_fitted_anew():
    """An independent fit of the forms to moved points: a size, and a distance of two kinds."""
    test = touched(n_spheres=2, n_planes=2, n_touches=12)
    labels = [entry[0] for entry in test.features]
    between = [(labels[0], labels[1], 300.0, 0.01), (labels[0], labels[2], 300.0, 0.01)]
    rows = rows_of(test, lengths=between)
    assert sorted(i == j for i, j, *_ in rows.lengths) == [False, False, True, True]
    columns = columns_of(test.arm, Terms(np.empty((0, 2), int), False, True, False))
    extra = length_equations(rows, columns)
    w = np.random.default_rng(0).normal(0, 0.5, len(columns.others))
    moved = test.arm.forward(test.data) - columns.at(test.data) @ w
    codes, weights = rows.codes, np.ones(len(moved))
    kinds = [entry[1] for entry in test.features]
    order = np.argsort([np.flatnonzero(test.groups == label)[0] for label in labels])
    both = Features([kinds[i] for i in order], codes)
    forms = both.linearised(moved, weights).forms
    before = both.linearised(test.arm.forward(test.data), weights).forms
    for (i, j, stated, _), row, value in zip(rows.lengths, extra.rows, extra.values, strict=True):
        expected = forms[i].length_to(forms[j])[0] - stated
        change = expected - (before[i].length_to(before[j])[0] - stated)
        assert value - row @ w == pytest.approx(expected, abs=0.03 * abs(change) + 1e-4)


@pytest.mark.parametrize(
    "kinds",
    [
        {"n_spheres": 4, "n_planes": 6},
        pytest.param({"n_spheres": 8, "n_planes": 0}, marks=pytest.mark.exhaustive),
    ],
)
def test_touches_correct_new_cones(kinds):
    """At cones that the model has not seen, of which nothing but the noise is to be left."""
    test = touched(1, **kinds, n_touches=25)
    y = position_residuals(test.arm.forward(test.data), test.groups, features=test.features)
    model = ArmResidualRegressor(test.arm, orders=4)
    model.fit(test.data, y, groups=test.groups, features=test.features)
    machine = SimulatedArm("eccentricity", random_state=1)
    new = make_single_point(5, 20, machine=machine, random_state=9)
    left = position_residuals(new.target - model.predict(new.data), new.groups)
    perfect = new.target - new.simulation.perfect_correction
    left, perfect, before = (
        np.linalg.norm(position_residuals(part, new.groups)) for part in (left, perfect, new.target)
    )
    assert left < min(1.5 * perfect, 0.6 * before)
    assert model.judgement_.n_positions == len(test.features)


def test_a_share_is_judged_beside_what_the_table_explains():
    """Touches that calibrated the arm say nothing of an error of its table, and all of noise."""
    test, rng = touched(n_spheres=0, n_planes=10, n_touches=25), np.random.default_rng(0)
    rows = rows_of(test)
    centre = centre_beside_table(rows)
    other = test.arm.replace(
        alpha=test.arm.alpha + rng.normal(0, 1e-6, 6), a=test.arm.a + rng.normal(0, 1e-3, 6)
    )
    moved, noise = other.forward(test.data) - test.arm.forward(test.data), rng.normal(size=(250, 3))
    for values, low, high in ((moved, 0.0, 0.02), (noise, 0.9, 1.0)):
        share = np.linalg.norm(centre(values, rows.weights))
        share /= np.linalg.norm(rows.centre(values, rows.weights))
        assert low <= share <= high


def test_features_need_labels_and_constants():
    test = touched(n_spheres=2, n_planes=2, n_touches=8)
    y = np.zeros((len(test.data), 3))
    model = ArmResidualRegressor(test.arm)
    with pytest.raises(ValueError, match="features need groups"):
        model.fit(test.data, y, features=test.features)
    with pytest.raises(ValueError, match="features need groups"):
        ArmResidualRegressor(test.arm, offsets=False).fit(
            test.data, y, groups=test.groups, features=test.features
        )
    with pytest.raises(ValueError, match="which has no rows"):
        model.fit(test.data, y, groups=test.groups, features=[("nothing", "plane")])
