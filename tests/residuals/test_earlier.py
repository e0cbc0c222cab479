"""Earlier systems as chains."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sklearn.base import clone
from sklearn.neighbors import KDTree

from sklearn_raacmm import (
    CylindricalResidualTarget,
    PoseFeatures,
    cartesian_to_cylindrical,
    cylindrical_to_cartesian,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.metrics import single_point_repeatability
from sklearn_raacmm.residuals import bp_network_chain, database_chain, polynomial_chain


@pytest.fixture(scope="module")
def test():
    """Simulated: an arm that gravity bends."""
    return make_single_point(24, 20, machine="gravity", random_state=3)


def test_polynomial_against_least_squares(test):
    """A cubic of the pose, in monomials written out, with a constant at each position."""
    X, y, groups = test.data, test.target, test.groups
    model = polynomial_chain(test.arm, degree=3, alpha=1e-12).fit(X, y, groups=groups)

    pose = PoseFeatures(test.arm).fit_transform(X)
    powers = [(i, j, k) for i in range(4) for j in range(4) for k in range(4) if 0 < i + j + k <= 3]
    terms = np.array([np.prod(pose**power, axis=1) for power in powers]).T
    dummies = np.equal.outer(groups, np.unique(groups)).astype(float)
    azimuth = test.arm.azimuth(X)
    turned = cartesian_to_cylindrical(y, azimuth)
    coef = np.linalg.lstsq(np.hstack([terms, dummies]), turned, rcond=None)[0][: len(powers)]
    expected = terms @ coef
    expected -= expected.mean(axis=0) - turned.mean(axis=0)
    assert_allclose(model.predict(X), cylindrical_to_cartesian(expected, azimuth), atol=1e-7)


def test_database_against_a_tree(test):
    learn = np.arange(len(test.data)) % 2 == 0
    X, y, new = test.data[learn], test.target[learn], test.data[~learn]
    model = database_chain(test.arm, n_neighbors=4).fit(X, y, groups=test.groups[learn])
    pose = PoseFeatures(test.arm).fit(X)
    known, asked = pose.transform(X), pose.transform(new)
    far, index = KDTree(known / known.std(axis=0)).query(asked / known.std(axis=0), k=4)
    share = (1 / far) / (1 / far).sum(axis=1, keepdims=True)
    turned = cartesian_to_cylindrical(y, test.arm.azimuth(X))
    expected = np.einsum("nk,nko->no", share, turned[index])
    found = cartesian_to_cylindrical(model.predict(new), test.arm.azimuth(new))
    assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("build", [polynomial_chain, database_chain, bp_network_chain])
def test_each_corrects_at_positions_left_out(test, build):
    rest = test.groups % 3 == 0
    options = {"random_state": 0} if build is bp_network_chain else {}
    model = build(test.arm, **options)
    assert isinstance(clone(model), CylindricalResidualTarget)
    model.fit(test.data[~rest], test.target[~rest], groups=test.groups[~rest])
    after = single_point_repeatability(model.correct(test.data[rest]), test.groups[rest])
    assert after < 0.9 * single_point_repeatability(test.points[rest], test.groups[rest])
