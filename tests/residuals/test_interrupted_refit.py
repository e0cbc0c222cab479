"""A refit that is interrupted at any call leaves the old model whole."""

import inspect
import os
import sys

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_array_equal
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import Arm, CylindricalResidualTarget, PoseFeatures

PACKAGE = f"{os.sep}sklearn_raacmm{os.sep}"


class Interrupt(BaseException):
    """What no `except Exception` catches, as Ctrl-C."""


def interrupted(function, step):
    """Interrupt a function at this call of the package, or by it; return whether it came so far."""
    left = step

    def count(frame, event, arg):
        nonlocal left
        # An exception in a generator that is being closed is lost.
        if event != "call" or frame.f_code.co_flags & inspect.CO_GENERATOR:
            return
        if any(f and PACKAGE in f.f_code.co_filename for f in (frame, frame.f_back)):
            left -= 1
            if left < 0:
                raise Interrupt

    sys.setprofile(count)
    try:
        function()
    except Interrupt:
        return True
    finally:
        sys.setprofile(None)
    return False


def cases():
    """A fitted model, other data to fit it on, and how to ask it."""
    rng = np.random.default_rng(0)
    X, y = rng.uniform(-1, 1, (30, 6)), rng.normal(size=(30, 3))
    named = pd.DataFrame(rng.uniform(-1, 1, (20, 7)), columns=list("abcdefg"))
    six, seven = Arm.from_name("aacmm6"), Arm.from_name("panda")
    pose = PoseFeatures(six).fit(X)
    pose.set_params(arm=seven)
    yield pose, lambda: pose.fit(named), lambda: pose.transform(X)
    inner = make_pipeline(StandardScaler(), Ridge())
    model = CylindricalResidualTarget(inner, azimuth=six.azimuth).fit(X, y)
    other = named.set_axis([f"x{i}" for i in range(7)], axis=1).assign(c=1.0, s=0.0)

    def refit():
        model.set_params(azimuth="appended")
        model.fit(other, rng.normal(size=20))

    def predict():
        # Parameters are the user's own: only what was fitted has to be as before.
        model.set_params(azimuth=six.azimuth)
        return model.predict(X)

    yield model, refit, predict


@pytest.mark.parametrize("case", [0, 1])
def test_interrupted_at_every_call(case):
    model, refit, ask = list(cases())[case]
    before, expected = {k: v for k, v in vars(model).items() if k != "azimuth"}, ask()
    step = 0
    while interrupted(refit, step):
        now = {k: v for k, v in vars(model).items() if k != "azimuth"}
        if now.get("n_features_in_") != before["n_features_in_"]:
            break  # interrupted after the swap: the new model, as whole as the old one
        assert now.keys() == before.keys()
        assert all(now[k] is before[k] for k in now)
        assert_array_equal(ask(), expected)
        step += 1
    assert step > 10
    refit()
    assert "feature_names_in_" in vars(model)
    assert len(model.feature_names_in_) == model.n_features_in_ != before["n_features_in_"]


def test_a_refused_refit_leaves_the_old_model():
    X = np.zeros((3, 6))
    pose = PoseFeatures(Arm.from_name("aacmm6")).fit(X)
    with pytest.raises(ValueError, match="X has 7 columns"):
        pose.fit(np.zeros((3, 7)))
    assert pose.n_features_in_ == 6
    assert pose.transform(X).shape == (3, 3)
