"""The published chain on few and on dirty rows: simulated arms, beside a process and no correction.

    python benchmarks/bench_dirty_rows.py --slips           # rows that slipped by 1 mm
    python benchmarks/bench_dirty_rows.py --few             # 10 x 12, 8 x 20 and 12 x 100 poses
    python benchmarks/bench_dirty_rows.py --slips --loss squared

Every arm has cones to learn from and twelve others. Three pose inputs, or all joints (--joints),
go to a network and to scikit-learn's process, both in the frame of the probe's azimuth; positions
are known to the network by `groups`. Printed is the mean 2S at the other cones, in um.

Slips: of 12 cones x 30 poses 1 to 5 % of the rows are moved by 1 mm in a random direction, before
residuals from the mean of a position are taken. The network is also fitted to the other rows alone.
"""

import argparse
import os
import warnings

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import numpy as np
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

N_TEST, TEST_POSES, SLIP = 12, 30, 1.0
SIZES = ((10, 12), (8, 20), (12, 100))


def cones(seed, n_positions, n_poses):
    """Test of an arm, rows to learn from, and rows of other cones."""
    test = make_single_point(n_positions + N_TEST, max(n_poses, TEST_POSES), random_state=seed)
    place = np.arange(len(test.groups)) % max(n_poses, TEST_POSES)
    # Drawn: their order is that of the distance from the base.
    chosen = np.random.default_rng(seed).permutation(n_positions + N_TEST)[:n_positions]
    inside = np.isin(test.groups, chosen)
    return test, np.flatnonzero(inside & (place < n_poses)), np.flatnonzero(~inside)


def process():
    """Scikit-learn's process of each output, with a width for each feature."""
    kernel = ConstantKernel() * RBF(np.ones(3), (1e-2, 1e3)) + WhiteKernel(0.1, (1e-8, 1e2))
    one = GaussianProcessRegressor(kernel, normalize_y=True, n_restarts_optimizer=1, random_state=0)
    return MultiOutputRegressor(one)


def left(test, regressor, joints, X, points, groups, others, labelled):
    """Mean 2S at other cones of a chain fitted to some points."""
    inputs = {"joints": "all", "encoding": "periodic"} if joints else {}
    inner = make_pipeline(PoseFeatures(test.arm, **inputs), StandardScaler(), regressor)
    chain = CylindricalResidualTarget(inner, azimuth=test.arm.azimuth)
    labels = {"rbfnetregressor__groups": groups} if labelled else {}
    chain.fit(X, position_residuals(points, groups), **labels)
    corrected = test.points[others] - chain.predict(test.data[others])
    return 1e3 * np.mean(single_point_repeatability(corrected, test.groups[others]))


def slips(seeds, draws, network, joints, labelled):
    """Print a line of each draw, and how often a limit is passed."""
    ratios = []
    for seed in seeds:
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
                left(test, network(), joints, test.data[learn][rows], points[rows], groups[rows],
                     others, labelled)
                for rows in (np.arange(len(learn)), good)
            ]  # fmt: skip
            ratios.append((found[0] / none, found[0] / found[1]))
            print(
                f"arm {seed}, {len(slipped)} of {len(learn)} slipped: none {none:.1f}, network "
                f"{found[0]:.1f}, without these rows {found[1]:.1f}",
                flush=True,
            )
    over_none, over_clean = np.transpose(ratios)
    print(
        f"worst over none {over_none.max():.3f}, over the fit without slipped rows "
        f"{over_clean.max():.3f}; above 1.02: {np.sum(over_none > 1.02)}, above 1.1: "
        f"{np.sum(over_clean > 1.1)} of {len(ratios)}"
    )


def few(seeds, network, joints):
    """Print 2S of every arm, and the ratios to the process."""
    for size in SIZES:
        ratios = []
        for seed in seeds:
            test, learn, others = cones(seed, *size)
            none = np.mean(single_point_repeatability(test.points[others], test.groups[others]))
            rows = test.data[learn], test.points[learn], test.groups[learn], others
            ours = left(test, network(), joints, *rows, True)
            peer = left(test, process(), joints, *rows, False)
            ratios.append(ours / peer)
            print(
                f"{size[0]} x {size[1]}, arm {seed}: none {1e3 * none:.1f}, network {ours:.1f}, "
                f"process {peer:.1f}",
                flush=True,
            )
        mean = np.exp(np.mean(np.log(ratios)))
        print(f"{size[0]} x {size[1]}: over the process {mean:.3f}, worst {max(ratios):.3f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--slips", action="store_true")
    parser.add_argument("--few", action="store_true")
    parser.add_argument("--joints", action="store_true", help="all joints instead of the pose")
    parser.add_argument("--no-labels", action="store_true", help="slips without groups")
    parser.add_argument("--arms", type=int, nargs="+", default=None)
    parser.add_argument("--draws", type=int, default=4, help="of slips, for each arm")
    parser.add_argument("--loss", help="of the network")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    options = {"random_state": 0} | ({"loss": args.loss} if args.loss else {})

    def network():
        return RBFNetRegressor(**options)

    if args.slips:
        slips(args.arms or range(5), args.draws, network, args.joints, not args.no_labels)
    if args.few:
        few(args.arms or range(8), network, args.joints)


if __name__ == "__main__":
    main()
