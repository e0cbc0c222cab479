"""Forward kinematics of one million poses: against its own arithmetic, and against peers.

Prints the time of `Arm.forward` and the ratio to it of

- the sines and cosines alone, which no way of computing can do without;
- one (n, 4, 4) matrix product a joint, the usual NumPy way;
- one call of `Arm.forward` for each pose (timed on fewer rows);
- a loop over pybotics, if it is installed (timed on fewer rows);

and the memory each takes beyond the angles, the result included. Run it with
``OPENBLAS_NUM_THREADS=1 python benchmarks/bench_forward.py [n_rows]``.
"""

import sys
import time
import tracemalloc

import numpy as np

from sklearn_raacmm import Arm


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


def one_by_one(arm, angles):
    """Call `Arm.forward` once a pose."""
    return np.concatenate([arm.forward(q[None]) for q in angles])


def pybotics_loop(arm, angles):
    """Call pybotics once a pose."""
    from pybotics.robot import Robot
    from pybotics.tool import Tool

    robot = Robot.from_parameters(np.column_stack([arm.alpha, arm.a, arm.theta_offset, arm.d]))
    robot.tool = Tool()
    robot.tool.position = arm.probe
    return np.array([robot.fk(q)[:3, 3] for q in angles])


def measure(function, arm, angles, repeats=3):
    """Return the best time per row in s, the peak of memory in MB, and the result."""
    function(arm, angles[:100])
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = function(arm, angles)
        times.append(time.perf_counter() - start)
    tracemalloc.start()
    function(arm, angles)
    peak = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    return min(times) / len(angles), peak, result


def main(n_rows=1_000_000):
    arm = Arm.from_name("panda", probe=(0, 0, 138))
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (n_rows, arm.n_joints))
    few = angles[:2000]
    runs = [
        ("Arm.forward", Arm.forward, angles),
        ("sines and cosines alone", sines_and_cosines, angles),
        ("(n, 4, 4) products", matrix_products, angles),
        ("Arm.frames", Arm.frames, angles),
        ("Arm.jacobian", Arm.jacobian, angles),
        ("Arm.forward, a call each", one_by_one, few),
    ]
    try:
        import pybotics  # noqa: F401

        runs.append(("pybotics, one call a pose", pybotics_loop, few))
    except ImportError:
        print("pybotics is not installed: left out")
    print(f"{arm!r}, {n_rows} rows")
    print(f"{'':<28}{'ns / row':>10}{'ratio':>9}{'peak MB':>9}{'largest gap mm':>16}")
    reference = None
    expected = arm.forward(angles)
    for name, function, rows in runs:
        seconds, peak, result = measure(function, arm, rows)
        reference = reference or seconds
        gap = ""
        if isinstance(result, np.ndarray) and result.shape == (len(rows), 3):
            gap = f"{np.abs(result - expected[: len(rows)]).max():.1e}"
        print(f"{name:<28}{1e9 * seconds:>10.0f}{seconds / reference:>9.2f}{peak:>9.0f}{gap:>16}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
