"""How much of a function is used where groups are known: against models that never saw a group."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.network import _likelihood
from sklearn_raacmm.network._kernels import kernel_matrix
from sklearn_raacmm.network._likelihood import used_share
from sklearn_raacmm.network._rows import Rows
from sklearn_raacmm.utils import Groups


def of_groups(seed, n_groups=8, n_each=12, common=0.0, own=1.0):
    """A wave that all groups have in common, and a slope that each has of its own."""
    rng = np.random.default_rng(seed)
    groups = np.repeat(np.arange(n_groups), n_each)
    X = rng.uniform(-2, 2, (len(groups), 2))
    slopes = own * rng.standard_normal((n_groups, 2))
    y = common * np.sin(2 * X[:, 0]) + (X * slopes[groups]).sum(axis=1)
    return X, Groups(groups).centred(y + 0.05 * rng.standard_normal(len(y))), groups


@pytest.mark.parametrize("ratio", [0.0, 2.0])
def test_the_share_is_that_of_models_that_never_saw_a_group(ratio):
    X, y, groups = of_groups(0, 5, common=0.6, own=0.4)
    weights = np.random.default_rng(1).uniform(0.5, 2, len(y))
    data = Rows(X, np.column_stack([y, y**3]), weights, groups).merged()
    X, Y, w, codes = data.X, data.Y, data.weights, data.codes
    K = kernel_matrix(X, X, "gaussian")
    root, alphas = np.sqrt(w), (0.1, 0.5)
    found, left = used_share(data, root[:, None] * K * root, alphas, ratio)
    for i, alpha in enumerate(alphas):
        noise = alpha * (np.diag(1 / w) + ratio * np.equal.outer(codes, codes))
        f = np.empty(len(y))
        for code in np.unique(codes):
            own, rest = codes == code, codes != code
            inner = (K + noise)[np.ix_(rest, rest)]
            f[own] = K[np.ix_(own, rest)] @ np.linalg.solve(inner, Y[rest, i])
        f, d = Groups(codes).centred(f, w), Groups(codes).centred(Y[:, i], w)
        share = np.sum(w * d * f) / np.sum(w * f * f)
        pulls = np.bincount(codes, w * (d - share * f) * f)
        share = np.clip(share - 2 * np.linalg.norm(pulls) / np.sum(w * f * f), 0, 1)
        assert_allclose(found[i], share, rtol=1e-9)
        assert_allclose(left[i], np.sum(w * (d - share * f) ** 2) / (w.sum() - 5), rtol=1e-9)


def test_what_each_group_has_of_its_own_is_not_followed():
    alone, followed = [], []
    for seed in range(5):
        X, y, groups = of_groups(seed, own=0.3)
        T, new, labels = of_groups(seed + 100, own=0.3)
        for found, known in ((alone, groups), (followed, None)):
            left = new - Groups(labels).centred(
                RBFNetRegressor(random_state=0).fit(X, y, groups=known).predict(T)
            )
            found.append(np.mean(np.square(left)) / np.mean(np.square(new)))
    assert max(alone) < 1.05 < max(followed)


def test_what_all_groups_have_in_common_is_used(monkeypatch):
    X, y, groups = of_groups(0, common=1.0, own=0.0)
    model = RBFNetRegressor(random_state=0).fit(X, y, groups=groups)
    # Where groups are few, all of the function is used.
    monkeypatch.setattr(_likelihood, "LEAST_GROUPS", 9)
    whole = RBFNetRegressor(random_state=0).fit(X, y, groups=groups)
    share = model.coef_ / whole.coef_
    assert_allclose(share, share[0], rtol=1e-9)
    assert 0.9 < share[0] <= 1
    assert_array_equal(model.intercept_, whole.intercept_)


def test_a_share_leaves_the_constant_and_widens_the_noise():
    X, y, _ = of_groups(0, common=1.0, own=0.0)
    network = RBFNetRegressor(random_state=0).fit(X, y + 3).networks_[0]
    half = network.with_share(np.array([0.5]), 9 * network.noise_variance)
    constant = network.polynomial[0]
    assert_allclose(half.predict(X) - constant, 0.5 * (network.predict(X) - constant), atol=1e-12)
    assert_allclose(half.noise_variance, 9 * network.noise_variance)
    assert_array_equal(network.with_share(np.ones(1), np.full(1, 9.0)).std(X), network.std(X))
