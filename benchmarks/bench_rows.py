"""RBFNetRegressor on many rows: time, memory, and the cost model behind them.

Rows have 6 features and 3 outputs and lie in memory-mapped files; 100 centres,
given widths and ridge, then everything found by itself. Each run is a process of its own with one
BLAS thread. Beside it: the Gram matrix of all candidates' columns, accumulated over blocks of rows
(float64, as symmetric products), and forward selection on it, which is what a landmark factor
saves; its candidates are drawn anew, which moves the residual by a per cent or two. Printed are CPU
seconds, those of the Gram matrix over ours, the peak memory above the imports, and the mean squared
residual on the training rows, of which 0.01 is noise. The Gram matrix is left out above
--gram-rows.

    python benchmarks/bench_rows.py --rows 1e5 1e6
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

METHODS = ["given", "auto", "gram"]
N_CANDIDATES, N_CENTERS, WIDTH, ALPHA = 2000, 100, 1.5, 1e-3


def write(folder, n):
    import numpy as np

    rng = np.random.default_rng(0)
    X = np.memmap(folder / "X", dtype=np.float64, mode="w+", shape=(n, 6))
    Y = np.memmap(folder / "Y", dtype=np.float64, mode="w+", shape=(n, 3))
    for start in range(0, n, 100_000):
        x = rng.uniform(-1, 1, (min(100_000, n - start), 6))
        f = np.sin(2 * x[:, 0]) * x[:, 1], np.cos(x[:, 2] + x[:, 3]), x[:, 4] ** 2 * x[:, 5]
        X[start : start + len(x)] = x
        Y[start : start + len(x)] = np.column_stack(f) + 0.1 * rng.standard_normal((len(x), 3))


def accumulate(X, Y):
    """Forward selection on the Gram matrix of all candidates' columns."""
    import numpy as np
    from scipy.linalg import cho_factor, cho_solve

    from sklearn_raacmm.network._kernels import kernel_matrix

    rows = np.sort(np.random.default_rng(0).permutation(len(X))[:N_CANDIDATES])
    C = X[rows] / WIDTH
    gram, cross, total = 0.0, 0.0, 0.0
    for start in range(0, len(X), 4096):
        part = slice(start, start + 4096)
        K = np.hstack([kernel_matrix(X[part] / WIDTH, C, "gaussian"), np.ones((len(X[part]), 1))])
        gram, cross = gram + K.T @ K, cross + K.T @ Y[part]
        total += np.sum(Y[part] ** 2)
    full, by_target = gram.copy(), cross.copy()
    chosen = [N_CANDIDATES]  # the constant first
    for _ in range(N_CENTERS + 1):
        j = chosen[-1]
        column = gram[j] / np.sqrt(gram[j, j])
        along = cross[j] / np.sqrt(gram[j, j])
        gram -= np.outer(column, column)
        cross -= np.outer(column, along)
        norms = gram.diagonal().copy()
        norms[norms <= 1e-6 * full.diagonal()] = np.inf
        norms[chosen] = np.inf
        chosen.append(int(np.argmax(np.square(cross).sum(axis=1) / norms)))
    S = chosen[:-1]
    ridge = np.zeros((len(S), len(S)))
    ridge[1:, 1:] = ALPHA * kernel_matrix(C[S[1:]], C[S[1:]], "gaussian")
    weights = cho_solve(cho_factor(full[np.ix_(S, S)] + ridge), by_target[S])
    left = (
        total
        - 2 * np.sum(weights * by_target[S])
        + np.sum(weights * (full[np.ix_(S, S)] @ weights))
    )
    return left / Y.size, len(S) - 1


def run(method, n, folder):
    import numpy as np

    from sklearn_raacmm import RBFNetRegressor

    X = np.memmap(folder / "X", dtype=np.float64, mode="r", shape=(n, 6))
    Y = np.memmap(folder / "Y", dtype=np.float64, mode="r", shape=(n, 3))
    RBFNetRegressor(2, length_scale=1.0, alpha=0).fit(X[:10], Y[:10])
    base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.process_time()
    if method == "gram":
        mse, k = accumulate(X, Y)
        seconds = time.process_time() - start
    else:
        given = {"n_centers": N_CENTERS, "length_scale": WIDTH, "alpha": ALPHA}
        settings = given if method == "given" else {}
        model = RBFNetRegressor(random_state=0, **settings).fit(X, Y)
        seconds, k = time.process_time() - start, len(model.centers_)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base
    if method != "gram":
        parts = range(0, n, 100_000)
        squares = [
            np.sum((model.predict(X[i : i + 100_000]) - Y[i : i + 100_000]) ** 2) for i in parts
        ]
        mse = sum(squares) / Y.size
    print(json.dumps({"seconds": seconds, "mib": peak / 1024, "mse": float(mse), "centers": k}))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=float, nargs="+", default=[1e5, 1e6])
    parser.add_argument(
        "--gram-rows", type=float, default=1e6, help="most rows for the Gram matrix"
    )
    parser.add_argument("--methods", nargs="+", default=METHODS, choices=METHODS)
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        run(args.one[0], int(args.rows[0]), Path(args.one[1]))
        return
    one_thread = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    print("6 features, 3 outputs, 1 thread; memory-mapped files are counted where they are read")
    head = f"{'rows':>9} {'method':<8} {'CPU s':>8} {'gram/it':>8} {'us/row':>7} {'MiB':>6}"
    print(f"{head} {'data MiB':>9} {'centres':>8} {'mse':>9}")
    for n in map(int, args.rows):
        with tempfile.TemporaryDirectory() as folder:
            write(Path(folder), n)
            results = {}
            for method in args.methods:
                if method == "gram" and n > args.gram_rows:
                    continue
                command = [sys.executable, __file__, "--rows", str(n), "--one", method, folder]
                out = subprocess.run(
                    command, env=os.environ | one_thread, capture_output=True, text=True, check=True
                ).stdout
                results[method] = json.loads(out)
            for method, r in results.items():
                gram = results.get("gram", {}).get("seconds", float("nan"))
                print(
                    f"{n:>9} {method:<8} {r['seconds']:>8.2f} {gram / r['seconds']:>7.1f}x "
                    f"{1e6 * r['seconds'] / n:>7.1f} {r['mib']:>6.0f} {n * 72 / 2**20:>9.0f} "
                    f"{r['centers']:>8} {r['mse']:>9.6f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
