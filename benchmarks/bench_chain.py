"""What positions are worth to the chain, and its network on dirty and on few rows.

    python benchmarks/bench_chain.py --slips

The network is fitted twice: with ``fit(X, y, groups=positions)``, and with ``groups=False``. On
simulated arms it learns at some positions and is judged at twenty others by the mean 2S that its
correction leaves; on real arms at placements left out. Printed is what is left, as a share of what
there was, and the ratio of both fits. It takes ten CPU minutes.

``--slips`` and ``--few``: mean 2S at twelve other cones, um, of a network of three inputs. Slips:
1 to 5 % of 12 x 30 poses are moved by 1 mm; the network is also fitted to the other rows alone.
Few: 10 x 12, 8 x 20 and 12 x 100 poses, beside scikit-learn's process; also of arms whose encoders
alone err, of which three inputs show next to nothing.
"""

import argparse
import warnings
from functools import partial
from itertools import product

import numpy as np
from _arm_folds import MIXES, geometric
from _data_sets import panda
from _regressors import ALL, PAPER, chain
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
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

# Positions that are learnt from, and poses at each of them.
SHAPES = [(10, 60), (30, 20)]
TEST_POSITIONS, TEST_POSES = 20, 20
N_OTHERS, OTHER_POSES, SLIP = 12, 30, 1.0  # of dirty and of few rows; mm
SIZES = ((10, 12), (8, 20), (12, 100))
MACHINES = ("typical", "eccentricity")
REAL = ["panda_3", "panda_2"]


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
    y = position_residuals(test.points[learn], codes)
    fold = test.arm, test.data[learn], y, codes, test.data[rest], test.points[rest]
    return [fold], [test.groups[rest]]


def real(name, data_home):
    problem = panda(name, data_home)
    folds = [
        (f.arm, f.angles[f.learn], f.residuals[f.learn], f.positions[f.learn], f.angles[f.test], m)
        for f, m in zip(problem.folds, problem.measured, strict=True)
    ]
    return folds, [f.positions[f.test] for f in problem.folds]


def left(folds, labels, model=None, known=False):
    """Mean 2S of what is left, mm."""
    rests = []
    for arm, X, y, groups, T, measured in folds:
        if model is None:
            rests.append(measured)
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # widths at their bounds, perceptrons stopped early
            fitted = model(arm).fit(X, y, groups=groups if known else False)
        rests.append(fitted.correct(T, measured))
    return single_point_repeatability(np.concatenate(rests), np.concatenate(labels))


def cones(seed, n_positions, n_poses, machine="typical"):
    """Test of an arm, rows to learn from, and rows of other cones."""
    size = n_positions + N_OTHERS, max(n_poses, OTHER_POSES)
    test = make_single_point(*size, machine=machine, random_state=seed)
    rng = np.random.default_rng(seed)
    # Drawn: the order of cones is that of the distance from the base, and the order of poses that
    # of the swing, of which the first ones show a part.
    chosen = rng.permutation(size[0])[:n_positions]
    place = np.concatenate([rng.permutation(size[1]) for _ in range(size[0])])
    inside = np.isin(test.groups, chosen)
    return test, np.flatnonzero(inside & (place < n_poses)), np.flatnonzero(~inside)


def left_um(test, others, regressor, rows=(), points=None):
    """Mean 2S at other cones, um, of a chain of the three inputs that is fitted to some points."""
    corrected = test.points[others]
    if regressor is not None:
        inner = make_pipeline(PoseFeatures(test.arm), StandardScaler(), regressor)
        model = CylindricalResidualTarget(inner, azimuth=test.arm.azimuth)
        groups = test.groups[rows]
        labelled = isinstance(regressor, RBFNetRegressor)
        labels = {"rbfnetregressor__groups": groups} if labelled else {}
        model.fit(test.data[rows], position_residuals(points, groups), **labels)
        corrected = corrected - model.predict(test.data[others])
    return 1e3 * np.mean(single_point_repeatability(corrected, test.groups[others]))


def slips():
    ratios = []
    for seed, draw in product(range(5), range(4)):
        test, learn, others = cones(seed, 12, 30)
        none = left_um(test, others, None)
        rng = np.random.default_rng([seed, draw])
        share = rng.uniform(0.01, 0.05)
        slipped = learn[rng.permutation(len(learn))[: max(1, round(share * len(learn)))]]
        points = test.points.copy()
        way = rng.standard_normal((len(slipped), 3))
        points[slipped] += SLIP * way / np.linalg.norm(way, axis=1, keepdims=True)
        of_all, of_good = (
            left_um(test, others, RBFNetRegressor(random_state=0), rows, points[rows])
            for rows in (learn, np.setdiff1d(learn, slipped))
        )
        ratios.append((of_all / none, of_all / of_good))
        shown = f"none {none:.1f}, network {of_all:.1f}, without these rows {of_good:.1f}"
        print(f"arm {seed}, {len(slipped)} of {len(learn)} slipped: {shown}", flush=True)
    limits = {"none": 1.02, "clean rows": 1.1}
    for (what, limit), found in zip(limits.items(), np.transpose(ratios), strict=True):
        print(f"worst over {what} {found.max():.3f}, above {limit}: {np.sum(found > limit)}")


def few(seeds, machines):
    kernel = ConstantKernel() * RBF(np.ones(3), (1e-2, 1e3)) + WhiteKernel(0.1, (1e-8, 1e2))
    peer = GaussianProcessRegressor(
        kernel, normalize_y=True, n_restarts_optimizer=1, random_state=0
    )
    for size, machine in product(SIZES, machines):
        ratios = []
        for seed in seeds:
            test, learn, others = cones(seed, *size, machine)
            regressors = None, RBFNetRegressor(random_state=0), MultiOutputRegressor(peer)
            left = [left_um(test, others, r, learn, test.points[learn]) for r in regressors]
            ratios.append((left[1] / left[0], left[1] / left[2]))
            shown = "none {:.1f}, network {:.1f}, process {:.1f}".format(*left)
            print(f"{size[0]} x {size[1]}, {machine} arm {seed}: {shown}", flush=True)
        of_none, of_process = map(geometric, np.transpose(ratios))
        shown = f"over none (worst) {of_none}, over the process {of_process}"
        print(f"{size[0]} x {size[1]}, {machine}: {shown}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", nargs="*", type=int, help="default 50 to 53; of --few 0 to 7")
    parser.add_argument("--shapes", nargs="*", type=int, default=[0, 1], choices=[0, 1])
    parser.add_argument("--real", nargs="*", default=REAL, choices=REAL)
    parser.add_argument("--data-home", help="folder of real data (default: scikit-learn's)")
    parser.add_argument("--slips", action="store_true", help="rows that slipped by 1 mm")
    parser.add_argument("--few", action="store_true", help="few poses, beside a process")
    parser.add_argument(
        "--machines", nargs="*", default=MACHINES, choices=MACHINES, help="of --few"
    )
    args = parser.parse_args()
    if args.slips or args.few:
        warnings.simplefilter("ignore")
        return slips() if args.slips else few(args.seeds or range(8), args.machines)
    ratios = {}
    data = [
        (f"{mix}, {SHAPES[shape][0]} x {SHAPES[shape][1]}", simulated, (mix, seed, *SHAPES[shape]))
        for shape, mix, seed in product(args.shapes, MIXES, args.seeds or range(50, 54))
    ]
    data += [(name, real, (name, args.data_home)) for name in args.real]
    for kind, make, how in data:
        folds = make(*how)
        before = left(*folds)
        for inputs in (PAPER, ALL):
            model = partial(chain, regressor=RBFNetRegressor(random_state=0), inputs=inputs)
            both = [left(*folds, model, known) / before for known in (False, True)]
            ratios.setdefault((inputs, kind), []).append(both)
            shares = f"without {both[0]:.3f}, with {both[1]:.3f}, ratio {both[1] / both[0]:.3f}"
            print(f"{', '.join(map(str, how))}, {inputs}: {shares}", flush=True)
    for (inputs, kind), found in ratios.items():
        without, with_them = np.median(found, axis=0)
        print(f"median, {kind}, {inputs}: without {without:.3f}, with {with_them:.3f}")


if __name__ == "__main__":
    main()
