"""Random chains under the address and undefined-behaviour sanitizers, against predict."""

import shutil
import subprocess

import numpy as np
import pytest
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import MaxAbsScaler, MinMaxScaler, RobustScaler, StandardScaler

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    JointHarmonicRegressor,
    PoseFeatures,
    RBFNetRegressor,
)
from sklearn_raacmm.export import export_c
from sklearn_raacmm.network import KERNELS

COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
SANITIZE = ["-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
N_CHAINS = 240
MAIN = """
#include "arm.h"
#include <stdio.h>
#include <stdlib.h>
int main(void)
{
    /* From the heap: every byte beyond the ends is watched. */
    double *rows = malloc(sizeof(double) * %(n)d * %(d)d);
    double *out = malloc(sizeof(double) * %(n)d * 3);
    for (int i = 0; i < %(n)d * %(d)d; ++i)
        if (scanf("%%lf", rows + i) != 1)
            return 2;
    arm_correct_n(rows, out, %(n)d);
    for (int i = 0; i < %(n)d; ++i) {
        double *mean = malloc(3 * sizeof *mean), *other = malloc(3 * sizeof *other);
        arm_point(rows + %(d)d * i, other);
        arm_correct_std(rows + %(d)d * i, mean, other);
        for (int k = 0; k < 3; ++k)
            printf("%%.17g %%.17g\\n", mean[k], other[k]);
        free(mean);
        free(other);
    }
    free(rows);
    free(out);
    return 0;
}
"""


def random_model(rng):
    """A chain of random parts, fitted on random poses."""
    name = rng.choice(["aacmm6", "panda", "ur10"])
    arm = Arm.from_name(name, joint_signs=int(rng.choice([-1, 1])), theta_offset=0.2)
    X = rng.uniform(-2, 2, (int(rng.integers(30, 60)), arm.n_joints))
    y = 0.05 * np.cos(X[:, :3]) + 0.002 * rng.normal(size=(len(X), 3))
    kind = rng.integers(4)
    degree = int(rng.integers(-1, 2))
    network = RBFNetRegressor(
        int(rng.integers(1, 20)),
        kernel=str(rng.choice(list(KERNELS))),
        length_scale=2.0,
        alpha=0.1,
        degree=degree,
    )
    if kind == 0:
        params = dict(zip(("gravity", "kinematics", "wobble"), rng.random(3) < 0.6, strict=True))
        params = {key: bool(value) for key, value in params.items()}
        if rng.random() < 0.5:
            params["extra"] = ["temperature", "force y", "tool"]
            X = np.column_stack([X, rng.normal(size=(len(X), 2)), rng.integers(1, 3, len(X))])
        model = JointHarmonicRegressor(arm, max_order=int(rng.integers(1, 4)), **params)
    elif kind == 1:
        linear = JointHarmonicRegressor(arm, max_order=2, gravity=False)
        model = ArmResidualRegressor(
            arm,
            harmonics=linear,
            network=network.set_params(degree=-1),
            joints=str(rng.choice(["pose", "all"])),
            use=str(rng.choice(["none", "harmonics", "harmonics+network"])),
            fade=float(rng.choice([0.0, 1.0])),
        )
    else:
        scalers = [StandardScaler(), MinMaxScaler(clip=True), RobustScaler(), MaxAbsScaler()]
        scaler = scalers[rng.integers(4)]
        pose = {"joints": str(rng.choice(["pose", "all"]))}
        pose["encoding"] = str(rng.choice(["angle", "periodic"]))
        if kind == 2:
            inner = make_pipeline(PoseFeatures(arm, **pose), scaler, network)
            model = CylindricalResidualTarget(inner, azimuth=arm.azimuth)
        else:
            model = make_pipeline(
                PoseFeatures(arm, append_azimuth=True, **pose),
                CylindricalResidualTarget(make_pipeline(scaler, network)),
            )
    new = rng.uniform(-6, 6, (20, X.shape[1]))
    new[:, arm.n_joints + 2 :] = X[:20, arm.n_joints + 2 :]  # a tool that the model knows
    return model.fit(X, y), np.concatenate([X[:10], new])


@pytest.mark.exhaustive
@pytest.mark.filterwarnings("ignore::UserWarning")  # poses far from the training ones
@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("seed", range(N_CHAINS))
def test_random_chains(tmp_path, compiler, seed):
    model, X = random_model(np.random.default_rng(seed))
    source, _ = export_c(model, tmp_path / "arm.c", std=True)
    (tmp_path / "main.c").write_text(MAIN % {"n": len(X) + 1, "d": X.shape[1]})
    program = tmp_path / "main"
    command = [compiler, "-std=c99", *SANITIZE, "-o", program, tmp_path / "main.c", source, "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if "cannot find" in done.stderr:
        pytest.skip("the sanitizers' libraries are not installed")
    assert done.returncode == 0, done.stderr
    rows = np.concatenate([X, np.full((1, X.shape[1]), np.nan)])
    given = " ".join(map(repr, rows.ravel().tolist()))
    done = subprocess.run([program], input=given, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    got = np.array(done.stdout.split(), dtype=float).reshape(-1, 3, 2)
    mean, std = model.predict(X, return_std=True)
    # Coefficients may nearly cancel far from the poses.
    np.testing.assert_allclose(got[:-1, :, 0], mean, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(got[:-1, :, 1], std, rtol=1e-3, atol=1e-10)
    assert np.isnan(got[-1]).all()
