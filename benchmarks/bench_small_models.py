"""Small networks: held-out error against the number of centres, by how the centres are chosen.

Widths and ridge are those that RBFNetRegressor() finds on the same training rows, the same for all
ways, so that only the centres differ:

- ols: forward selection, RBFNetRegressor(k);
- k-means: means of clusters of the scaled inputs;
- random: training rows drawn at random, root mean square error of five draws;
- p-greedy: rows where the interpolant's power function is greatest (pivots of the Cholesky factor).

Printed is the root mean square error against the truth without noise, in standard deviations of
the truth, joined over outputs.

    python benchmarks/bench_small_models.py --problems fourier3 robot_arm8 --sizes 10 20 50 100
"""

import argparse

import numpy as np
from _problems import GENERATED, generated
from sklearn.cluster import KMeans
from threadpoolctl import threadpool_limits

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.network._kernels import kernel_matrix, pivoted_cholesky, psd_root

WAYS = ["ols", "k-means", "random", "p-greedy"]
DRAWS = 5


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
    pivots = pivoted_cholesky(Z, "gaussian", tol=0.0, max_rank=max(sizes), block_size=1).pivots
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
    parser.add_argument("--sizes", type=int, nargs="+", default=[10, 20, 50, 100])
    parser.add_argument(
        "--problems",
        nargs="+",
        default=["fourier3", "robot_arm8", "periodic3"],
        choices=list(GENERATED),
    )
    parser.add_argument("--seeds", type=int, default=1)
    args = parser.parse_args()
    head = "".join(f"{way:>10}" for way in WAYS)
    for name in args.problems:
        results = []
        for seed in range(args.seeds):
            with threadpool_limits(1):
                results.append(compare(generated(name, args.n, seed), args.sizes, seed))
        errors = np.median([r[0] for r in results], axis=0)
        size, best = np.median([r[1] for r in results], axis=0)
        print(f"\n{name}, n = {args.n}; RBFNetRegressor(): {size:.0f} centres, error {best:.4f}")
        print(f"{'k':>5} {head}")
        for i, k in enumerate(args.sizes):
            fields = "".join(f"{e:>10.4f}" for e in errors[i])
            print(f"{k:>5} {fields}")


if __name__ == "__main__":
    main()
