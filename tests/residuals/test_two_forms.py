"""The chain outermost and as a pipeline: equal with groups, and said where these are missing."""

import numpy as np
import pytest
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import CylindricalResidualTarget, PoseFeatures, RBFNetRegressor
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.utils import FindingWarning

TEST = make_single_point(5, 16, machine="typical", random_state=2)  # simulated
ARM, X, Y = TEST.arm, TEST.data, TEST.target
GROUPS = "cylindricalresidualtarget__groups"


def outermost(groups, regressor):
    inner = make_pipeline(PoseFeatures(ARM), regressor)
    model = CylindricalResidualTarget(inner, azimuth=ARM.azimuth)
    return model.fit(X, Y, groups=groups).predict(X)


def pipeline(groups, regressor, rows=slice(None), y=Y):
    last = CylindricalResidualTarget(regressor)
    model = make_pipeline(PoseFeatures(ARM, append_azimuth=True), last)
    return model.fit(X[rows], y[rows], **{GROUPS: groups}).predict(X)


def test_both_forms_are_equal_with_groups_whatever_these_are_called():
    network = RBFNetRegressor(random_state=0)
    expected = outermost(TEST.groups, network)
    np.testing.assert_allclose(pipeline(TEST.groups, network), expected, rtol=0, atol=1e-9)
    renamed = np.array(["QZ", "p", "A", "m", "B"])[TEST.groups]
    np.testing.assert_array_equal(outermost(renamed, network), expected)


def test_the_pipeline_asks_for_the_groups_that_the_outermost_form_finds():
    shuffled = np.random.default_rng(0).permutation(len(X))
    for rows in (slice(None), shuffled):
        with pytest.warns(FindingWarning, match="80 rows of y deviate from at most 5 positions"):
            pipeline(None, Ridge(), rows)


def test_nobody_asks_where_groups_are_refused_or_a_tracker_has_measured():
    """A warning is an error in all tests."""
    pipeline(False, Ridge())
    pipeline(None, Ridge(), y=ARM.forward(X) - TEST.simulation.true_points)


@pytest.mark.parametrize("up", [(1, 0, 0), (0, 0.6, 0.8)])
def test_the_pose_of_an_arm_whose_axis_is_not_upright_is_refused(up):
    leaning = ARM.replace(up=up)
    with pytest.raises(ValueError, match=r"up of the arm is \(.*\), which is not along the base"):
        PoseFeatures(leaning).fit(X)
    assert PoseFeatures(leaning, joints="all").fit_transform(X).shape == (80, 6)
    assert PoseFeatures(ARM.replace(up=(0, 0, -1))).fit_transform(X).shape == (80, 3)
