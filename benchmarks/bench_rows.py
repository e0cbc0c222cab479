"""RBFNetRegressor on many rows: time, memory, and whether a limit on the rows is a cliff.

    python benchmarks/bench_rows.py --rows 1e5 1e6 1e7
    python benchmarks/bench_rows.py --cliffs      # default fits with n and 1.01 n rows

The rows of the first have 6 features and 3 outputs and lie in memory-mapped files; 100 centres,
given widths and ridge, then everything found by itself. Printed are CPU seconds, the peak memory
above the imports, centres, and the mean squared residual, of which 0.01 is noise.

Cliffs are looked for where a limit on the number of rows is passed, of a rough and a smooth
function: no step should be larger than 1.5, in time or in error. One BLAS thread.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import _one_thread  # noqa: F401
import numpy as np
from _problems import costs

from sklearn_raacmm import RBFNetRegressor

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


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=float, nargs="+", default=[1e5, 1e6])
    parser.add_argument("--cliffs", action="store_true")
    parser.add_argument("--one", type=json.loads, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        method, n, folder = args.one
        return run(method, n, Path(folder))
    if not args.cliffs:
        return many(args.rows)
    warnings.simplefilter("ignore")
    RBFNetRegressor().fit(np.eye(9), np.arange(9.0))  # imports and thread pools
    return cliffs()


if __name__ == "__main__":
    main()
