"""Chains of estimators that the tests of all formats export, and poses to compare them at."""

import shutil

import numpy as np
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
)

STRICT = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wshadow"]
STRICT += ["-Wdouble-promotion", "-Wstrict-overflow=1", "-Wfloat-conversion"]
COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]


def network(**params):
    # Given widths: what is searched for in a fit is not the question here.
    given = {"n_centers": 20, "length_scale": 1.5, "alpha": 0.03}
    return RBFNetRegressor(**{**given, **params})


def form_a(arm, scaler=None, net=None, **pose):
    steps = [PoseFeatures(arm, **pose), scaler or StandardScaler(), net or network()]
    return CylindricalResidualTarget(make_pipeline(*steps), azimuth=arm.azimuth)


def form_b(arm, scaler=None, net=None, **pose):
    inner = make_pipeline(scaler or StandardScaler(), net or network())
    pose = PoseFeatures(arm, append_azimuth=True, **pose)
    return make_pipeline(pose, CylindricalResidualTarget(inner))


def of_arm(arm, *causes, **params):
    return ArmResidualRegressor(arm, **{"orders": 5, "causes": list(causes), **params})


def angles_everywhere(n_joints, n=300):
    """Training-like, wrapped, far and special angles."""
    rng = np.random.default_rng(0)
    turns = 2 * np.pi * rng.integers(-1, 2, (n, n_joints))
    near = rng.uniform(-np.pi, np.pi, (n, n_joints))
    edges = np.array([0.0, -np.pi, np.pi, np.pi / 2, 1e-9, -1e-300])
    corners = rng.choice(edges, (n, n_joints))
    return np.concatenate([near, near + turns, rng.uniform(-12, 12, (n, n_joints)), corners])


def no_azimuth(X):
    return np.zeros(len(X))
