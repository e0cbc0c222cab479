"""Random chains of every kind: each way out of Python gives what predict gives."""

import subprocess

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
)
from sklearn_raacmm.export import export_c
from sklearn_raacmm.network import KERNELS

from ._chains import COMPILERS, ways_out

SANITIZE = ["-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
MAIN = """
#include "arm.h"
static const double rows[%(n)d][%(d)d] = {%(rows)s};
int main(void)
{
    double mean[3], other[3];
    for (int i = 0; i < %(n)d; ++i) {
        arm_correct_std(rows[i], mean, other);
        arm_point(rows[i], other);
    }
    return 0;
}
"""


def random_model(rng):
    """A chain of random parts, fitted on random poses; rows; whether it has a deviation."""
    name = str(rng.choice(["aacmm6", "panda", "ur10"]))
    arm = Arm.from_name(name, joint_signs=int(rng.choice([-1, 1])), theta_offset=0.2)
    n = int(rng.integers(30, 60))
    X = rng.uniform(-2, 2, (n, arm.n_joints))
    y = 0.05 * np.cos(X[:, :3]) + 0.002 * rng.normal(size=(n, 3))
    unit = str(rng.choice(["rad", "deg"]))
    network = RBFNetRegressor(
        int(rng.integers(1, 20)), kernel=str(rng.choice(list(KERNELS))), length_scale=2.0,
        alpha=0.1, degree=int(rng.integers(-1, 2)), shared=bool(rng.integers(2)),
    )  # fmt: skip
    which = rng.integers(4)
    scaler = StandardScaler(with_mean=which != 1, with_std=which != 2)
    last = [network, network, LinearRegression(), Ridge()][rng.integers(4)]
    pose = {"joints": str(rng.choice(["pose", "all"]))}
    pose["encoding"] = str(rng.choice(["angle", "periodic"]))
    kind, std = rng.integers(6), last is network
    if kind <= 1:
        causes = [c for c in ("gravity", "kinematics", "wobble") if rng.random() < 0.6]
        extra = ["temperature", "force y", "direction 2"] if rng.random() < 0.5 else []
        if extra:
            X = np.column_stack([X, rng.normal(size=(n, 2)), rng.choice([-1.0, 1.0], n)])
        fade = [0.0, 0.7, "auto"][rng.integers(3)]
        model = ArmResidualRegressor(
            arm, orders=int(rng.integers(0 if causes else 1, 4)), causes=causes, extra=extra,
            fade=fade, angle_unit=unit,
        )  # fmt: skip
        std = True
    elif kind == 2:
        inner, unit = make_pipeline(PoseFeatures(arm, **pose), scaler, last), "rad"
        model = CylindricalResidualTarget(inner, azimuth=arm.azimuth)
    elif kind == 3:
        model = make_pipeline(
            PoseFeatures(arm, append_azimuth=True, angle_unit=unit, **pose),
            CylindricalResidualTarget(make_pipeline(scaler, last)),
        )
    elif kind == 4:
        model, unit = make_pipeline(scaler, last), "rad"
    else:  # a direction that is given
        turns = rng.uniform(-3, 3, n)
        X = np.column_stack([X, np.cos(turns), np.sin(turns)])
        model, unit = CylindricalResidualTarget(last), "rad"
    far = rng.uniform(-6, 6, (20, X.shape[1]))
    far[:, arm.n_joints :] = X[:20, arm.n_joints :]  # a direction that can be
    new = np.concatenate([X[:10], far])
    if unit == "deg":
        for rows in (X, new):
            rows[:, : arm.n_joints] = np.rad2deg(rows[:, : arm.n_joints])
    if kind == 4 and rng.integers(2):
        y = y[:, 0]
    return model.fit(X, y), new, bool(std)


@pytest.mark.filterwarnings("ignore::UserWarning")  # poses far from the training ones
@pytest.mark.parametrize(
    "seed", [*range(6), *(pytest.param(i, marks=pytest.mark.exhaustive) for i in range(6, 60))]
)
def test_every_way_gives_what_predict_gives(tmp_path, seed):
    model, X, std = random_model(np.random.default_rng(seed))
    mean = model.predict(X)
    deviation = model.predict(X, return_std=True)[1] if std else None
    size = np.abs(mean).max()  # far from the poses columns grow to metres per radian
    for way, got, spread in ways_out(tmp_path, model, X, std):
        got = got.reshape(mean.shape)
        np.testing.assert_allclose(got, mean, rtol=0, atol=1e-12 * max(1, 10 * size), err_msg=way)
        if std:
            spread = spread.reshape(deviation.shape)
            np.testing.assert_allclose(spread, deviation, rtol=1e-6, atol=1e-12, err_msg=way)


@pytest.mark.exhaustive
@pytest.mark.filterwarnings("ignore::UserWarning")  # poses far from the training ones
@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("fade", ["exact", "small"])
@pytest.mark.parametrize("seed", [4])  # of an arm
def test_sanitizers(tmp_path, compiler, seed, fade):
    model, X, _ = random_model(np.random.default_rng(seed))
    assert isinstance(model, ArmResidualRegressor)
    source, _ = export_c(model, tmp_path / "arm.c", std=True, fade=fade)
    rows = ", ".join(map(float.hex, X.ravel().tolist()))
    main = MAIN % {"n": len(X), "d": X.shape[1], "rows": rows}
    (tmp_path / "main.c").write_text(main)
    program = tmp_path / "main"
    command = [compiler, "-std=c99", *SANITIZE, "-o", program, tmp_path / "main.c", source, "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if "cannot find" in done.stderr:
        pytest.skip("the sanitizers' libraries are not installed")
    assert done.returncode == 0, done.stderr
    subprocess.run([program], check=True)
