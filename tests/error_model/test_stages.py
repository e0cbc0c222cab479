"""A fault is seen in the log at DEBUG where it is: no stage before it differs."""

import logging

import pytest

from sklearn_raacmm import ArmResidualRegressor
from sklearn_raacmm.datasets import ArmErrors, make_single_point
from sklearn_raacmm.error_model import _fit, _left_out, _sums

TEST = make_single_point(6, 20, machine=ArmErrors(slip_share=0.05, slip_mm=1.0), random_state=0)
# Module, name and wrong value, and how the first line ends that differs. Of a stage with parts that
# line may be of the first part after the fault.
FAULTS = [
    (_fit, "_PRICE_PER_LOG_ORDER", 9.0, "candidate_sums, within choice of structures"),
    (_sums, "_COUNTS", 30.0, "_sums.joint_noise, within linear error model"),
    (_fit, "_SHARE_OF_NOISE", 0.5, "_fit.Fit.__init__"),
    (_left_out, "N_BLOCKS", 3, "candidate_sums, within models without one block each"),
    (_left_out, "_LOG_SPREAD", 5.0, "_left_out.interval_scales"),
]


def lines(caplog):
    caplog.clear()
    with caplog.at_level(logging.DEBUG, logger="sklearn_raacmm"):
        ArmResidualRegressor(TEST.arm, orders=6).fit(TEST.data, TEST.target, groups=TEST.groups)
    return [r.getMessage() for r in caplog.records if r.levelno == logging.DEBUG]


@pytest.fixture(scope="module")
def right():
    return []


@pytest.mark.parametrize(("module", "name", "wrong", "where"), FAULTS)
def test_the_first_stage_that_differs_is_that_of_the_fault(
    module, name, wrong, where, right, caplog, monkeypatch
):
    right[:] = right or lines(caplog)
    monkeypatch.setattr(module, name, wrong)
    pairs = zip(lines(caplog), right, strict=False)
    assert next(one for one, other in pairs if one != other).endswith(where)
