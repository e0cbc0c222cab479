"""Cliffs: time and error of a default fit where a limit on the number of rows is passed.

Of a rough and a smooth function, with n rows and with some more, the same rows but for these. No
step should be larger than 1.5, in time or in error.

    python benchmarks/bench_cliffs.py --sizes 300 1000 10000 100000
    python benchmarks/bench_cliffs.py --million     # a million rows, three outputs
"""

import argparse
import os
import time
import warnings

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import numpy as np

from sklearn_raacmm import RBFNetRegressor

N_TEST = 2000
# Features, and frequency of the waves: 8 features that ask for centres by the thousand, and 3.
FUNCTIONS = {"rough": (8, 0.9), "smooth": (3, 0.8)}


def rows(name, n, n_outputs=1):
    """Rows, targets with noise, and the truth; the last rows are for the test."""
    d, frequency = FUNCTIONS[name]
    rng = np.random.default_rng(7)
    waves, phases = frequency * rng.standard_normal((d, 60)), rng.uniform(0, 2 * np.pi, 60)
    weights = rng.standard_normal((60, n_outputs)) / 5
    rng = np.random.default_rng(8)
    X = rng.uniform(-1, 1, (n, d))
    f = np.concatenate([np.sin(part @ waves + phases) @ weights for part in np.array_split(X, 50)])
    return X, f + 0.1 * rng.standard_normal(f.shape), f


def measure(X, y, X_test, truth):
    """CPU seconds, error in standard deviations of the truth, centres and why there are no more."""
    start = time.process_time()
    model = RBFNetRegressor(random_state=0).fit(X, y)
    seconds = time.process_time() - start
    left = (model.predict(X_test).reshape(truth.shape) - truth) / truth.std(axis=0)
    error = np.sqrt(np.mean(np.square(left)))
    return seconds, error, len(model.centers_), model.stop_reason_


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    sizes = [100, 300, 999, 3000, 9999, 30_000, 99_999]
    parser.add_argument("--sizes", type=int, nargs="+", default=sizes)
    parser.add_argument("--functions", nargs="+", default=list(FUNCTIONS), choices=list(FUNCTIONS))
    parser.add_argument("--million", action="store_true")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    RBFNetRegressor().fit(np.eye(9), np.arange(9.0))  # imports and thread pools
    if args.million:
        X, y, f = rows("smooth", 1_000_000 + N_TEST, 3)
        found = measure(X[N_TEST:], y[N_TEST:], X[:N_TEST], f[:N_TEST])
        print("a million rows, three outputs: {:.1f} s, error {:.5f}, {} centres".format(*found))
        return
    for name in args.functions:
        for n in args.sizes:
            more = n + max(2, n // 100)
            X, y, f = rows(name, more + N_TEST)
            test = X[:N_TEST], f[:N_TEST]
            one, two = (measure(X[N_TEST:][:k], y[N_TEST:][:k, 0], *test) for k in (n, more))
            print(
                f"{name} {n} and {more} rows: {one[0]:.2f} and {two[0]:.2f} s "
                f"({two[0] / one[0]:.2f}), errors {one[1]:.4f} and {two[1]:.4f} "
                f"({two[1] / one[1]:.3f}), {one[2]} and {two[2]} centres, {one[3]}, {two[3]}",
                flush=True,
            )


if __name__ == "__main__":
    main()
