"""Accuracy, time and size of RBFNetRegressor() beside a Gaussian process and tuned peers.

Ten generated problems with noise. Every peer gets standardised inputs and targets; the Gaussian
process has one width a feature, white noise and two restarts, above 1000 rows none, but a start
from what it found on the first 1000; kernel ridge, Nystroem with ridge, support vectors and the
perceptron are tuned by a grid search with three folds, of about as many candidates as their authors
would call thorough. RBFNetRegressor gets the data as they are and no setting at all; "shared" has
one network for all outputs. One thread throughout.

Error is the root mean square over test rows of prediction less truth, in units of the truth's
standard deviation, joined over outputs. Ratios are medians over seeds of peer / RBFNetRegressor,
but for the errors, which are given relative to the Gaussian process where it was run.

    python benchmarks/bench_accuracy.py --sizes 300 1000 --seeds 3
"""

import argparse
import time
import warnings
from itertools import product

import numpy as np
from _problems import GENERATED, generated
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

OURS = ("RBFNet", "RBFNet, shared")
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


# With the largest number of rows at which each is tried.
MODELS = {
    "RBFNet": (lambda n, d: RBFNetRegressor(random_state=0), None),
    "RBFNet, shared": (lambda n, d: RBFNetRegressor(shared=True, random_state=0), None),
    "GP": (gaussian_process, 3000),
    "KernelRidge": (kernel_ridge, 3000),
    "Nystroem": (nystroem, None),
    "SVR": (support_vectors, 3000),
    "MLP": (perceptron, 3000),
}


def measure(method, problem):
    """Fit and judge: error, CPU seconds, centres, and shares inside intervals."""
    X, y, X_test, truth, observed = problem
    model = MODELS[method][0](*X.shape)
    if method == "SVR":  # one output at a time wants two dimensions, even for one output
        y = y.reshape(len(y), -1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # widths at their bounds, perceptrons stopped early
        start = time.process_time()
        model.fit(X, y)
        found = {"fit_s": time.process_time() - start}
    model = getattr(model, "best_estimator_", model)
    truth, observed = (a.reshape(len(a), -1) for a in (truth, observed))
    if method in (*OURS, "GP"):
        mean, std = (a.reshape(truth.shape) for a in model.predict(X_test, return_std=True))
        error = np.abs(observed - mean)
        for level in LEVELS:
            found[level] = np.mean(error <= norm.ppf(0.5 + level / 2) * std)
    mean = model.predict(X_test).reshape(truth.shape)
    found["error"] = np.sqrt(np.mean(np.square((mean - truth) / truth.std(axis=0))))
    rows = np.resize(X_test, (PREDICTED_ROWS, X_test.shape[1]))
    start = time.process_time()
    for part in np.split(rows, 10):  # kernels of all rows at once would not fit in memory
        model.predict(part)
    found["predict_s"] = time.process_time() - start
    if method in OURS:
        found["centers"] = len(model.centers_)
    return found


def run(args):
    """Print every run, and return its figures."""
    rows = []
    for name, n, seed in product(args.problems, args.sizes, range(args.seeds)):
        for method in args.peers:
            if n <= (MODELS[method][1] or n):
                figures = measure(method, generated(name, n, seed))
                rows.append({"problem": name, "n": n, "method": method} | figures)
                print(f"{name}, {n}, {seed}, {method}: {figures['error']:.4f}", flush=True)
    return rows


def table(rows, title, value, methods, relative_to=None):
    """Print one figure by problem and method: medians over seeds, or of their ratios."""
    print(f"\n{title}\n{'problem':<20} {'n':>6} " + "".join(f"{m:>12}" for m in methods))
    lines, means = {}, {}
    for row in rows:
        line = lines.setdefault((row["problem"], row["n"]), {})
        line.setdefault(row["method"], []).append(row.get(value, np.nan))
    for (name, n), line in lines.items():
        base = np.array(line.get(relative_to, line[OURS[0]])) if relative_to else 1.0
        found = [np.median(np.divide(line[m], base)) if m in line else np.nan for m in methods]
        means.setdefault(n, []).append(found)
        print(f"{name:<20} {n:>6} " + "".join(f"{figure:>12.4g}" for figure in found))
    for n, found in means.items() if relative_to else ():
        mean = np.exp(np.log(found).mean(axis=0))
        print(f"{'geometric mean':<20} {n:>6} " + "".join(f"{figure:>12.4g}" for figure in mean))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[300, 1000])
    names = list(GENERATED)
    parser.add_argument("--problems", nargs="+", default=names, choices=names)
    parser.add_argument("--peers", nargs="+", default=list(MODELS), choices=list(MODELS))
    parser.add_argument("--seeds", type=int, default=1)
    args = parser.parse_args()
    args.peers = [OURS[0], *(name for name in args.peers if name != OURS[0])]
    with threadpool_limits(1):
        rows = run(args)
    methods = args.peers
    table(rows, "Error in standard deviations of the truth", "error", OURS[:1])
    table(rows, "Error relative to the Gaussian process", "error", methods, "GP")
    table(rows, "CPU time to fit, search included: ratio to RBFNet", "fit_s", methods, OURS[0])
    table(rows, f"CPU time to predict {PREDICTED_ROWS} rows: ratio", "predict_s", methods, OURS[0])
    table(rows, "Number of centres", "centers", OURS[:1])
    for level in LEVELS:
        title = f"Share of observations inside {100 * level:.0f} % intervals"
        table(rows, title, level, [m for m in (OURS[0], "GP") if m in methods])


if __name__ == "__main__":
    main()
