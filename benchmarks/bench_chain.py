"""What positions are worth to the chain.

Every regressor of the chain is fitted twice: with ``fit(X, y, groups=positions)``, which names the
rows of one position, and with ``groups=False``. On simulated arms it learns at some positions and
is judged at twenty others by the mean 2S that its correction leaves; on real arms at placements
(UR10: goals) left out. The table has what is left, as a share of what there was, and the ratio of
both fits. Settings are the same for both.

The default, the network on twelve simulated arms and the real ones, takes about ten CPU minutes;
``--models`` measures the others.
"""

import argparse
import warnings
from itertools import product

import numpy as np
from _comparison import ALL, INPUTS, PAPER, chain, gaussian_process
from _data_sets import MIXES, panda, ur10
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.kernel_ridge import KernelRidge

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.metrics import single_point_repeatability
from sklearn_raacmm.residuals import bp_network_chain, database_chain, polynomial_chain

# Positions that are learnt from, and poses at each of them.
SHAPES = [(10, 60), (30, 20)]
TEST_POSITIONS, TEST_POSES = 20, 20
REAL = ["panda_3", "panda_2", "ur10"]


# Plain settings, the same for both fits.
MODELS = {
    "RBF network": lambda arm, inputs: chain(arm, RBFNetRegressor(random_state=0), inputs),
    "polynomial": lambda arm, inputs: polynomial_chain(
        arm, degree=3 if inputs == PAPER else 2, **INPUTS[inputs]
    ),
    "database": lambda arm, inputs: database_chain(arm, **INPUTS[inputs]),
    "BP network": lambda arm, inputs: bp_network_chain(arm, random_state=0, **INPUTS[inputs]),
    "Gaussian process": gaussian_process,
    "kernel ridge": lambda arm, inputs: chain(
        arm,
        KernelRidge(kernel="rbf", alpha=0.1, gamma=1 / (2 * (1 if inputs == PAPER else 4) ** 2)),
        inputs,
    ),
    "extra trees": lambda arm, inputs: chain(
        arm, ExtraTreesRegressor(100, min_samples_leaf=5, random_state=0), inputs
    ),
}


def simulated(mix, seed, n_positions, n_poses):
    """One fold of one arm: what is learnt from, and what is judged."""
    n = n_positions + TEST_POSITIONS
    test = make_single_point(n, max(n_poses, TEST_POSES), machine=mix, random_state=seed)
    rng = np.random.default_rng(seed)
    order = rng.permutation(n)

    def some(labels, many):
        rows = [np.flatnonzero(test.groups == g) for g in labels]
        return np.concatenate([rng.permutation(part)[:many] for part in rows])

    learn, rest = some(order[:n_positions], n_poses), some(order[n_positions:], TEST_POSES)
    # Deviations from the mean of the poses that were drawn.
    codes = np.unique(test.groups[learn], return_inverse=True)[1]
    means = np.array([test.points[learn][codes == c].mean(axis=0) for c in range(n_positions)])
    y = test.points[learn] - means[codes]
    return [(test.arm, test.data[learn], y, codes, test.data[rest], test.points[rest])], [
        test.groups[rest]
    ]


def real(name, data_home):
    """The folds of a real arm."""
    problem = ur10(1500, data_home) if name == "ur10" else panda(name, data_home)
    folds = [
        (f.arm, f.angles[f.learn], f.residuals[f.learn], f.positions[f.learn], f.angles[f.test], m)
        for f, m in zip(problem.folds, problem.measured, strict=True)
    ]
    return folds, [f.positions[f.test] for f in problem.folds], problem.folds[0].absolute


def left(folds, labels, absolute, model=None, known=False):
    """Mean 2S of what is left, or mean distance from the truth where it is known, mm."""
    rests = []
    for arm, X, y, groups, T, measured in folds:
        if model is None:
            rests.append(measured)
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # widths at their bounds, perceptrons stopped early
            fitted = model(arm).fit(X, y, groups=groups if known else False)
        rests.append(fitted.correct(T, measured))
    rest = np.concatenate(rests)
    if absolute:
        return np.linalg.norm(rest, axis=1).mean()
    return single_point_repeatability(rest, np.concatenate(labels))


def main(argv=None):
    """Print the table, and medians over arms."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", nargs="*", type=int, default=[50, 51, 52, 53])
    parser.add_argument("--shapes", nargs="*", type=int, default=[0, 1], choices=[0, 1])
    parser.add_argument("--models", nargs="*", default=["RBF network"], choices=list(MODELS))
    parser.add_argument("--real", nargs="*", default=REAL, choices=REAL)
    parser.add_argument("--data-home", help="folder of real data (default: scikit-learn's)")
    args = parser.parse_args(argv)
    print(f"{'inputs':<25} {'data':<27} {'regressor':<19} without  with   ratio")
    ratios = {}

    def show(kind, label, folds, labels, absolute):
        before = left(folds, labels, absolute)
        for name, inputs in product(args.models, (PAPER, ALL)):

            def model(arm, name=name, inputs=inputs):
                return MODELS[name](arm, inputs)

            both = [left(folds, labels, absolute, model, known) / before for known in (False, True)]
            row = f"{inputs:<25} {label:<27} {name:<19} {both[0]:7.3f} {both[1]:6.3f}"
            print(f"{row} {both[1] / both[0]:6.3f}", flush=True)
            ratios.setdefault((name, inputs, kind), []).append(both)

    for shape, mix in product(args.shapes, MIXES):
        n_positions, n_poses = SHAPES[shape]
        kind = f"{mix}, {n_positions} x {n_poses}"
        for seed in args.seeds:
            found = simulated(mix, seed, n_positions, n_poses)
            show(kind, f"{kind}, {seed}", *found, absolute=False)
    for name in args.real:
        show(name, name, *real(name, args.data_home))
    for (name, inputs, kind), found in ratios.items():
        without, with_them = np.median(found, axis=0)
        row = f"{inputs:<25} {f'median, {kind}':<27} {name:<19}"
        print(f"{row} {without:7.3f} {with_them:6.3f}")


if __name__ == "__main__":
    main()
