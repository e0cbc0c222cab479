"""Time of forward kinematics and of `calibrate`, beside what others would write.

    python benchmarks/bench_speed.py forward [--rows 300000] [--one-row]
    python benchmarks/bench_speed.py calibrate

``forward``: `Arm.forward` of a million poses beside the sines and cosines alone, which no way of
computing can do without, and beside one (n, 4, 4) matrix product a joint, the usual NumPy way; then
one pose a call, in medians of CPU time, by turns with Pinocchio, if it is installed (``pip install
pin``; its positions have to be ours).

``calibrate``: beside what a laboratory writes in an afternoon, `scipy.optimize.least_squares` over
the same parameters, with differences for derivatives and the same loss, but no search of priors, no
standard deviations and no outliers. All on one thread.
"""

import argparse
import os
import statistics
import time
import tracemalloc

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from sklearn_raacmm import Arm, calibrate

NOISE_MM = 0.02


def sines_and_cosines(arm, angles):
    """Compute what every way needs, in pieces that stay in the cache."""
    for rows in np.array_split(angles, max(1, len(angles) // 4096)):
        theta = np.ascontiguousarray(rows.T)
        np.sin(theta)
        np.cos(theta)


def matrix_products(arm, angles):
    """Multiply (n, 4, 4) matrices, modified convention."""
    frame = np.broadcast_to(np.eye(4), (len(angles), 4, 4))
    for i in range(arm.n_joints):
        step = np.zeros((len(angles), 4, 4))
        c, s = np.cos(angles[:, i]), np.sin(angles[:, i])
        ca, sa = np.cos(arm.alpha[i]), np.sin(arm.alpha[i])
        step[:, 0, 0], step[:, 0, 1], step[:, 0, 3] = c, -s, arm.a[i]
        step[:, 1, 0], step[:, 1, 1], step[:, 1, 2], step[:, 1, 3] = s * ca, c * ca, -sa, -sa
        step[:, 2, 0], step[:, 2, 1], step[:, 2, 2], step[:, 2, 3] = s * sa, c * sa, ca, ca
        step[:, 1:3, 3] *= arm.d[i]
        step[:, 3, 3] = 1
        frame = frame @ step
    return (frame @ np.append(arm.probe, 1))[:, :3]


def measure(function, arm, angles, repeats=3):
    """Return the best time per row in s and the peak of memory in MB."""
    function(arm, angles[:100])
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function(arm, angles)
        times.append(time.perf_counter() - start)
    tracemalloc.start()
    function(arm, angles)
    peak = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    return min(times) / len(angles), peak


def pinocchio_forward(arm):
    """Return a function from the angles of one pose to Pinocchio's place of the probe."""
    import pinocchio as pin

    model, parent = pin.Model(), 0
    for i in range(arm.n_joints):
        # Modified convention: x before the joint, z after it.
        c, s = np.cos(arm.alpha[i]), np.sin(arm.alpha[i])
        rotation = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        place = pin.SE3(rotation, np.array([arm.a[i], -s * arm.d[i], c * arm.d[i]]))
        parent = model.addJoint(parent, pin.JointModelRZ(), place, f"joint{i}")
    probe = pin.Frame("probe", parent, pin.SE3(np.eye(3), arm.probe), pin.FrameType.OP_FRAME)
    frame, data, offset = model.addFrame(probe), model.createData(), arm.theta_offset

    def forward(q):
        pin.forwardKinematics(model, data, q + offset)
        return pin.updateFramePlacement(model, data, frame).translation

    return forward


def one_row(arm, rounds=60, calls=50):
    """Time calls with one pose, by turns."""
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (1, arm.n_joints))
    functions = {"Arm.forward": lambda: arm.forward(q)}
    try:
        peer = pinocchio_forward(arm)
        assert np.allclose(peer(q[0]), arm.forward(q)[0], atol=1e-9)
        functions["Pinocchio"] = lambda: peer(q[0])
    except ImportError:
        print("pinocchio is not installed: left out")
    functions["one NumPy sine of 7 angles"] = lambda: np.sin(q)
    times = {name: [] for name in functions}
    for _ in range(rounds):
        for name, function in functions.items():
            start = time.process_time()
            for _ in range(calls):
                function()
            times[name].append((time.process_time() - start) / calls)
    print("one pose a call")
    ours = np.array(times["Arm.forward"])
    for name, taken in times.items():
        ratio = np.median(ours / taken)
        print(f"{name:<28}{1e6 * np.median(taken):>8.1f} us, Arm.forward over it {ratio:.1f}")


def many_rows(arm, n_rows):
    """Time calls with many poses: in ns a row, over `Arm.forward`, and the peak of memory."""
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (n_rows, arm.n_joints))
    ways = {
        "Arm.forward": Arm.forward,
        "sines and cosines alone": sines_and_cosines,
        "(n, 4, 4) products": matrix_products,
        "Arm.frames": Arm.frames,
        "Arm.jacobian": Arm.jacobian,
    }
    print(f"{arm!r}, {n_rows} rows\n{'':<28}{'ns / row':>10}{'ratio':>9}{'peak MB':>9}")
    assert np.abs(matrix_products(arm, angles[:100]) - arm.forward(angles[:100])).max() < 1e-9
    reference = None
    for name, function in ways.items():
        seconds, peak = measure(function, arm, angles)
        reference = reference or seconds
        print(f"{name:<28}{1e9 * seconds:>10.0f}{seconds / reference:>9.2f}{peak:>9.0f}")


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


def calibrations(repeats):
    """Time `calibrate` and the fit by hand by turns."""
    arm = Arm.from_name("aacmm6")
    for n, n_groups in ((3000, None), (10_000, 40)):
        angles, points, groups = simulated(arm, n, n_groups)
        seconds = {"calibrate": [], "SciPy by hand": []}
        for _ in range(repeats):
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


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", choices=["forward", "calibrate"])
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--one-row", action="store_true", help="one pose a call only")
    parser.add_argument("--repeats", type=int, default=3, help="of a calibration")
    args = parser.parse_args()
    if args.part == "calibrate":
        return calibrations(args.repeats)
    arm = Arm.from_name("panda", probe=(0, 0, 138))
    if not args.one_row:
        many_rows(arm, args.rows)
    return one_row(arm)


if __name__ == "__main__":
    main()
