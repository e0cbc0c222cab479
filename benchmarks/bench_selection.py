"""Choice of centres: time and memory against peers, and what well chosen ones are worth.

    python benchmarks/bench_selection.py --n 3000 --k 200
    python benchmarks/bench_selection.py --held-out fourier3 robot_arm8

The first chooses k of n columns exp(-|x_i - x_j|^2 / (2 l^2)), about their mean, for one target, by
`RBFNetRegressor` and by peers, who are given the ready dictionary for free. Each run is a process
of its own with one thread; printed are CPU seconds, the peak memory above the imports, and how many
centres are those of exact orthogonal least squares (fastcan). orthogonal_mp is another, cheaper
choice: it does not look at what is left of a candidate.

``--held-out``: root mean square error against the truth without noise, in standard deviations of
the truth, by how as many centres are chosen, with the widths and ridge that RBFNetRegressor() finds
on the same rows: forward selection (ols), means of clusters of the scaled inputs, rows at random
(root mean square of five draws), and rows where the interpolant's power function is greatest
(p-greedy: pivots of the Cholesky factor).
"""

import argparse
import json
import resource
import subprocess
import sys
import time

import _one_thread  # noqa: F401
import numpy as np
from _problems import GENERATED, generated
from scipy.spatial.distance import cdist
from sklearn.cluster import KMeans
from sklearn.linear_model import orthogonal_mp

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.network._kernels import kernel_matrix, pivoted_cholesky, psd_root

METHODS = ("RBFNetRegressor", "fastcan", "orthogonal_mp")
LENGTH_SCALE = 0.5
WAYS = ("ols", "k-means", "random", "p-greedy")
SIZES, DRAWS = (10, 20, 50, 100), 5


def run(method, n, k):
    """Choose in this process, and print what it took as JSON."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (n, 3))
    y = np.sin(4 * X[:, 0]) * np.cos(2 * X[:, 1]) + X[:, 2] ** 2 + 0.05 * rng.standard_normal(n)
    RBFNetRegressor(2, length_scale=1.0, alpha=0).fit(X[:10], y[:10])  # imports, thread pools
    if method == "fastcan":
        from fastcan import FastCan
    base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    if method == "RBFNetRegressor":
        start = time.process_time()
        chosen = RBFNetRegressor(k, length_scale=LENGTH_SCALE, alpha=0).fit(X, y).center_indices_
    else:
        K = cdist(X, X, "sqeuclidean")
        K /= -2 * LENGTH_SCALE**2
        np.exp(K, out=K)
        start = time.process_time()
        if method == "fastcan":
            chosen = FastCan(k, verbose=0).fit(K, y[:, None]).indices_
        else:
            K -= K.mean(axis=0)
            K /= np.linalg.norm(K, axis=0)
            chosen = np.flatnonzero(orthogonal_mp(K, y - y.mean(), n_nonzero_coefs=k))
    seconds = time.process_time() - start
    mib = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base) / 1024
    print(json.dumps([seconds, mib, [int(i) for i in chosen]]))


def selection(n, k):
    """Print time, memory and agreement of each method."""
    found = {}
    for method in METHODS:
        command = [sys.executable, __file__, "--one", method, "--n", str(n), "--k", str(k)]
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


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=int, default=3000)
    parser.add_argument("--k", type=int, default=200)
    parser.add_argument("--held-out", nargs="+", choices=GENERATED, metavar="PROBLEM")
    parser.add_argument("--one", choices=METHODS, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        return run(args.one, args.n, args.k)
    if not args.held_out:
        return selection(args.n, args.k)
    for name in args.held_out:
        errors, (size, best) = compare(generated(name, args.n, 0), SIZES, 0)
        print(f"\n{name}, n = {args.n}; RBFNetRegressor(): {size} centres, error {best:.4f}")
        print(f"{'k':>5} " + "".join(f"{way:>10}" for way in WAYS))
        for k, row in zip(SIZES, errors, strict=True):
            print(f"{k:>5} " + "".join(f"{error:>10.4f}" for error in row))


if __name__ == "__main__":
    main()
