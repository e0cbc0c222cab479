"""A refit that is interrupted anywhere leaves the old model whole."""

import inspect
import os
import sys

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_array_equal
from sklearn.base import clone
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
)

PACKAGE = f"{os.sep}sklearn_raacmm{os.sep}"


class Interrupt(BaseException):
    """What no `except Exception` catches, as Ctrl-C."""


def calls(function, at=None):
    """Number of calls of the package, or by it; None where the function is interrupted at one."""
    count = 0

    def tell(frame, event, arg):
        nonlocal count
        # An exception in a generator that is being closed is lost.
        if event != "call" or frame.f_code.co_flags & inspect.CO_GENERATOR:
            return
        if any(f and PACKAGE in f.f_code.co_filename for f in (frame, frame.f_back)):
            count += 1
            if count == at:
                raise Interrupt

    sys.setprofile(tell)
    try:
        function()
    except Interrupt:
        return None
    finally:
        sys.setprofile(None)
    return count


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
    at = 1
    while calls(refit, at) is None:
        now = {k: v for k, v in vars(model).items() if k != "azimuth"}
        if now.get("n_features_in_") != before["n_features_in_"]:
            break  # interrupted after the swap: the new model, as whole as the old one
        assert now.keys() == before.keys()
        assert all(now[k] is before[k] for k in now)
        assert_array_equal(ask(), expected)
        at += 1
    assert at > 11
    refit()
    assert "feature_names_in_" in vars(model)
    assert len(model.feature_names_in_) == model.n_features_in_ != before["n_features_in_"]


def test_interrupted_at_every_stage():
    rng, arm = np.random.default_rng(0), Arm.from_name("aacmm6")
    theta, groups = rng.uniform(-1, 1, (60, 6)), np.repeat(np.arange(6), 10)
    model = ArmResidualRegressor(arm, orders=1, causes=["kinematics"])
    model.fit(theta, rng.normal(0, 0.05, (60, 3)), groups=groups)
    before, expected = dict(vars(model)), model.predict(theta)
    new = np.cos(theta[:, [1, 2, 3]]) * 0.05 + rng.normal(0, 0.002, (60, 3))

    def refit(estimator=model):
        estimator.fit(theta + 0.1, new, groups=groups)

    # Twice: what is computed once and then kept makes the second fit shorter.
    total = min(calls(lambda: refit(clone(model))) for _ in range(2))
    # Every call of the first ones, and an even choice of the others.
    for at in {*range(1, 20), *np.linspace(20, 0.75 * total, 40, dtype=int).tolist()}:
        made = calls(refit, at)
        if made is not None:
            # How many calls there are hangs on what is kept between fits and on the collection of
            # garbage, in which Python also ignores exceptions: that fit came to its end.
            assert at > total // 2 or made >= at, f"call {at} of {total} was never made"
            model.__dict__ = dict(before)
            continue
        assert vars(model).keys() == before.keys()
        assert all(vars(model)[name] is before[name] for name in before)
    assert_array_equal(model.predict(theta), expected)
    refit()
    assert np.abs(model.predict(theta) - expected).max() > 1e-3


def test_a_refused_refit_leaves_the_old_model():
    X = np.zeros((3, 6))
    pose = PoseFeatures(Arm.from_name("aacmm6")).fit(X)
    with pytest.raises(ValueError, match="X has 7 columns"):
        pose.fit(np.zeros((3, 7)))
    assert pose.n_features_in_ == 6
    assert pose.transform(X).shape == (3, 3)
