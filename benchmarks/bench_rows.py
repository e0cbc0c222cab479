"""Many rows, and RBFNetRegressor's choice of centres: time and memory, on one thread.

    python benchmarks/bench_rows.py --rows 1e5 1e6 1e7
    python benchmarks/bench_rows.py --calibrate 1e5 1e6
    python benchmarks/bench_rows.py --workers 1e6
    python benchmarks/bench_rows.py --n 3000 --k 200

``--rows``: 6 features and 3 outputs in memory-mapped files; 100 centres, given widths and ridge,
then everything found by itself. Printed are CPU seconds, the peak memory above the imports,
centres, and the mean squared residual, of which 0.01 is noise. ``--cliffs``: default fits with n
and 1.01 n rows where a limit on the rows is passed, of a rough and a smooth function: no step
should be larger than 1.5, in time or in error. ``--calibrate``: `calibrate` of simulated poses and
points of a tracker in memory-mapped files. ``--workers``: `ArmResidualRegressor` of orders up to 4
in memory, then as dask arrays on two processes, of which one is killed on the way: how far their
coefficients are apart.

``--k`` chooses k of n columns exp(-|x_i - x_j|^2 / (2 l^2)), about their mean, for one target, by
`RBFNetRegressor` and by peers, who are given the ready dictionary for free, each in a process of
its own; last, how many centres are those of exact orthogonal least squares (fastcan). orthogonal_mp
is another, cheaper choice: it does not look at what is left of a candidate. ``--held-out``: error
against the truth, in its standard deviations, by how as many centres are chosen, with the widths
and ridge that RBFNetRegressor() finds: forward selection (ols), means of clusters, rows at random
(root mean square of five draws), and pivots of the Cholesky factor (p-greedy).
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from pathlib import Path

import _one_thread  # noqa: F401
import numpy as np
from _problems import GENERATED, costs, generated
from scipy.spatial.distance import cdist
from sklearn.cluster import KMeans
from sklearn.linear_model import orthogonal_mp

from sklearn_raacmm import Arm, ArmResidualRegressor, RBFNetRegressor, calibrate
from sklearn_raacmm.network._kernels import kernel_matrix, pivoted_cholesky, psd_root

SETTINGS = {"given": {"n_centers": 100, "length_scale": 1.5, "alpha": 1e-3}, "auto": {}}
N_TEST = 2000
# Features, and frequency of the waves: 8 features that ask for centres by the thousand, and 3.
FUNCTIONS = {"rough": (8, 0.9), "smooth": (3, 0.8)}
SIZES = (100, 300, 999, 3000, 9999, 30_000, 99_999)


def mapped(folder, n, mode):
    X = np.memmap(folder / "X", dtype=np.float64, mode=mode, shape=(n, 6))
    return X, np.memmap(folder / "Y", dtype=np.float64, mode=mode, shape=(n, 3))


def write(folder, n):
    rng = np.random.default_rng(0)
    X, Y = mapped(folder, n, "w+")
    for start in range(0, n, 100_000):
        x = rng.uniform(-1, 1, (min(100_000, n - start), 6))
        f = np.sin(2 * x[:, 0]) * x[:, 1], np.cos(x[:, 2] + x[:, 3]), x[:, 4] ** 2 * x[:, 5]
        X[start : start + len(x)] = x
        Y[start : start + len(x)] = np.column_stack(f) + 0.1 * rng.standard_normal((len(x), 3))


def run(method, n, folder):
    """Fit in this process, and print what it took."""
    X, Y = mapped(folder, n, "r")
    RBFNetRegressor(2, length_scale=1.0, alpha=0).fit(X[:10], Y[:10])
    model = RBFNetRegressor(random_state=0, **SETTINGS[method])
    _, seconds, mib = costs(lambda: model.fit(X, Y))
    parts = (slice(i, i + 100_000) for i in range(0, n, 100_000))
    mse = sum(np.sum((model.predict(X[part]) - Y[part]) ** 2) for part in parts) / Y.size
    shown = f"{seconds:.2f} s, {mib:.0f} MiB, {len(model.centers_)} centres, {mse:.6f}"
    print(f"{n} rows, {method}: {shown}", flush=True)


def poses(n):
    """Angles, and points of a tracker with 0.02 mm of noise, of an arm that is off its table."""
    arm, rng = Arm.from_name("aacmm6"), np.random.default_rng(0)
    a, d = (length + rng.normal(0, 0.2, 6) for length in (arm.a, arm.d))
    angles = rng.uniform(-2, 2, (n, 6))
    points = arm.replace(a=a, d=d).forward(angles)[:, [1, 2, 0]] + [1000, 0, 0]
    return arm, angles, points + rng.normal(0, 0.02, points.shape)


def calibration(n, folder):
    """Calibrate in this process, and print what it took."""
    arm = Arm.from_name("aacmm6")
    angles, points = (np.load(folder / f"{name}.npy", mmap_mode="r") for name in ("q", "points"))
    calibrate(arm, angles[:500], points=points[:500])
    result, seconds, mib = costs(lambda: calibrate(arm, angles, points=points))
    print(f"{n} poses: {seconds:.1f} s, {mib:.0f} MiB, noise {result.sigma_mm:.5f} mm", flush=True)


def workers(n):
    """Coefficients in memory, and by two processes of which one is killed on the way."""
    import dask.array as da
    from distributed import Client, LocalCluster

    arm, angles, _ = poses(n)
    encoder = 3e-5 * np.cos(3 * angles[:, 1:2])
    y = arm.jacobian(angles)[:, :, 1] * encoder
    y += np.random.default_rng(1).normal(0, 0.01, y.shape)
    model = ArmResidualRegressor(arm, orders=4, causes=["kinematics"])
    start = time.perf_counter()
    whole = model.fit(angles, y, groups=False).coef_
    taken = time.perf_counter() - start
    print(f"{n} rows in memory: {taken:.0f} s", flush=True)
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with LocalCluster(**options) as cluster, Client(cluster) as client:
        before = client.run(os.getpid)
        kill = threading.Timer(taken / 4, os.kill, (min(before.values()), signal.SIGKILL))
        kill.start()
        start = time.perf_counter()
        chunks = (da.from_array(array, chunks=(100_000, -1)) for array in (angles, y))
        found = model.fit(*chunks, groups=False).coef_
        seconds, lost = time.perf_counter() - start, client.run(os.getpid) != before
    apart = np.abs(found - whole).max() / np.abs(whole).max()
    print(f"by dask: {seconds:.0f} s, a process killed: {lost}; coefficients {apart:.1e} apart")


def many_poses(sizes):
    for n in map(int, sizes):
        with tempfile.TemporaryDirectory() as folder:
            _, angles, points = poses(n)
            np.save(Path(folder) / "q", angles)
            np.save(Path(folder) / "points", points)
            call = json.dumps(["calibrate", n, folder])
            subprocess.run([sys.executable, __file__, "--one", call], check=True)


def many(sizes):
    for n in map(int, sizes):
        with tempfile.TemporaryDirectory() as folder:
            write(Path(folder), n)
            for method in SETTINGS:
                call = json.dumps([method, n, folder])
                subprocess.run([sys.executable, __file__, "--one", call], check=True)


def rows(name, n):
    """Rows, targets with noise, and the truth; the first rows are for the test."""
    d, frequency = FUNCTIONS[name]
    rng = np.random.default_rng(7)
    waves, phases = frequency * rng.standard_normal((d, 60)), rng.uniform(0, 2 * np.pi, 60)
    weights = rng.standard_normal(60) / 5
    rng = np.random.default_rng(8)
    X = rng.uniform(-1, 1, (n, d))
    f = np.concatenate([np.sin(part @ waves + phases) @ weights for part in np.array_split(X, 50)])
    return X, f + 0.1 * rng.standard_normal(f.shape), f


def measure(X, y, X_test, truth):
    """CPU seconds, error in standard deviations of the truth, and centres."""
    model, seconds, _ = costs(lambda: RBFNetRegressor(random_state=0).fit(X, y))
    left = (model.predict(X_test) - truth) / truth.std()
    return np.array([seconds, np.sqrt(np.mean(np.square(left))), len(model.centers_)])


def cliffs():
    for name in FUNCTIONS:
        for n in SIZES:
            more = n + max(2, n // 100)
            X, y, f = rows(name, more + N_TEST)
            test = X[:N_TEST], f[:N_TEST]
            one, two = (measure(X[N_TEST:][:k], y[N_TEST:][:k], *test) for k in (n, more))
            shown = "{:.2f} s, error {:.4f}, {:.0f} centres".format(*one)
            steps = "{:.2f}, {:.3f}, {:.3f}".format(*two / one)
            print(f"{name} {n} rows: {shown}; over it of {more} rows: {steps}", flush=True)


METHODS = ("RBFNetRegressor", "fastcan", "orthogonal_mp")
LENGTH_SCALE = 0.5
WAYS = ("ols", "k-means", "random", "p-greedy")
HELD_OUT, DRAWS = (10, 20, 50, 100), 5


def choose(method, n, k):
    """Choose in this process, and print what it took as JSON."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (n, 3))
    y = np.sin(4 * X[:, 0]) * np.cos(2 * X[:, 1]) + X[:, 2] ** 2 + 0.05 * rng.standard_normal(n)
    RBFNetRegressor(2, length_scale=1.0, alpha=0).fit(X[:10], y[:10])  # imports, thread pools
    if method == "fastcan":
        from fastcan import FastCan

    def chosen():
        if method == "RBFNetRegressor":
            model = RBFNetRegressor(k, length_scale=LENGTH_SCALE, alpha=0)
            return costs(lambda: model.fit(X, y).center_indices_)
        K = cdist(X, X, "sqeuclidean")
        K /= -2 * LENGTH_SCALE**2
        np.exp(K, out=K)
        if method == "fastcan":
            return costs(lambda: FastCan(k, verbose=0).fit(K, y[:, None]).indices_)
        K -= K.mean(axis=0)
        K /= np.linalg.norm(K, axis=0)
        return costs(lambda: np.flatnonzero(orthogonal_mp(K, y - y.mean(), n_nonzero_coefs=k)))

    (rows, seconds, _), _, mib = costs(chosen)  # memory with the dictionary, time without it
    print(json.dumps([seconds, mib, rows.tolist()]))


def selection(n, k):
    found = {}
    for method in METHODS:
        command = [sys.executable, __file__, "--one", json.dumps([method, n, k])]
        out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        found[method] = json.loads(out)
    exact = set(found["fastcan"][2])
    for method, (seconds, mib, chosen) in found.items():
        same = len(exact & set(chosen))
        print(f"{method:<20} {seconds:>9.3f} s {mib:>7.0f} MiB, {same} of {k} centres")


def network(Z, y, centers, alpha):
    """Function of scaled rows: constant and Gaussian units at given centres, penalised by w'Kw."""
    columns = np.column_stack([np.ones(len(Z)), kernel_matrix(Z, centers, "gaussian")])
    root = psd_root(kernel_matrix(centers, centers, "gaussian"))
    root = np.column_stack([np.zeros(len(root)), root])
    coef = np.empty((columns.shape[1], y.shape[1]))
    for i, one in enumerate(np.broadcast_to(alpha, y.shape[1])):
        stacked = np.vstack([columns, np.sqrt(one) * root])
        right = np.append(y[:, i], np.zeros(len(root)))
        coef[:, i] = np.linalg.lstsq(stacked, right, rcond=1e-12)[0]
    return lambda rows: coef[0] + kernel_matrix(rows, centers, "gaussian") @ coef[1:]


def compare(problem, sizes, seed):
    """Errors (n_sizes, n_ways), and the full model."""
    X, y, X_test, truth, _ = problem
    full = RBFNetRegressor(kernel="gaussian", shared=True, random_state=0).fit(X, y)
    y, truth = y.reshape(len(y), -1), truth.reshape(len(truth), -1)
    shift = X.mean(axis=0)
    Z, Z_test = ((rows - shift) / full.length_scale_ for rows in (X, X_test))

    def error(predicted):
        mean = predicted.reshape(truth.shape)
        return np.sqrt(np.mean(np.square((mean - truth) / truth.std(axis=0))))

    def at(centers):
        return error(network(Z, y, centers, full.alpha_)(Z_test))

    # The ridge may differ between outputs; a number serves them all, so fit the weights here.
    alpha = float(np.exp(np.mean(np.log(full.alpha_))))
    rng = np.random.default_rng(seed)
    errors = np.empty((len(sizes), len(WAYS)))
    pivots = pivoted_cholesky(Z, "gaussian", tol=0.0, max_rank=max(sizes), block_size=1)[1]
    for i, k in enumerate(sizes):
        model = RBFNetRegressor(k, length_scale=full.length_scale_, alpha=alpha, shared=True)
        model.fit(X, y if y.shape[1] > 1 else y[:, 0])
        errors[i, 0] = at(Z[model.center_indices_])
        errors[i, 1] = at(KMeans(k, n_init=3, random_state=seed).fit(Z).cluster_centers_)
        draws = [at(Z[rng.choice(len(Z), k, replace=False)]) for _ in range(DRAWS)]
        errors[i, 2] = np.sqrt(np.mean(np.square(draws)))
        errors[i, 3] = at(Z[pivots[:k]])
    return errors, (len(full.centers_), error(full.predict(X_test)))


def held_out(problems, n):
    for name in problems:
        errors, (size, best) = compare(generated(name, n, 0), HELD_OUT, 0)
        print(f"\n{name}, n = {n}; RBFNetRegressor(): {size} centres, error {best:.4f}")
        print(f"{'k':>5} " + "".join(f"{way:>10}" for way in WAYS))
        for k, row in zip(HELD_OUT, errors, strict=True):
            print(f"{k:>5} " + "".join(f"{error:>10.4f}" for error in row))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=float, nargs="+", default=[1e5, 1e6])
    parser.add_argument("--calibrate", type=float, nargs="+", metavar="N")
    parser.add_argument("--workers", type=float, metavar="N")
    parser.add_argument("--cliffs", action="store_true")
    parser.add_argument("--k", type=int, help="centres to choose of --n rows")
    parser.add_argument("--n", type=int, default=3000)
    parser.add_argument("--held-out", nargs="+", choices=GENERATED, metavar="PROBLEM")
    parser.add_argument("--one", type=json.loads, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        method, n, last = args.one
        if method == "calibrate":
            return calibration(n, Path(last))
        return choose(method, n, last) if method in METHODS else run(method, n, Path(last))
    if args.calibrate:
        return many_poses(args.calibrate)
    if args.workers:
        return workers(int(args.workers))
    if args.held_out:
        return held_out(args.held_out, args.n)
    if args.k:
        return selection(args.n, args.k)
    if not args.cliffs:
        return many(args.rows)
    warnings.simplefilter("ignore")
    RBFNetRegressor().fit(np.eye(9), np.arange(9.0))  # imports and thread pools
    return cliffs()


if __name__ == "__main__":
    main()
