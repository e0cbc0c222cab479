"""Rise of the evidence by candidates, against densities of SciPy."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from sklearn_raacmm import Arm, JointHarmonicRegressor
from sklearn_raacmm.error_model._leftover import Leftover
from sklearn_raacmm.error_model._order_scan import columns_of


def log_evidence(y, columns, variances, noise):
    """Of y with normal coefficients of these variances and white noise, by SciPy."""
    covariance = noise * np.eye(len(y)) + columns @ (np.asarray(variances)[:, None] * columns.T)
    return multivariate_normal(cov=covariance).logpdf(y)


def dense_problem(rng, n=60, n_others=4, n_pairs=5):
    """Random columns, correlated, and what `Leftover` reads of their sums."""
    others = rng.normal(size=(n, n_others))
    waves = rng.normal(size=(n, 2 * n_pairs)) + others[:, :1] + 0.5 * rng.normal(size=(n, 1))
    y = waves[:, :4] @ [0.5, -0.3, 0.2, 0.4] + 0.3 * rng.normal(size=n)
    gram = waves.T @ waves
    own = [gram[::2, ::2].diagonal(), gram[1::2, 1::2].diagonal(), gram[::2, 1::2].diagonal()]

    def rows(pairs, likely=(), beside=()):
        return gram[np.ix_(columns_of(pairs), columns_of(beside))]

    sums = SimpleNamespace(
        gram=others.T @ others,
        moment=others.T @ y,
        cross=others.T @ waves,
        own=np.array(own),
        candidate_moment=waves.T @ y,
        rows=rows,
    )
    problem = SimpleNamespace(
        sums=sums, lengths=None, harmonic=1, family=np.zeros(n_others, dtype=int)
    )
    return problem, y, others, waves


@pytest.mark.parametrize("chosen", [(), (3,), (1, 4)])
def test_gains_are_those_of_the_evidence(chosen):
    """Of a pair beside others and chosen pairs: the log ratio of two normal densities of y."""
    problem, y, others, waves = dense_problem(np.random.default_rng(len(chosen)))
    variance, noise, share = np.array([0.7, 0.4, 0.1]), 0.09, 1.0
    pairs, smooth = np.array(chosen, dtype=int), np.zeros(len(chosen), dtype=bool)
    left = Leftover(problem, pairs, smooth, share, variance, noise)
    gain, sound = left.gains()

    def evidence(pairs):
        taken = [c for p in pairs for c in (2 * p, 2 * p + 1)]
        columns = np.column_stack([others, waves[:, taken]])
        return log_evidence(y, columns, [0.7] * 4 + [0.4] * len(taken), noise)

    free = [p for p in range(5) if p not in chosen]
    expected = [evidence([*chosen, p]) - evidence(chosen) for p in free]
    assert left.free.tolist() == free
    assert sound.all()
    assert_allclose(gain, expected, rtol=1e-9, atol=1e-9)
    # The same by taking the pairs one after another.
    step = Leftover(problem, np.array([], dtype=int), np.array([], bool), share, variance, noise)
    for pair in chosen:
        step.take(pair, ())
    assert_allclose(step.gains()[0][free], gain, rtol=1e-9, atol=1e-9)


def test_no_orders_need_be_offered():
    """The other families alone explain what they have caused, and leave the noise."""
    arm = Arm.from_name("aacmm6")
    rng = np.random.default_rng(0)
    theta = rng.uniform(-1.5, 1.5, (80, 6))
    other = arm.replace(theta_offset=arm.theta_offset + 1e-4)
    y = other.forward(theta) - arm.forward(theta) + rng.normal(scale=0.01, size=(80, 3))
    model = JointHarmonicRegressor(arm, max_order=0, gravity=False, wobble=False).fit(theta, y)
    assert not len(model.harmonics_)
    assert y.std() > 0.05
    assert (y - model.predict(theta)).std() == pytest.approx(0.01, rel=0.2)
