"""Accuracy, time and size of RBFNetRegressor() beside a Gaussian process and tuned peers.

Real residuals of two robot arms, held out by position, and ten generated problems with noise. Every
peer gets standardised inputs and targets; the Gaussian process has one width a feature, white noise
and two restarts, above 1000 rows none, but a start from what it found on the first 1000; kernel
ridge, Nystroem with ridge, support vectors and the perceptron are tuned by a grid search with three
folds, of about as many candidates as their authors would call thorough.
RBFNetRegressor gets the data as they are and no setting at all. One thread throughout.

Error is the root mean square over test rows of prediction less truth (generated: without noise;
real: as measured), in units of the truth's standard deviation, joined over outputs. Ratios are
medians over seeds of peer / RBFNetRegressor, but for the errors, which are given relative to the
Gaussian process where it was run, else to RBFNetRegressor.

    python benchmarks/bench_accuracy.py --sizes 300 1000 --seeds 3 --generated --csv accuracy.csv

Runs found in the file of --csv are not repeated. Real data: see benchmarks/_problems.py.
"""

import argparse
import csv
import pickle
import time
import warnings
from pathlib import Path

import numpy as np
from _problems import GENERATED, generated, panda_folds, ur10
from scipy.stats import norm
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.compose import TransformedTargetRegressor
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.kernel_approximation import Nystroem
from sklearn.kernel_ridge import KernelRidge
from sklearn.linear_model import Ridge
from sklearn.model_selection import GridSearchCV
from sklearn.multioutput import MultiOutputRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVR
from threadpoolctl import threadpool_limits

from sklearn_raacmm import RBFNetRegressor

OURS = "RBFNet"
# Name: folds of a problem; the number of training rows, None for as many as there are.
REAL = {
    "panda_3 pose": (lambda n: panda_folds("pose"), None),
    "panda_3 all": (lambda n: panda_folds("all"), None),
    "ur10 pose": (lambda n: ur10("pose", n), 3000),
    "ur10 all": (lambda n: ur10("all", n), 3000),
    "ur10 pose, all rows": (lambda n: ur10("pose", n), None),
    "ur10 all, all rows": (lambda n: ur10("all", n), None),
}
PREDICTED_ROWS = 100_000
# Rows from which three starts of the Gaussian process would take hours.
PROCESS_ROWS = 1000
LEVELS = (0.5, 0.9, 0.95, 0.99)


class TwoStageProcess(RegressorMixin, BaseEstimator):
    """Marginal likelihood from three starts, of many rows from the optimum of the first 1000."""

    def fit(self, X, y):
        """Fit to some rows and, if these are not all, to all from there."""
        d, few = X.shape[1], slice(PROCESS_ROWS)
        kernel = ConstantKernel() * RBF(np.ones(d), (1e-2, 1e3)) + WhiteKernel(0.1, (1e-8, 1e2))
        process = GaussianProcessRegressor(
            kernel, normalize_y=True, n_restarts_optimizer=2, random_state=0
        ).fit(X[few], y[few])
        if len(X) > PROCESS_ROWS:
            process = GaussianProcessRegressor(process.kernel_, normalize_y=True).fit(X, y)
        self.process_ = process
        return self

    def predict(self, X, return_std=False):
        """Mean, and standard deviation of an observation."""
        return self.process_.predict(X, return_std=return_std)


def gaussian_process(n, d):
    """One width a feature and white noise."""
    return make_pipeline(StandardScaler(), TwoStageProcess())


def search(regressor, grid, *steps):
    """Grid search of a regressor on standardised inputs and targets."""
    model = TransformedTargetRegressor(
        make_pipeline(StandardScaler(), *steps, regressor), transformer=StandardScaler()
    )
    return GridSearchCV(model, {f"regressor__{key}": grid[key] for key in grid}, cv=3)


def kernel_ridge(n, d):
    """56 candidates."""
    gammas = np.logspace(-2.5, 1, 8) / d
    grid = {"kernelridge__gamma": gammas, "kernelridge__alpha": np.logspace(-5, 1, 7)}
    return search(KernelRidge(kernel="rbf"), grid)


def nystroem(n, d):
    """56 candidates of 300 landmarks, or as many as a fold of few rows has."""
    gammas = np.logspace(-2.5, 1, 8) / d
    grid = {"nystroem__gamma": gammas, "ridge__alpha": np.logspace(-5, 1, 7)}
    return search(Ridge(), grid, Nystroem(n_components=min(300, 2 * n // 3), random_state=0))


def support_vectors(n, d):
    """60 candidates; an output at a time."""
    name = "multioutputregressor__estimator"
    grid = {
        f"{name}__gamma": np.logspace(-2, 0.7, 5) / d,
        f"{name}__C": [0.3, 3.0, 30.0, 300.0],
        f"{name}__epsilon": [0.01, 0.1, 0.3],
    }
    return search(MultiOutputRegressor(SVR(cache_size=500)), grid)


def perceptron(n, d):
    """12 candidates."""
    grid = {
        "mlpregressor__hidden_layer_sizes": [(20,), (100,), (50, 50)],
        "mlpregressor__alpha": [1e-4, 1e-2, 1.0, 10.0],
    }
    return search(MLPRegressor(solver="lbfgs", max_iter=500, random_state=0), grid)


# With the largest number of rows at which each is tried, unless --no-limits.
MODELS = {
    OURS: (lambda n, d: RBFNetRegressor(random_state=0), None),
    "GP": (gaussian_process, 3000),
    "KernelRidge": (kernel_ridge, 3000),
    "Nystroem": (nystroem, None),
    "SVR": (support_vectors, 3000),
    "MLP": (perceptron, 3000),
}


def folds_of(name, n, seed):
    """Problems of one line of the table: one, or one a fold of real data."""
    return list(REAL[name][0](n)) if name in REAL else [generated(name, n, seed)]


def measure(method, folds):
    """Fit and judge on every fold; figures of all folds together."""
    sums, n_test, covered, fit_s, predict_s, size = 0.0, 0, np.zeros(len(LEVELS)), 0.0, 0.0, 0
    noted = set()
    for X, y, X_test, truth, observed in folds:
        model = MODELS[method][0](*X.shape)
        if method == "SVR":  # one output at a time wants two dimensions, even for one output
            y = y.reshape(len(y), -1)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            start = time.process_time()
            model.fit(X, y)
            fit_s += time.process_time() - start
            noted |= {w.category.__name__ for w in caught}
        model = getattr(model, "best_estimator_", model)
        size += len(pickle.dumps(model))
        truth, observed = (a.reshape(len(a), -1) for a in (truth, observed))
        if method in (OURS, "GP"):
            mean, std = (a.reshape(truth.shape) for a in model.predict(X_test, return_std=True))
            for i, level in enumerate(LEVELS):
                inside = np.abs(observed - mean) <= norm.ppf(0.5 + level / 2) * std
                covered[i] += inside.mean(axis=1).sum()
        else:
            mean = model.predict(X_test).reshape(truth.shape)
        sums += np.square((mean - truth) / truth.std(axis=0)).mean(axis=1).sum()
        n_test += len(truth)
    rows = np.resize(X_test, (PREDICTED_ROWS, X_test.shape[1]))
    start = time.process_time()
    for part in np.split(rows, 10):  # kernels of all rows at once would not fit in memory
        model.predict(part)
    predict_s = time.process_time() - start
    result = {
        "error": np.sqrt(sums / n_test),
        "fit_s": fit_s,
        "predict_s": predict_s,
        "bytes": size / len(folds),
        "centers": len(model.centers_) if method == OURS else "",
        "warnings": " ".join(sorted(noted)),
    }
    if covered.any():
        result |= {f"cover{100 * p:.0f}": c / n_test for p, c in zip(LEVELS, covered, strict=True)}
    return result


FIELDS = [
    *("problem", "n", "seed", "method", "error", "fit_s", "predict_s", "bytes", "centers"),
    *(f"cover{100 * p:.0f}" for p in LEVELS),
    "warnings",
]


def run(args):
    """All runs asked for, each appended to the file as soon as it is done."""
    path, rows = Path(args.csv), []
    if path.exists():
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
    done = {(r["problem"], int(r["n"]), int(r["seed"]), r["method"]) for r in rows}
    cases = []
    for name in args.problems:
        if name not in REAL:
            cases += [(name, n, seed) for n in args.sizes for seed in range(args.seeds)]
        elif not args.quick or "panda" in name:
            cases.append((name, REAL[name][1], 0))
    for name, n, seed in cases:
        folds = None
        for method in args.peers:
            limit = MODELS[method][1]
            size = n
            if name in REAL and n is None:
                folds = folds or folds_of(name, n, seed)
                size = max(len(fold.X) for fold in folds)
            known = (name, size, seed, method) in done
            if known or (limit is not None and size > limit and not args.no_limits):
                continue
            folds = folds or folds_of(name, n, seed)
            row = {"problem": name, "n": size, "seed": seed, "method": method}
            row |= measure(method, folds)
            with path.open("a", newline="") as file:
                writer = csv.DictWriter(file, FIELDS, restval="")
                if file.tell() == 0:
                    writer.writeheader()
                writer.writerow(row)
            if args.verbose:
                print(f"{name}, {n}, {seed}, {method}: {row['error']:.4f}, {row['fit_s']:.1f} s")
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    wanted = {(name, n if name not in REAL else None) for name, n, _ in cases}
    return [
        r
        for r in rows
        if (r["problem"], None if r["problem"] in REAL else int(r["n"])) in wanted
        and r["method"] in args.peers
    ]


def table(rows, title, value, methods, relative_to=None):
    """Print one figure by problem and method: medians over seeds, or of their ratios."""
    print(f"\n{title}")
    print(f"{'problem':<20} {'n':>6} {'seeds':>5} " + "".join(f"{m:>12}" for m in methods))
    lines = {}
    for r in rows:
        by_seed = lines.setdefault((r["problem"], int(r["n"])), {})
        by_seed.setdefault(r["seed"], {})[r["method"]] = float(r[value] or "nan")
    every = {}
    for (name, n), seeds in lines.items():
        base = None
        if relative_to is not None:
            found = {m for seed in seeds.values() for m in seed}
            base = relative_to if relative_to in found else OURS
        fields = []
        for method in methods:
            figures = [
                seed[method] / (seed[base] if base else 1.0)
                for seed in seeds.values()
                if method in seed and (base is None or base in seed)
            ]
            fields.append(f"{np.median(figures):>12.4g}" if figures else f"{'-':>12}")
            if figures:
                every.setdefault((n, method), []).append(np.median(figures))
        print(f"{name:<20} {n:>6} {len(seeds):>5} " + "".join(fields))
    for n in sorted({n for n, _ in every}) if relative_to else ():
        means = (np.exp(np.log(every.get((n, m), np.nan)).mean()) for m in methods)
        print(f"{'geometric mean':<20} {n:>6} {'':>5} " + "".join(f"{m:>12.4g}" for m in means))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[300, 1000])
    names = [*REAL, *GENERATED]
    parser.add_argument("--problems", nargs="+", default=names, choices=names)
    parser.add_argument("--peers", nargs="+", default=list(MODELS), choices=list(MODELS))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--csv", default="bench_accuracy.csv", help="file of results, appended to")
    parser.add_argument("--no-limits", action="store_true", help="every peer at every size")
    parser.add_argument("--generated", action="store_true", help="no real data")
    parser.add_argument("--quick", action="store_true", help="300 rows, no large real data")
    parser.add_argument("--verbose", action="store_true", help="print every run")
    args = parser.parse_args()
    if args.quick:
        args.sizes = [300]
    if args.generated:
        args.problems = [name for name in args.problems if name not in REAL]
    if OURS not in args.peers:
        args.peers = [OURS, *args.peers]
    with threadpool_limits(1):
        rows = run(args)
    methods = [m for m in MODELS if m in args.peers]
    table(rows, "Error in standard deviations of the truth", "error", [OURS])
    table(rows, "Error relative to the Gaussian process", "error", methods, "GP")
    table(rows, "CPU time to fit, search included: ratio to RBFNet", "fit_s", methods, OURS)
    table(rows, "CPU time to fit, s", "fit_s", [OURS])
    table(rows, f"CPU time to predict {PREDICTED_ROWS} rows: ratio", "predict_s", methods, OURS)
    table(rows, "Size of the pickled model: ratio", "bytes", methods, OURS)
    table(rows, "Number of centres", "centers", [OURS])
    for level in LEVELS:
        name = f"{100 * level:.0f}"
        title = f"Share of observations inside {name} % intervals"
        table(rows, title, f"cover{name}", [m for m in (OURS, "GP") if m in methods])


if __name__ == "__main__":
    main()
