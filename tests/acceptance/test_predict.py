"""Predictions of runs: drawn anew by hand, and simulated runs against what is stated of them."""

import numpy as np
import pytest

from sklearn_raacmm.acceptance import evaluate_acceptance, predict_acceptance
from sklearn_raacmm.datasets import ArmErrors, make_acceptance


class White:
    """A model that knows nothing but white noise, as sample_y and predict have it."""

    def __init__(self, arm, sd):
        self.arm_, self.sd = arm, sd

    def predict(self, X):
        return np.zeros((len(X), 3))

    def sample_y(self, X, n, random_state, *, with_noise):
        assert with_noise
        return self.sd * random_state.normal(size=(len(X), 3, n))


def test_white_noise_has_the_values_of_white_noise(data):
    sd = 0.02
    whole = predict_acceptance(White(data.arm, sd), data.run, n_draws=3)
    assert set(whole) == {value.name for value in evaluate_acceptance(data.run, data.arm).values}
    data = make_acceptance(["single-point", "volumetric"], random_state=1)
    found = predict_acceptance(White(data.arm, sd), data.run, n_draws=300)
    rng = np.random.default_rng(0)
    cone = sd * rng.normal(size=(2000, 10, 3))
    cone -= cone.mean(axis=1, keepdims=True)
    far = np.linalg.norm(cone, axis=2)
    bars = sd * np.sqrt(2) * rng.normal(size=(2000, 20))
    bars += data.run.by_name["bar 500"].u_size * rng.normal(size=(2000, 1))
    expected = {
        "2S near": 2 * np.sqrt(np.sum(far**2, axis=1) / 9),
        "largest far": far.max(axis=1),
        "volumetric largest": np.abs(bars).max(axis=1),
        "volumetric range": np.ptp(bars, axis=1),
        "volumetric 2 rms": 2 * np.sqrt(np.mean(bars**2, axis=1)),
    }
    for name, values in expected.items():
        ends = np.quantile(values, [0.025, 0.5, 0.975])
        np.testing.assert_allclose(found[name], ends, rtol=0.12, err_msg=name)
    again = predict_acceptance(White(data.arm, sd), data.run, n_draws=20, random_state=5)
    assert again == predict_acceptance(White(data.arm, sd), data.run, n_draws=20, random_state=5)


@pytest.mark.exhaustive
def test_a_perfect_arm_has_the_values_of_the_artefacts_errors():
    perfect = make_acceptance(machine=ArmErrors.only(), exact=True, random_state=2)
    for value in evaluate_acceptance(perfect.run, perfect.simulation.machine.true_arm).values:
        assert abs(value.before) < 1e-6, value.name
    machine, tests = perfect.simulation.machine, ["probing", "single-point", "volumetric"]
    found = [
        evaluate_acceptance(data.run, data.simulation.machine.true_arm)
        for data in (
            make_acceptance(tests, machine=machine, random_state=seed) for seed in range(20)
        )
    ]
    for name in ("P_Size", "volumetric largest"):
        errors = [result[name].before / result[name].u_before for result in found]
        # Of a value the worst of several candidates: not much beyond what is stated.
        assert 0.4 < np.sqrt(np.mean(np.square(errors))) < 2.5, name
    assert max(result["P_Form"].before for result in found) < 0.0021
    assert max(result["2S far"].before for result in found) < 1e-6


def test_runs_of_one_seed_are_of_one_arm_and_artefacts_do_not_move_the_noise():
    one, two = (make_acceptance(["volumetric"], exact=exact, random_state=1) for exact in (0, 1))
    assert one.arm == two.arm
    off = one.simulation.true_points - two.simulation.true_points
    assert 1e-4 < np.abs(off).max() < 0.03
    other = make_acceptance(["volumetric"])
    assert np.abs(other.run.angles - one.run.angles).max() > 0.1
    with pytest.raises(ValueError, match="tests names 'pose'; known are probing"):
        make_acceptance(["pose"])
