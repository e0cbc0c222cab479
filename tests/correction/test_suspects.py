"""The change that new rows make likely, against the densities themselves."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from sklearn_raacmm import Arm, ArmResidualRegressor
from sklearn_raacmm.correction._change import as_prior
from sklearn_raacmm.correction._rows import Expected, new_rows
from sklearn_raacmm.correction._suspects import (
    _NOISES,
    _SIZES,
    NOISE,
    likeliest_change,
    named_changes,
)

M = 40


@pytest.fixture(scope="module")
def drawn():
    """A root of what the model leaves open, and causes of one and of three numbers."""
    rng = np.random.default_rng(0)
    causes = {"one": rng.normal(size=(M, 1)), "three": rng.normal(size=(M, 3))}
    return rng.normal(size=(M, 6)), causes, rng


def log_evidences(residual, known, causes):
    """By the normal density at every noise and size; of "noise" that of no cause."""
    found = {}
    for name, columns in {NOISE: np.zeros((M, 1)), **causes}.items():
        unit = columns * np.sqrt(M) / max(np.linalg.norm(columns), 1e-300)
        logs = [
            multivariate_normal.logpdf(
                residual, cov=f**2 * np.eye(M) + known @ known.T + (f * v) ** 2 * unit @ unit.T
            )
            for f in _NOISES
            for v in _SIZES
        ]
        found[name] = logsumexp(logs) - np.log(len(logs))
        found[name] -= np.log(len(causes)) * (name != NOISE)
    return found


def test_the_likeliest_change_is_that_of_the_highest_density(drawn):
    known, causes, rng = drawn
    for size in (0.0, 0.3, 0.6, 1.0, 3.0, 30.0):
        for name, columns in causes.items():
            for noise in (1.0, 4.0):
                residual = known @ rng.normal(size=6) + noise * rng.normal(size=M)
                residual += size * columns @ rng.normal(size=columns.shape[1])
                expected = log_evidences(residual, known, causes)
                found, change, nats = likeliest_change(residual, known, causes, M)
                assert found == max(expected, key=expected.get)
                assert nats == pytest.approx(expected[found] - expected[NOISE], abs=1e-6)
                assert (change is None) == (found == NOISE)
                if size == 30.0:
                    assert found == name
                    assert change.shape == columns.shape
                    ratio = change / columns
                    assert_allclose(ratio, ratio[0, 0])


def test_more_noise_is_no_change(drawn):
    """Rows that scatter fifty times as much as before: few of 100 draws name one of two causes."""
    known, causes, rng = drawn
    names = []
    for _ in range(100):
        residual = known @ rng.normal(size=6) + 50 * rng.normal(size=M)
        names.append(likeliest_change(residual, known, causes, M)[0])
    assert names.count(NOISE) > 85


def test_a_probe_that_was_fitted_to_the_poses_has_not_changed():
    """What it shows beside an aligned base is its own; fitted to the same poses it is no change."""
    arm, rng = Arm.from_name("ur10", probe=(0, 0, 93)), np.random.default_rng(0)
    angles, today = rng.uniform(-2, 2, (300, 6)), rng.uniform(-2, 2, (30, 6))
    model = ArmResidualRegressor(arm, orders=4).fit(angles, rng.normal(0, 0.01, (300, 3)))
    bent = arm.forward(today) - arm.replace(probe=(0.3, 0, 93)).forward(today)
    rows = new_rows(model, today, bent + rng.normal(0, 0.01, bent.shape))
    expected = Expected(as_prior(model.linear_model_), rows)
    assert named_changes(expected, ["base"]) == ["probe"]
    assert named_changes(expected, ["base"], least_nats=1e9) == []
    assert named_changes(expected) == []
