"""Golden numbers of the network, by name: what a change of it must not move without a word.

Generated problems with the truth known, two Panda arms and a UR10 with whole groups left out. Of
each is kept the held-out error in standard deviations of the truth, the share of new observations
inside the 95 % interval, and the number of centres. Everything by default parameters.
"""

import warnings

import numpy as np
from _arm_folds import NOMINAL_PANDA, pairs_known, read_panda, read_ur10
from _problems import GENERATED, generated
from scipy.stats import norm
from sklearn.model_selection import GroupKFold
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import (
    Arm,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    calibrate,
    position_residuals,
)

SIZES, MANY_DRAWS = (10, 30, 100, 300, 1000), {10: 20, 30: 10, 100: 4, 300: 2}
LEVEL = norm.ppf(0.975)


def _of_generated(name, n):
    """Error, coverage and number of centres of one problem, over some draws of few rows."""
    errors, covered, centers = [], [], []
    for seed in range(MANY_DRAWS.get(n, 1)):
        problem = generated(name, n, seed)
        model = RBFNetRegressor(random_state=0).fit(problem.X, problem.y)
        mean, std = model.predict(problem.X_test, return_std=True)
        scale = problem.truth.std(axis=0)
        errors.append(np.mean(np.square((mean - problem.truth) / scale)))
        covered.append(np.mean(np.abs(problem.observed - mean) <= LEVEL * std))
        centers.append(len(model.centers_))
    return np.sqrt(np.mean(errors)), np.mean(covered), np.mean(centers)


def _of_arm(arm, joints, angles, residuals, folds, groups=None, scatter=None):
    """Share of the residuals that a chain leaves in folds it has not seen, or of their scatter."""
    left, whole = 0.0, 0.0
    for learn, test in folds:
        inputs = {"joints": "all", "encoding": "periodic"} if joints else {}
        chain = make_pipeline(
            PoseFeatures(arm, append_azimuth=True, **inputs),
            CylindricalResidualTarget(RBFNetRegressor(random_state=0)),
        )
        labels = {}
        if groups is not None:
            labels["cylindricalresidualtarget__groups"] = groups[learn]
        chain.fit(angles[learn], residuals[learn], **labels)
        rest = residuals[test] - chain.predict(angles[test])
        if scatter is not None:  # what a position's mean takes out is not known of either
            rest = position_residuals(rest, scatter[test])
        left += np.square(rest).sum()
        whole += np.square(residuals[test]).sum()
    return np.sqrt(left / whole)


def _panda(name, home):
    """Arm, angles, residuals, labels and folds of whole placements."""
    angles, groups, placements = read_panda(name, home)
    known = pairs_known(np.unique(placements))
    found = calibrate(NOMINAL_PANDA, angles, groups, lengths=known)
    good = found.sample_weight > 0
    angles, groups = angles[good], groups[good]
    residuals = position_residuals(found.arm.forward(angles), groups)
    folds = list(GroupKFold(4).split(angles, groups=placements[good]))
    return found.arm, angles, residuals, groups, folds


def _ur10(home):
    """Arm, angles, residuals and folds of whole goals, of every fourth goal."""
    angles, points, groups = read_ur10("A", home)
    some = groups % 4 == 0
    angles, points, groups = angles[some], points[some], groups[some]
    found = calibrate(Arm.from_name("ur10", probe=(0, 0, 109)), angles, points=points)
    residuals = found.residuals(angles, points)
    return found.arm, angles, residuals, list(GroupKFold(3).split(angles, groups=groups))


def numbers(data_home):
    """Golden numbers of the network by name; `data_home` is the folder of the real data."""
    found = {}
    warnings.simplefilter("ignore")
    for name in GENERATED:
        for n in SIZES:
            error, covered, centers = _of_generated(name, n)
            found[f"network, {name}, {n} rows, error"] = float(error)
            found[f"network, {name}, {n} rows, inside 95 %"] = float(covered)
            found[f"network, {name}, {n} rows, centres"] = float(centers)
    arms = {name: _panda(name, data_home) for name in ("panda_2", "panda_3")}
    ur10 = _ur10(data_home)
    for joints in (False, True):
        kind = "all joints" if joints else "pose"
        for name, (arm, angles, residuals, groups, folds) in arms.items():
            for labels in (None, groups):
                what = f"network, {name}, {kind}{'' if labels is None else ', groups'}, error"
                error = _of_arm(arm, joints, angles, residuals, folds, labels, groups)
                found[what] = float(error)
        arm, angles, residuals, folds = ur10
        found[f"network, UR10, {kind}, error"] = float(
            _of_arm(arm, joints, angles, residuals, folds)
        )
    return found
