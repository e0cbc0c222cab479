"""Time of `calibrate` beside a least-squares fit written by hand with SciPy.

The peer is what a laboratory writes in an afternoon: `scipy.optimize.least_squares` over the same
parameters, with differences for derivatives and the same loss, but no search of priors, no
standard deviations and no outliers.

Run it with ``python benchmarks/bench_calibrate.py`` (a minute).
"""

import argparse
import os
import statistics
import time

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from sklearn_raacmm import Arm, calibrate

NOISE_MM = 0.02


def simulated(arm, n, n_groups, seed=0):
    """Angles, and points of a tracker or labels of sockets, of an arm that is not the nominal."""
    rng = np.random.default_rng(seed)
    true = arm.replace(
        a=arm.a + rng.normal(0, 0.2, arm.n_joints), d=arm.d + rng.normal(0, 0.2, arm.n_joints)
    )
    angles = rng.uniform(-2, 2, (n, arm.n_joints))
    if n_groups is None:
        points = true.forward(angles)[:, [1, 2, 0]] + [1000, 0, 0]
        return angles, points + rng.normal(0, NOISE_MM, points.shape), None
    # A socket for every group: the poses are drawn to it by the first three joints.
    sockets = true.forward(rng.uniform(-1, 1, (n_groups, arm.n_joints)))
    groups = np.arange(n) % n_groups
    angles = angles * 0.3 + rng.uniform(-1, 1, (n_groups, arm.n_joints))[groups]
    for _ in range(30):
        missing = sockets[groups] - true.forward(angles)
        jacobian = true.jacobian(angles)
        normal = jacobian @ jacobian.swapaxes(1, 2) + 100 * np.eye(3)
        step = jacobian.swapaxes(1, 2) @ np.linalg.solve(normal, missing[..., None])
        angles = angles + np.clip(step[..., 0], -0.3, 0.3)
    met = np.linalg.norm(sockets[groups] - true.forward(angles), axis=1) < 0.01
    angles, groups = angles[met], groups[met]
    jacobian = true.jacobian(angles)
    noise = rng.normal(0, NOISE_MM, (len(angles), 3, 1))
    return angles + (np.linalg.pinv(jacobian) @ noise)[..., 0], None, groups


def by_hand(arm, angles, points, groups):
    """The same fit by SciPy with differences."""
    n = arm.n_joints
    start = np.concatenate([arm.a, arm.alpha, arm.d, arm.theta_offset, arm.probe])
    size = np.r_[np.tile(np.repeat([0.3, 0.003], n), 2), np.full(3, 1000.0)]
    rotation, shift = np.eye(3), np.zeros(3)
    if points is not None:
        a, b = arm.forward(angles), points
        u, _, vt = np.linalg.svd((b - b.mean(0)).T @ (a - a.mean(0)))
        rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
        shift = b.mean(0) - a.mean(0) @ rotation.T

    def residuals(z):
        x = start + size * z[: len(start)]
        fields = [x[i * n : (i + 1) * n] for i in range(4)]
        own = arm.replace(**dict(zip(("a", "alpha", "d", "theta_offset"), fields, strict=True)))
        p = own.replace(probe=x[4 * n : 4 * n + 3]).forward(angles)
        if points is None:
            mean = np.stack([np.bincount(groups, p[:, i]) for i in range(3)], axis=1)
            left = p - (mean / np.bincount(groups)[:, None])[groups]
        else:
            turn = Rotation.from_rotvec(z[-6:-3]).as_matrix() @ rotation
            left = p @ turn.T + shift + z[-3:] - points
        return np.concatenate([left.ravel() / NOISE_MM, z[: len(start)]])

    z = np.zeros(len(start) + (0 if points is None else 6))
    return least_squares(residuals, z, loss="soft_l1", x_scale="jac").cost


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    arm = Arm.from_name("aacmm6")
    for n, n_groups in ((3000, None), (10_000, 40)):
        angles, points, groups = simulated(arm, n, n_groups)
        seconds = {"calibrate": [], "SciPy by hand": []}
        for _ in range(options.repeats):
            start = time.process_time()
            calibrate(arm, angles, groups, points=points)
            seconds["calibrate"].append(time.process_time() - start)
            start = time.process_time()
            by_hand(arm, angles, points, groups)
            seconds["SciPy by hand"].append(time.process_time() - start)
        kind = "tracker" if points is not None else "single-point"
        times = ", ".join(f"{name} {statistics.median(s):.2f} s" for name, s in seconds.items())
        ours, by_scipy = seconds.values()
        ratio = statistics.median(b / a for a, b in zip(ours, by_scipy, strict=True))
        print(f"{len(angles)} {kind} poses: {times} of CPU time, 1 thread; ratio {ratio:.1f}")


if __name__ == "__main__":
    main()
