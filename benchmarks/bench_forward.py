"""Forward kinematics of one million poses: against its own arithmetic, and against peers.

Prints the time of `Arm.forward` and the ratio to it of

- the sines and cosines alone, which no way of computing can do without;
- one (n, 4, 4) matrix product a joint, the usual NumPy way;
- one call of `Arm.forward` for each pose (timed on fewer rows);
- a loop over pybotics, if it is installed (timed on fewer rows);

and the memory each takes beyond the angles, the result included. Then one pose a call, in medians
of CPU time, `Arm.forward` and Pinocchio by turns, if it is installed (``pip install pin``; its
positions have to be ours): with ``--one-row`` this alone. Run it with
``python benchmarks/bench_forward.py [--rows 300000] [--one-row]``; it takes one thread.
"""

import argparse
import os
import time
import tracemalloc

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

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


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--one-row", action="store_true", help="one pose a call only")
    args = parser.parse_args()
    arm = Arm.from_name("panda", probe=(0, 0, 138))
    if not args.one_row:
        many_rows(arm, args.rows)
    one_row(arm)


def many_rows(arm, n_rows):
    """Time calls with many poses."""
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
    main()
