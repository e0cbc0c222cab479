"""One table of columns: read entry by entry it gives what NumPy computes family by family."""

import re

import numpy as np
import pytest

from sklearn_raacmm import Arm, ArmResidualRegressor
from sklearn_raacmm.error_model import Terms, column_table, term_columns
from sklearn_raacmm.export import export_c

TURN, SHIFT, LOAD = range(3)


def column_by_column(arm, angles, terms):
    """The definition of each entry of the table, on frames as matrices: no shortcut."""
    table = column_table(arm, terms)
    out = np.zeros((len(angles), 3, len(table.kind)))
    for row, frames in enumerate(arm.frames(angles)):
        probe = (frames[-1] @ [*arm.probe, 1.0])[:3]
        places = [*frames[:, :3, 3], probe]
        for c, (kind, frame, axis, unit, of, order) in enumerate(zip(*table, strict=True)):
            u, origin = frames[frame, :3, axis], places[frame]
            value = u if kind == SHIFT else np.cross(u, probe - origin)
            if kind == LOAD:  # the torque of unit weight about u, by the lever and the weight
                value = value * (u @ np.cross(places[of] - origin, [0.0, 0.0, -1.0]))
            if order:
                wave = np.cos if order > 0 else np.sin
                value = value * wave(abs(order) * angles[row, of])
            out[row, :, c] = unit * value
    return out


@pytest.mark.parametrize("name", ["aacmm6", "panda", "ur10"])
@pytest.mark.parametrize("n_orders", [0, 2, 40])  # few and many: two ways of computing
def test_numpy_computes_what_the_table_says(name, n_orders):
    arm = Arm.from_name(name, joint_signs=-1, theta_offset=0.3, probe=(3, -8, 120))
    angles = np.random.default_rng(0).uniform(-4, 4, (3, arm.n_joints))
    pairs = [(j, k) for j in range(arm.n_joints) for k in range(1, n_orders + 1)]
    pairs = np.array(pairs, dtype=int).reshape(-1, 2)
    for harmonics in (pairs, pairs[::-1], pairs[::7]):
        for families in ((True, True, True), (False, True, False), (False, False, False)):
            terms = Terms(harmonics, *families)
            expected = column_by_column(arm, angles, terms)
            got = term_columns(arm, angles, terms)
            np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12)


def test_the_covariance_is_written_as_a_triangle(tmp_path):
    arm = Arm.from_name("aacmm6")
    X = np.random.default_rng(0).uniform(-2, 2, (60, 6))
    model = ArmResidualRegressor(arm, orders=2, causes=["kinematics", "wobble"], fade=0)
    model.fit(X, 0.05 * np.cos(X[:, :3]))
    text = export_c(model, tmp_path / "arm.c", std=True)[0].read_text()
    n = len(model.coef_)
    entries = int(re.search(r"root_\d+\[(\d+)\]", text)[1])
    assert n * (n + 1) / 2 <= entries <= n * (n + 1) / 2 + 4 * n + 64
