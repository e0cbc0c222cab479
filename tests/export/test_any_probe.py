"""C that takes the probe as an argument: the moved model, whatever the probe."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import Arm, ArmResidualRegressor, RBFNetRegressor
from sklearn_raacmm.export import export_c
from sklearn_raacmm.export._models import program_of
from sklearn_raacmm.export._program import run

ARM = Arm.from_name("aacmm6")


def fitted(groups=None, **params):
    rng = np.random.default_rng(0)
    angles = rng.uniform(-2, 2, (200, 6))
    X = np.column_stack([angles, *[rng.normal(size=200) for _ in params.get("extra", ())]])
    y = np.einsum("nij,nj->ni", ARM.jacobian(angles), 1e-4 * np.cos(angles))
    y += rng.normal(0, 0.005, y.shape)
    return ArmResidualRegressor(ARM, orders=5, **params).fit(X, y, groups=groups)


@pytest.mark.parametrize("params", [
    {}, {"offsets": True}, {"extra": ["payload", "direction 2"]}, {"causes": []},
])  # fmt: skip
def test_the_program_is_the_moved_model(params):
    """Answers of the program against `with_arm`, row by row; also of a probe that is shorter."""
    model = fitted(np.repeat(np.arange(10), 20) if "offsets" in params else None, **params)
    rng = np.random.default_rng(1)
    program = program_of(model, std=True, any_probe=True)
    for probe in ((0, 0, 400), (30, -20, 60), tuple(ARM.probe)):
        X = rng.uniform(-3, 3, (20, 6 + len(params.get("extra", ()))))
        found = run(program, np.column_stack([X, np.tile(probe, (20, 1))]))
        moved = model.with_arm(ARM.replace(probe=probe))
        mean, std = moved.predict(X, return_std=True)
        assert_allclose(found["y"], mean, atol=1e-9)
        assert_allclose(found["std"], std, rtol=1e-6)
        assert_allclose(found["point"], moved.correct(X), atol=1e-9)


def test_c_takes_it_and_proves_itself(tmp_path):
    _, header = export_c(fitted(), tmp_path / "arm.c", std=True, any_probe=True, poses="random")
    text = header.read_text()
    assert "#define ARM_N_INPUTS 9" in text
    assert "probe x in mm, probe y in mm, probe z in mm" in text
    assert (tmp_path / "arm_test.c").exists()


def test_what_knows_one_probe_only_is_refused(tmp_path):
    warm = fitted(extra=["temperature"])
    with pytest.raises(ValueError, match="does not go with temperatures"):
        export_c(warm, tmp_path / "arm.c", any_probe=True)
    X = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    with pytest.raises(ValueError, match="needs an ArmResidualRegressor"):
        export_c(RBFNetRegressor(4).fit(X, X), tmp_path / "net.c", any_probe=True)
