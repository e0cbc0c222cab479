"""A refit that is interrupted anywhere leaves the old model whole."""

import sys

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from sklearn.base import clone
from sklearn.kernel_ridge import KernelRidge
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import Arm, ArmResidualRegressor, PoseFeatures

ARM = Arm.from_name("aacmm6")


class InterruptError(Exception):
    """Stands for Ctrl-C, at a call of our choice."""


class Interrupt:
    """Raise at the n-th call of a function of the package; count the calls."""

    def __init__(self, at):
        self.at, self.count = at, 0

    def __call__(self, frame, event, arg):
        if event == "call" and "sklearn_raacmm" in frame.f_code.co_filename:
            self.count += 1
            if self.count == self.at:
                raise InterruptError


def calls(fit, at):
    """Number of calls of a fit, interrupted at one of them; 0 for a fit that came to its end."""
    tracer = Interrupt(at)
    sys.setprofile(tracer)
    try:
        fit()
    except InterruptError:
        return 0
    finally:
        sys.setprofile(None)
    return tracer.count


# What is raised in a generator that nobody looks at any more can be told to nobody.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("second_stage", [False, True])
def test_interrupted_at_every_stage(second_stage):
    rng = np.random.default_rng(0)
    theta = rng.uniform(-1, 1, (60, 6))
    groups = np.repeat(np.arange(6), 10)
    model = ArmResidualRegressor(ARM, orders=1, causes=["kinematics"])
    if second_stage:
        model.set_params(regressor=make_pipeline(PoseFeatures(ARM), KernelRidge(kernel="rbf")))
    model.fit(theta, rng.normal(0, 0.05, (60, 3)), groups=groups)
    before, expected = dict(vars(model)), model.predict(theta)
    new = np.cos(theta[:, [1, 2, 3]]) * 0.05 + rng.normal(0, 0.002, (60, 3))

    def refit(estimator=model):
        estimator.fit(theta + 0.1, new, groups=groups)

    # Twice: what is computed once and then kept makes the second fit shorter.
    total = min(
        calls(lambda: clone(model).fit(theta + 0.1, new, groups=groups), -1) for _ in range(2)
    )
    # Every call of the first ones, and an even choice of the others.
    for at in {*range(1, 20), *np.linspace(20, 0.75 * total, 40, dtype=int).tolist()}:
        made = calls(refit, at)
        if made:
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
