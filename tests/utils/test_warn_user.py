"""Warnings point to the line that calls the package, from however deep within it."""

import pickle
import warnings
from pathlib import Path

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import cross_val_predict
from sklearn.pipeline import make_pipeline

import sklearn_raacmm
from sklearn_raacmm import (
    Arm,
    CylindricalResidualTarget,
    PoseFeatures,
    calibrate,
    elbow_angle,
)
from sklearn_raacmm.utils import warn_user

PACKAGE = str(Path(sklearn_raacmm.__file__).parent)
ARM = Arm.from_name("aacmm6")
X = np.random.default_rng(0).uniform(-1, 1, (60, 6))
Y = ARM.forward(X)
DEGREES = np.rad2deg(X)
SHIFTED = np.full_like(Y, 5.0)  # the reference is in another frame
PIPELINE = make_pipeline(PoseFeatures(ARM), LinearRegression())
OLD = pickle.dumps(PoseFeatures(ARM)).replace(
    sklearn_raacmm.__version__.encode(), b"0" * len(sklearn_raacmm.__version__)
)
CALLS = {
    "a method of an arm": lambda: ARM.forward(DEGREES),
    "a function": lambda: elbow_angle(ARM, DEGREES),
    "an estimator": lambda: PoseFeatures().fit(X),
    "within a pipeline": lambda: make_pipeline(PoseFeatures(), LinearRegression()).fit(X, Y),
    "within folds": lambda: cross_val_predict(PIPELINE, DEGREES, Y, n_jobs=1),
    "a fit": lambda: CylindricalResidualTarget(azimuth=ARM.azimuth).fit(X, SHIFTED),
    "a calibration": lambda: calibrate(ARM, X[:9], points=Y[:9]),
    "loading": lambda: pickle.loads(OLD),
}


def said_by(call, *args):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        call(*args)
    return said


@pytest.mark.parametrize("name", CALLS)
def test_the_line_is_that_of_the_call(name):
    call = CALLS[name]
    said = said_by(call)
    assert said
    line = call.__code__.co_firstlineno
    assert {(one.filename, one.lineno) for one in said} == {(__file__, line)}


def function(filename, source, **names):
    """The function f of this source, which seems to stand in a file."""
    exec(compile(source, filename, "exec"), names)
    return names["f"]


def test_lines_of_the_package_are_skipped_and_no_others():
    inner = function(f"{PACKAGE}/_a.py", "def f():\n warn('so', FutureWarning)", warn=warn_user)
    deep = function(f"{PACKAGE}/part/_b.py", "def f():\n g()", g=inner)
    beside = function(f"{PACKAGE}_user.py", "def f():\n\n\n g()", g=deep)
    (one,) = said_by(function("/elsewhere.py", "def f():\n g()", g=beside))
    assert (one.filename, one.lineno) == (f"{PACKAGE}_user.py", 4)
    assert (one.category, str(one.message)) == (FutureWarning, "so")


def test_once_for_each_line_where_python_is_asked_for_that():
    twice = function(
        f"{PACKAGE}/_a.py", "def f():\n warn('first')\n warn('second')", warn=warn_user
    )
    call = function("/elsewhere.py", "def f():\n for _ in range(3):\n  g()\n g()", g=twice)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("default")
        call()
    assert [(one.lineno, str(one.message)) for one in said] == [
        (3, "first"),
        (3, "second"),
        (4, "first"),
        (4, "second"),
    ]
