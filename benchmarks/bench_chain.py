"""What positions are worth to the chain.

Every regressor of the chain is fitted twice: with ``fit(X, y, groups=positions)``, which names the
rows of one position, and with ``groups=False``. On simulated arms it learns at some positions and
is judged at twenty others by the mean 2S that its correction leaves; on real arms at placements
(UR10: goals) left out. The table has what is left, as a share of what there was, and the ratio of
both fits. Settings are the same for both.

The default, the network on twelve simulated arms and the real ones, takes about ten CPU minutes;
``--models`` measures the others.

``--slips`` and ``--few``: simulated arms with cones to learn from and twelve others, the network of
three inputs. Slips: of 12 cones x 30 poses 1 to 5 % of the rows are moved by 1 mm in a random
direction; the network is also fitted to the other rows alone. Few: 10 x 12, 8 x 20 and 12 x 100
poses, beside scikit-learn's process. Printed is the mean 2S at the other cones, in um.
"""

import argparse
import warnings
from itertools import product

import numpy as np
from _comparison import ALL, INPUTS, PAPER, chain, gaussian_process
from _data_sets import MIXES, panda, ur10
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.kernel_ridge import KernelRidge
from sklearn.multioutput import MultiOutputRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    position_residuals,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.metrics import single_point_repeatability
from sklearn_raacmm.residuals import bp_network_chain, database_chain, polynomial_chain

# Positions that are learnt from, and poses at each of them.
SHAPES = [(10, 60), (30, 20)]
TEST_POSITIONS, TEST_POSES = 20, 20
N_OTHERS, OTHER_POSES, SLIP = 12, 30, 1.0  # of dirty and of few rows; mm
SIZES = ((10, 12), (8, 20), (12, 100))
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


def cones(seed, n_positions, n_poses):
    """Test of an arm, rows to learn from, and rows of other cones."""
    test = make_single_point(n_positions + N_OTHERS, max(n_poses, OTHER_POSES), random_state=seed)
    place = np.arange(len(test.groups)) % max(n_poses, OTHER_POSES)
    # Drawn: their order is that of the distance from the base.
    chosen = np.random.default_rng(seed).permutation(n_positions + N_OTHERS)[:n_positions]
    inside = np.isin(test.groups, chosen)
    return test, np.flatnonzero(inside & (place < n_poses)), np.flatnonzero(~inside)


def process():
    """Scikit-learn's process of each output, with a width for each feature."""
    kernel = ConstantKernel() * RBF(np.ones(3), (1e-2, 1e3)) + WhiteKernel(0.1, (1e-8, 1e2))
    one = GaussianProcessRegressor(kernel, normalize_y=True, n_restarts_optimizer=1, random_state=0)
    return MultiOutputRegressor(one)


def left_um(test, regressor, X, points, groups, others, labelled):
    """Mean 2S at other cones of a chain of the three inputs, fitted to some points."""
    inner = make_pipeline(PoseFeatures(test.arm), StandardScaler(), regressor)
    chain = CylindricalResidualTarget(inner, azimuth=test.arm.azimuth)
    labels = {"rbfnetregressor__groups": groups} if labelled else {}
    chain.fit(X, position_residuals(points, groups), **labels)
    corrected = test.points[others] - chain.predict(test.data[others])
    return 1e3 * np.mean(single_point_repeatability(corrected, test.groups[others]))


def slips(n_arms=5, draws=4):
    """Print a line of each draw, and how often a limit is passed."""
    ratios = []
    for seed in range(n_arms):
        test, learn, others = cones(seed, 12, 30)
        none = 1e3 * np.mean(single_point_repeatability(test.points[others], test.groups[others]))
        for draw in range(draws):
            rng = np.random.default_rng([seed, draw])
            share = rng.uniform(0.01, 0.05)
            slipped = rng.permutation(len(learn))[: max(1, round(share * len(learn)))]
            points, groups = test.points[learn].copy(), test.groups[learn]
            way = rng.standard_normal((len(slipped), 3))
            points[slipped] += SLIP * way / np.linalg.norm(way, axis=1, keepdims=True)
            good = np.setdiff1d(np.arange(len(learn)), slipped)
            found = [
                left_um(test, RBFNetRegressor(random_state=0), test.data[learn][rows],
                        points[rows], groups[rows], others, True)
                for rows in (np.arange(len(learn)), good)
            ]  # fmt: skip
            ratios.append((found[0] / none, found[0] / found[1]))
            shown = f"none {none:.1f}, network {found[0]:.1f}, without these rows {found[1]:.1f}"
            print(f"arm {seed}, {len(slipped)} of {len(learn)} slipped: {shown}", flush=True)
    over_none, over_clean = np.transpose(ratios)
    print(
        f"worst over none {over_none.max():.3f}, above 1.02: {np.sum(over_none > 1.02)}; ", end=""
    )
    print(f"over clean rows {over_clean.max():.3f}, above 1.1: {np.sum(over_clean > 1.1)}")


def few(n_arms=8):
    """Print 2S of every arm, and the ratios to the process."""
    for size in SIZES:
        ratios = []
        for seed in range(n_arms):
            test, learn, others = cones(seed, *size)
            none = np.mean(single_point_repeatability(test.points[others], test.groups[others]))
            rows = test.data[learn], test.points[learn], test.groups[learn], others
            ours = left_um(test, RBFNetRegressor(random_state=0), *rows, True)
            peer = left_um(test, process(), *rows, False)
            ratios.append(ours / peer)
            shown = f"none {1e3 * none:.1f}, network {ours:.1f}, process {peer:.1f}"
            print(f"{size[0]} x {size[1]}, arm {seed}: {shown}", flush=True)
        mean = np.exp(np.mean(np.log(ratios)))
        print(f"{size[0]} x {size[1]}: over the process {mean:.3f}, worst {max(ratios):.3f}")


def main(argv=None):
    """Print the table, and medians over arms."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", nargs="*", type=int, default=[50, 51, 52, 53])
    parser.add_argument("--shapes", nargs="*", type=int, default=[0, 1], choices=[0, 1])
    parser.add_argument("--models", nargs="*", default=["RBF network"], choices=list(MODELS))
    parser.add_argument("--real", nargs="*", default=REAL, choices=REAL)
    parser.add_argument("--data-home", help="folder of real data (default: scikit-learn's)")
    parser.add_argument("--slips", action="store_true", help="rows that slipped by 1 mm")
    parser.add_argument("--few", action="store_true", help="few poses, beside a process")
    args = parser.parse_args(argv)
    if args.slips or args.few:
        warnings.simplefilter("ignore")
        return slips() if args.slips else few()
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
