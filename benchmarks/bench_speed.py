"""Times that doc/log.md shows: `calibrate`, and one row of a model.

    python benchmarks/bench_speed.py calibrate
    python benchmarks/bench_speed.py python
    python benchmarks/bench_speed.py row              # prints the table
    python benchmarks/bench_speed.py row --write      # and puts it into doc/log.md

``calibrate``: beside what a laboratory writes in an afternoon, `scipy.optimize.least_squares` over
the same parameters, with differences for derivatives and the same loss, but no search of priors, no
standard deviations and no outliers.

``python``: `predict` of one row beside that of scikit-learn's `Ridge`. Nearly all is validation:
what counts is how often it is done.

``row``: a fitted model in C, in ONNX and in Python, and the files' sizes. C is timed in a loop in
C; `load_c`, ONNX and `predict` one row per call from Python. All on one thread. Flash is text and
data of gcc -O2. With ``--data FOLDER``, what the real data are in, a UR10 with a tracker is there,
too: 2000 poses, the default model.
"""

import argparse
import ctypes
import platform
import shutil
import statistics
import subprocess
import tempfile
import time
import warnings
from datetime import date
from functools import partial
from pathlib import Path

import _one_thread  # noqa: F401
import numpy as np
from _arm_folds import read_ur10
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    calibrate,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.export import export_c, load_c, to_onnx

NOISE_MM = 0.02
PAGE = Path(__file__).parents[1] / "doc" / "log.md"
START, END = "<!-- bench_speed row -->", "<!-- end of bench_speed row -->"
LOOP = """
#include "arm.h"
void correct_rows(const double *q, double *out, long n)
{ for (long i = 0; i < n; ++i) arm_correct(q + 6 * i, out + 3 * i); }
void std_rows(const double *q, double *out, long n)
{ double s[3]; for (long i = 0; i < n; ++i) arm_correct_std(q + 6 * i, out + 3 * i, s); }
"""
FLAGS = {"-O2": ["-O2"], "-O3 -march=native": ["-O3", "-march=native"]}


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


def calibrations(repeats=3):
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


def best(function, repeats=5):
    """Return the least CPU time of a call in s."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return min(times)


def models(data):
    """Fitted models by name: networks that all outputs share, and models of the arm."""
    arm = data.arm

    def chain(n_centers):
        return make_pipeline(
            PoseFeatures(arm, joints="all", append_azimuth=True),
            CylindricalResidualTarget(
                make_pipeline(
                    StandardScaler(), RBFNetRegressor(n_centers, shared=True, random_state=0)
                )
            ),
        )

    found = {"network, 60 centres": chain(60), "network, 266 centres": chain(266)}
    for model in found.values():
        model.fit(data.data, data.target)
    found["model of the arm"] = ArmResidualRegressor(arm)
    found["model of the arm"].fit(data.data, data.target, groups=data.groups)
    return found


def of_ur10(data_home):
    """The default model of 2000 poses of a real robot, and the other poses."""
    angles, points, _ = read_ur10("A", data_home)
    rows, rest = np.split(np.random.default_rng(0).permutation(len(angles)), [2000])
    first = calibrate(Arm.from_name("ur10", probe=(0, 0, 93)), angles[rows], points=points[rows])
    model = ArmResidualRegressor(first.arm).fit(angles[rows], first.residuals_mm)
    return model, np.concatenate([angles[rows], angles[rest]])


def one_by_one(call, X, n_rows=200):
    """Return the CPU time of a call of one row in s."""
    return best(lambda: [call(row) for row in X[:n_rows]], 3) / n_rows


def in_c(model, folder, X, expected, fade):
    """Rows of the table for one model in C: name, microseconds, gap."""
    source, _ = export_c(model, folder / "arm.c", std=True, fade=fade)
    (folder / "loop.c").write_text(LOOP)
    out = np.empty((len(X), 3))
    place = ctypes.c_void_p
    for compiler in filter(shutil.which, ("gcc", "clang")):
        for name, flags in FLAGS.items():
            library = folder / f"{compiler}{len(flags)}.so"
            command = [compiler, "-std=c99", *flags, "-shared", "-fPIC", "-o", library]
            subprocess.run([*command, source, folder / "loop.c", "-lm"], check=True)
            loaded = ctypes.CDLL(str(library))
            for what in ("correct", "std"):
                rows = X if what == "correct" else X[: len(X) // 10]
                arguments = (place(rows.ctypes.data), place(out.ctypes.data))
                function = getattr(loaded, f"{what}_rows")
                seconds = best(partial(function, *arguments, ctypes.c_long(len(rows))))
                gap = np.abs(out - expected).max()
                label = f"C, {compiler} {name}" + (", with std" if what == "std" else "")
                yield label, 1e6 * seconds / len(rows), gap


def in_python(model, _, X, expected, fade):
    """The same for ways that are called from Python, one row per call."""
    compiled = load_c(model, fade=fade)
    gap = np.abs(compiled.predict(X) - expected).max()
    yield "`load_c`, one row per call", 1e6 * one_by_one(compiled.predict, X), gap
    yield "`load_c`, one batch", 1e6 * best(lambda: compiled.predict(X)) / len(X), gap
    try:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        converted = to_onnx(model, fade=fade).SerializeToString()
        session = onnxruntime.InferenceSession(
            converted, options, providers=["CPUExecutionProvider"]
        )
    except ImportError:
        pass
    else:
        gap = np.abs(session.run(None, {"X": X})[0] - expected).max()
        seconds = one_by_one(lambda row: session.run(None, {"X": row[None]}), X)
        yield "ONNX, one row per call", 1e6 * seconds, gap
    yield (
        "`predict`, one row per call",
        1e6 * one_by_one(lambda row: model.predict(row[None]), X),
        0,
    )
    yield "`predict`, one batch", 1e6 * best(lambda: model.predict(X), 3) / len(X), 0


def _digits(microseconds):
    """Two digits, without an exponent."""
    return f"{microseconds:.{0 if microseconds >= 10 else 1}f}"


def flash_kb(source):
    """Text and data of the compiled file, kB: what a controller keeps of it."""
    if not all(map(shutil.which, ("gcc", "size"))):
        return "-"
    compiled = source.with_suffix(".o")
    command = ["gcc", "-std=c99", "-O2", "-c", source, "-o", compiled]
    subprocess.run(command, check=True)
    printed = subprocess.run(["size", compiled], check=True, capture_output=True, text=True).stdout
    return f"{sum(map(int, printed.splitlines()[1].split()[:2])) / 1e3:.0f}"


def table(n_rows, data_home):
    """Lines of Markdown."""
    data = make_single_point(n_positions=12, n_poses=40, random_state=0)
    columns = {
        f"{name}{', fade exact' if fade == 'exact' else ''}": (model, data.data, fade)
        for name, model in models(data).items()
        for fade in (["small", "exact"] if isinstance(model, ArmResidualRegressor) else ["small"])
    }
    if data_home:
        model, poses = of_ur10(data_home)
        for fade in ("small", "exact"):
            columns[f"UR10, fade {fade}"] = model, poses, fade
    found, sizes, gaps = {}, {}, {}
    for name, (model, poses, fade) in columns.items():
        # Poses that the models know: C takes longer where corrections fade.
        X = poses[np.random.default_rng(0).integers(len(poses), size=n_rows)]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            expected = model.predict(X)
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            for way in (in_c, in_python):
                for label, microseconds, gap in way(model, folder, X, expected, fade):
                    found.setdefault(label, {})[name] = _digits(microseconds)
                    gaps[name] = max(gaps.get(name, 0.0), gap)
            for label, std in (("", False), (" with std", True)):
                source, _ = export_c(model, folder / "arm.c", std=std, fade=fade)
                kb = f"{source.stat().st_size / 1e3:.0f}"
                sizes.setdefault(f"C source{label}, kB", {})[name] = kb
                sizes.setdefault(f"flash{label}, kB", {})[name] = flash_kb(source)
        label = "largest distance to `predict`, mm"
        sizes.setdefault(label, {})[name] = f"{gaps[name]:.0e}"
    head = [f"| µs per row | {' | '.join(columns)} |", f"|---{'|---' * len(columns)}|"]
    body = [
        f"| {label} | {' | '.join(cells.get(name, '-') for name in columns)} |"
        for label, cells in {**found, **sizes}.items()
    ]
    note = f"{platform.machine()}, one core, {n_rows} rows, {date.today().isoformat()}."
    return [*head, *body, "", note]


def python(rounds=60, calls=20):
    """Time `predict` of one row against that of a bare Ridge, by turns."""
    data = make_single_point(n_positions=12, n_poses=30, random_state=0)
    X, y, arm = data.data, data.target, data.arm
    network = RBFNetRegressor(60, random_state=0)
    inner = make_pipeline(StandardScaler(), network)
    models = {
        "Ridge": Ridge(),
        "RBFNetRegressor": network,
        "chain, pipeline": make_pipeline(
            PoseFeatures(arm, append_azimuth=True), CylindricalResidualTarget(inner)
        ),
        "ArmResidualRegressor": ArmResidualRegressor(arm, orders=8),
    }
    times = {name: [] for name in models}
    for model in models.values():
        model.fit(X, y)
    row = X[:1].copy()
    for _ in range(rounds):
        for name, model in models.items():
            start = time.process_time()
            for _ in range(calls):
                model.predict(row)
            times[name].append((time.process_time() - start) / calls)
    medians = {name: np.median(values) for name, values in times.items()}
    print(f"{'one row, 60 centres':<36}{'CPU us':>8}{'ratio':>8}")
    for name, seconds in medians.items():
        print(f"{name:<36}{1e6 * seconds:>8.0f}{seconds / medians['Ridge']:>8.2f}")


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", choices=["calibrate", "python", "row"])
    parser.add_argument("--rows", type=int, default=20_000, help="of a model")
    parser.add_argument("--data", help="folder of the real data")
    parser.add_argument("--write", action="store_true", help="the table of rows into doc/log.md")
    args = parser.parse_args(argv)
    if args.part != "row":
        return (calibrations if args.part == "calibrate" else python)()
    lines = table(args.rows, args.data)
    print("\n".join(lines))
    if args.write:
        text = PAGE.read_text(encoding="utf-8")
        before, rest = text.split(START)
        after = rest.split(END)[1]
        PAGE.write_text(f"{before}{START}\n\n" + "\n".join(lines) + f"\n\n{END}{after}", "utf-8")


if __name__ == "__main__":
    main()
