"""Times that doc/log.md shows: of fits, of `calibrate`, and of one row of a model.

    python benchmarks/bench_speed.py fit --problem fourier3 --rows 300
    python benchmarks/bench_speed.py row --write    # puts the table into doc/log.md

Everything runs on one thread, what is compared by turns; printed are medians of the CPU time.
``fit``: beside a network an exact Gaussian process written by hand as well as one can with SciPy.
"waves" ask for centres by the thousand. On an "arm", a single-point test, `ArmResidualRegressor` is
compared with the same model of low orders only. ``calibrate``: beside what a laboratory writes in
an afternoon, `scipy.optimize.least_squares` over the same parameters, without priors, standard
deviations and outliers. ``python``: `predict` of one row beside that of scikit-learn's `Ridge`.
``price``: fits of a UR10 with a tracker and its goals as groups, and `learn_correction`, over the
time of a product of two 1500 x 1500 matrices just before; with what the fits leave at other poses.
``row``: a fitted model in C (timed in a loop in C), in ONNX and in Python, and the files' sizes;
with ``--data FOLDER``, what the real data are in, a UR10 with a tracker is there, too.
"""

import argparse
import contextlib
import ctypes
import platform
import shutil
import subprocess
import tempfile
import time
import warnings
from datetime import date
from functools import partial
from pathlib import Path

import _one_thread  # noqa: F401
import numpy as np
from _arm_folds import DATA, UR10, learn_tracked, mean_deviation, read_ur10
from _problems import GENERATED, Problem, generated, waves
from scipy.linalg import lapack
from scipy.optimize import least_squares, minimize
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
    learn_correction,
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


def by_turns(rounds, calls, calls_each=1):
    """Medians of the CPU time of each function, and of the ratios of the last to the first."""
    times = np.empty((rounds, len(calls)))
    for row in times:
        for i, call in enumerate(calls):
            start = time.process_time()
            for _ in range(calls_each):
                call()
            row[i] = (time.process_time() - start) / calls_each
    return np.median(times, axis=0), np.median(times[:, -1] / times[:, 0])


class ExactProcess:
    """A Gaussian process by maximum likelihood; the signal's variance is at its optimum.

    Gaussian kernel, a width for each feature, analytic gradient, one start of L-BFGS.
    """

    def fit(self, X, y):
        """Maximise the likelihood from one start."""
        self.mean, self.shift, self.spread = y.mean(), X.mean(axis=0), X.std(axis=0)
        self.Z, self.y = (X - self.shift) / self.spread, y - y.mean()
        d = X.shape[1]
        start = np.append(np.full(d, 0.5 * np.log(d)), np.log(0.1))
        bounds = [(-4, 7)] * d + [(np.log(1e-8), np.log(1e3))]
        found = minimize(self.loss, start, jac=True, method="L-BFGS-B", bounds=bounds)
        factor = self.factor(found.x)[2]
        self.solved = lapack.dpotrs(factor, self.y, lower=1)[0]
        return self

    def factor(self, z):
        """Scaled rows, their kernel matrix, and the factor of it with the ridge."""
        self.scale = np.exp(-z[:-1])
        S = self.Z * self.scale
        squares = np.einsum("ij,ij->i", S, S)
        K = S @ S.T
        K -= 0.5 * squares
        K -= 0.5 * squares[:, None]
        np.exp(K, out=K)
        C = K.copy(order="F")
        C[np.diag_indices(len(C))] += np.exp(z[-1])
        return S, K, lapack.dpotrf(C, lower=1, overwrite_a=1)[0]

    def loss(self, z):
        """Negative log likelihood, up to a constant, and its gradient."""
        n = len(self.y)
        alpha = np.exp(z[-1])
        S, K, factor = self.factor(z)
        log_det = 2 * np.log(factor.diagonal()).sum()
        self.solved = lapack.dpotrs(factor, self.y, lower=1)[0]
        signal = self.y @ self.solved / n
        inverse = lapack.dpotri(factor, lower=1, overwrite_c=1)[0]
        trace = np.trace(inverse)
        # The lower triangle is enough: all is symmetric, and the diagonal has no distance.
        G = np.tril(inverse, -1)
        G -= np.outer(self.solved, self.solved / signal)
        G *= K
        G = np.tril(G, -1)
        # Squared differences of one feature, summed with weights G.
        both = G.sum(axis=0) + G.sum(axis=1)
        d_width = both @ S**2 - 2 * np.einsum("ij,ij->j", S, G @ S)
        d_alpha = 0.5 * alpha * (trace - self.solved @ self.solved / signal)
        return 0.5 * (log_det + n * np.log(signal)), np.append(d_width, d_alpha)

    def predict(self, X):
        """Return the posterior mean."""
        S, T = self.Z * self.scale, (X - self.shift) / self.spread * self.scale
        s = np.square(T).sum(1)[:, None] + np.square(S).sum(1) - 2 * T @ S.T
        return self.mean + np.exp(-0.5 * s) @ self.solved


def fit(args):
    if args.problem == "arm":
        data = make_single_point(n_positions=args.rows // 30, n_poses=30, random_state=0)
        models = ArmResidualRegressor(data.arm), ArmResidualRegressor(data.arm, orders=12)
        fits = [partial(model.fit, data.data, data.target, groups=data.groups) for model in models]
        (whole, low), _ = by_turns(args.repeats + 1, fits)
        print(f"{args.rows} poses: {whole:.2f} s, with orders up to 12 {low:.2f} s")
        return
    if args.problem == "waves":
        X, y = waves(args.rows + 1000, 6)
        n = args.rows
        problem = Problem(X[:n], y[:n], X[n:], y[n:], y[n:])
    else:
        problem = generated(args.problem, args.rows)
    models = [RBFNetRegressor(random_state=0), ExactProcess()][: 1 + args.peer]
    warm = generated("damped1", 30)
    for model in models:
        model.fit(warm.X, warm.y)  # imports and thread pools
    fits = [partial(model.fit, problem.X, problem.y) for model in models]
    seconds, ratio = by_turns(args.repeats, fits)
    print(f"{args.problem}, {args.rows} rows, {problem.X.shape[1]} features")
    for model, taken in zip(models, seconds, strict=True):
        left = model.predict(problem.X_test) - problem.truth
        error = np.sqrt(np.mean(left**2)) / np.std(problem.truth)
        print(f"{type(model).__name__} {taken:.3f} s, error {error:.4f}")
    print(f"{len(models[0].centers_)} centres; ratio {1 / ratio:.2f}")


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


def calibrations(args):
    arm = Arm.from_name("aacmm6")
    for n, n_groups in ((3000, None), (10_000, 40)):
        angles, points, groups = simulated(arm, n, n_groups)
        ours = partial(calibrate, arm, angles, groups, points=points)
        (own, by_scipy), ratio = by_turns(3, [ours, partial(by_hand, arm, angles, points, groups)])
        kind = "tracker" if points is not None else "single-point"
        times = f"calibrate {own:.2f} s, SciPy by hand {by_scipy:.2f} s"
        print(f"{len(angles)} {kind} poses: {times}; ratio {ratio:.1f}")


def best(function, repeats=5):
    """Least CPU time of a call, s."""
    return min(by_turns(1, [function])[0][0] for _ in range(repeats))


def models(data):
    """Fitted models by name: networks that all outputs share, and models of the arm."""
    arm = data.arm

    def chain(n_centers):
        network = RBFNetRegressor(n_centers, shared=True, random_state=0)
        target = CylindricalResidualTarget(make_pipeline(StandardScaler(), network))
        return make_pipeline(PoseFeatures(arm, joints="all", append_azimuth=True), target)

    known = data.data, data.target
    found = {f"network, {n} centres": chain(n).fit(*known) for n in (60, 266)}
    model = ArmResidualRegressor(arm).fit(*known, groups=data.groups)
    return found | {"model of the arm": model}


def of_ur10(data_home):
    """The default model of 2000 poses of a real robot, and the other poses."""
    angles, points, _ = read_ur10("A", data_home)
    order = np.random.default_rng(0).permutation(len(angles))
    known = order[:2000]
    return learn_tracked(UR10, angles[known], points[known])[1], angles[order]


def one_by_one(call, X, n_rows=200):
    """CPU time of a call of one row, s."""
    return best(lambda: [call(row) for row in X[:n_rows]], 3) / n_rows


def in_c(model, folder, X, expected, fade):
    """Rows of the table for one model in C: name, microseconds, gap."""
    source, _ = export_c(model, folder / "arm.c", std=True, fade=fade)
    (folder / "loop.c").write_text(LOOP)
    out = np.empty((len(X), 3))
    place = ctypes.c_void_p
    for name, flags in FLAGS.items() if shutil.which("gcc") else ():
        library = folder / f"gcc{len(flags)}.so"
        command = ["gcc", "-std=c99", *flags, "-shared", "-fPIC", "-o", library]
        subprocess.run([*command, source, folder / "loop.c", "-lm"], check=True)
        loaded = ctypes.CDLL(str(library))
        for what in ("correct", "std"):
            rows = X if what == "correct" else X[: len(X) // 10]
            arguments = (place(rows.ctypes.data), place(out.ctypes.data))
            function = getattr(loaded, f"{what}_rows")
            seconds = best(partial(function, *arguments, ctypes.c_long(len(rows))))
            label = f"C, gcc {name}" + (", with std" if what == "std" else "")
            yield label, 1e6 * seconds / len(rows), np.abs(out - expected).max()


def in_python(model, _, X, expected, fade):
    compiled = load_c(model, fade=fade)
    gap = np.abs(compiled.predict(X) - expected).max()
    yield "`load_c`, one row per call", 1e6 * one_by_one(compiled.predict, X), gap
    yield "`load_c`, one batch", 1e6 * best(lambda: compiled.predict(X)) / len(X), gap
    with contextlib.suppress(ImportError):
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        converted = to_onnx(model, fade=fade).SerializeToString()
        session = onnxruntime.InferenceSession(
            converted, options, providers=["CPUExecutionProvider"]
        )
        gap = np.abs(session.run(None, {"X": X})[0] - expected).max()
        seconds = one_by_one(lambda row: session.run(None, {"X": row[None]}), X)
        yield "ONNX, one row per call", 1e6 * seconds, gap
    seconds = one_by_one(lambda row: model.predict(row[None]), X)
    yield "`predict`, one row per call", 1e6 * seconds, 0
    yield "`predict`, one batch", 1e6 * best(lambda: model.predict(X), 3) / len(X), 0


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
                    found.setdefault(label, {})[name] = (
                        f"{microseconds:.{0 if microseconds >= 10 else 1}f}"
                    )
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


def price(args):
    matrix = np.random.default_rng(0).normal(size=(1500, 1500))

    def timed(call):
        product = best(lambda: matrix @ matrix)
        start = time.process_time()
        found = call()
        seconds = time.process_time() - start
        return found, f"{seconds:.2f} s, {seconds / product:.0f} products"

    warnings.simplefilter("ignore", UserWarning)
    test = make_single_point(14, 25, bars=[500], random_state=0)
    known = test.nominal_arm, test.data, test.groups
    print("learn_correction, 14 positions of 25 poses:", end=" ")
    print(timed(lambda: learn_correction(*known, lengths=test.lengths))[1])
    angles, points, goals = read_ur10("A", args.data or DATA)
    order = np.random.default_rng(0).permutation(len(angles))
    others = order[3000:4000]
    for n_rows in (300, 1000, 3000):
        rows = order[:n_rows]
        known = calibrate(UR10, angles[rows], points=points[rows])
        fit = partial(ArmResidualRegressor(known.arm).fit, groups=goals[rows])
        model, text = timed(partial(fit, angles[rows], known.residuals_mm))
        left = known.residuals(angles[others], points[others]) - model.predict(angles[others])
        print(f"UR10, {n_rows} poses: {text}; {mean_deviation(left):.4f} mm left at other poses")


def row(args):
    lines = table(args.rows, args.data)
    print("\n".join(lines))
    if args.write:
        text = PAGE.read_text(encoding="utf-8")
        before, rest = text.split(START)
        after = rest.split(END)[1]
        PAGE.write_text(f"{before}{START}\n\n" + "\n".join(lines) + f"\n\n{END}{after}", "utf-8")


def python(args):
    data = make_single_point(n_positions=12, n_poses=30, random_state=0)
    arm, network = data.arm, RBFNetRegressor(60, random_state=0)
    inner = CylindricalResidualTarget(make_pipeline(StandardScaler(), network))
    models = {
        "Ridge": Ridge(),
        "RBFNetRegressor": network,
        "chain, pipeline": make_pipeline(PoseFeatures(arm, append_azimuth=True), inner),
        "ArmResidualRegressor": ArmResidualRegressor(arm, orders=8),
    }
    one = data.data[:1].copy()
    calls = [partial(m.fit(data.data, data.target).predict, one) for m in models.values()]
    medians, _ = by_turns(60, calls, 20)
    for name, seconds in zip(models, medians, strict=True):
        print(f"{name}: {1e6 * seconds:.0f} us, {seconds / medians[0]:.2f} times Ridge's")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = {"fit": fit, "calibrate": calibrations, "python": python, "row": row, "price": price}
    parser.add_argument("part", choices=parts)
    problems = ["arm", "waves", *GENERATED]
    parser.add_argument("--problem", default="fourier3", choices=problems, help="of fit")
    parser.add_argument("--rows", type=int, help="of fit 300, of a model 20 000 unless given")
    parser.add_argument("--repeats", type=int, default=3, help="of fit")
    parser.add_argument("--no-peer", dest="peer", action="store_false")
    parser.add_argument("--data", help="folder of the real data")
    parser.add_argument("--write", action="store_true", help="the table of rows into doc/log.md")
    args = parser.parse_args()
    args.rows = args.rows or (300 if args.part == "fit" else 20_000)
    parts[args.part](args)


if __name__ == "__main__":
    main()
