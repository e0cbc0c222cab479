"""Warnings point to the line that calls the package; findings as warnings, and collected."""

import pickle
import warnings
from pathlib import Path

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import cross_val_predict
from sklearn.pipeline import make_pipeline

import sklearn_raacmm
from sklearn_raacmm import Arm, CylindricalResidualTarget, PoseFeatures, calibrate, elbow_angle
from sklearn_raacmm.utils import Finding, FindingWarning, warn_user

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
    "a fit": lambda: CylindricalResidualTarget(azimuth=ARM.azimuth).fit(
        X, SHIFTED, accept="another-frame"
    ),
    "a calibration": lambda: calibrate(ARM, X[:9], points=Y[:9], accept="points-of-the-arm"),
    "loading": lambda: pickle.loads(OLD),
}


def warnings_of(call, *args):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call(*args)
    return caught


@pytest.mark.parametrize("name", CALLS)
def test_the_line_is_that_of_the_call(name):
    call = CALLS[name]
    caught = warnings_of(call)
    assert caught
    line = call.__code__.co_firstlineno
    assert {(one.filename, one.lineno) for one in caught} == {(__file__, line)}


def function(filename, source, **names):
    """The function f of this source, which seems to stand in a file."""
    exec(compile(source, filename, "exec"), names)
    return names["f"]


def test_lines_of_the_package_are_skipped_and_no_others():
    inner = function(f"{PACKAGE}/_a.py", "def f():\n warn('so', FutureWarning)", warn=warn_user)
    deep = function(f"{PACKAGE}/part/_b.py", "def f():\n g()", g=inner)
    beside = function(f"{PACKAGE}_user.py", "def f():\n\n\n g()", g=deep)
    (one,) = warnings_of(function("/elsewhere.py", "def f():\n g()", g=beside))
    assert (one.filename, one.lineno) == (f"{PACKAGE}_user.py", 4)
    assert (one.category, str(one.message)) == (FutureWarning, "so")


DOUBT = Finding("moved-position", "Position 'a' moved by 2 mm.", "Fasten it.")


def test_a_finding_is_a_warning_and_a_note_is_none():
    Finding("dwells", "300 rows are 3 poses.", weight="note").report()
    with pytest.warns(FindingWarning, match=r"Position 'a' moved by 2 mm\. Fasten it\.") as caught:
        DOUBT.report()
    assert [warning.message.finding for warning in caught] == [DOUBT]
    assert caught[0].filename == __file__


def test_findings_are_collected_once_and_other_warnings_go_on():
    def collected():
        with Finding.collected() as found:
            DOUBT.report()
            DOUBT.report()
            warnings.warn("other", UserWarning, stacklevel=1)
        assert found == [DOUBT]

    (other,) = warnings_of(collected)
    assert str(other.message) == "other"
