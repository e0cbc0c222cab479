"""
What `groups` do to a network
=============================

A network is told which poses are of one position, or is not, on simulated arms that no page of
results shows. It learns at some positions and is judged at twenty others: by the mean 2S that its
correction leaves, and by the share of deviations from a position's mean that lie in the 95 %
intervals. These follow from `return_cov`, because a deviation has no part in what all poses of its
position have in common.

The default takes about three CPU minutes.
"""

import argparse

import numpy as np
from _comparison import ALL, INPUTS, PAPER, Table
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import PoseFeatures, RBFNetRegressor, cartesian_to_cylindrical
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.metrics import single_point_repeatability

MIXES = ["gravity", "typical", "eccentricity"]
# Positions that are learnt from, and poses at each of them.
SHAPES = [(9, 40), (30, 10)]
TEST_POSITIONS, TEST_POSES = 20, 20


def some_poses(groups, labels, n, rng):
    """Rows of some positions, n of each."""
    return np.concatenate([rng.permutation(np.flatnonzero(groups == g))[:n] for g in labels])


def split(mix, seed, n_positions, n_poses):
    """The test, the rows that are learnt from, and those that are judged."""
    n = n_positions + TEST_POSITIONS
    test = make_single_point(n, max(n_poses, TEST_POSES), machine=mix, random_state=seed)
    rng = np.random.default_rng(seed)
    order = rng.permutation(n)
    learn = some_poses(test.groups, order[:n_positions], n_poses, rng)
    return test, learn, some_poses(test.groups, order[n_positions:], TEST_POSES, rng)


def targets(test, rows):
    """Residuals from the mean point of each position, in the frame of the azimuth, mm."""
    points, groups = test.points[rows], test.groups[rows]
    centred = points - np.array([points[groups == g].mean(axis=0) for g in groups])
    return cartesian_to_cylindrical(centred, test.arm.azimuth(test.data[rows]))


def judged(model, X, Y, groups):
    """Mean 2S of what is left, mm, and share of its deviations inside the 95 % intervals."""
    inside = []
    for g in np.unique(groups):
        mean, covariance = model.predict(X[groups == g], return_cov=True)
        centring = np.eye(len(mean)) - 1 / len(mean)
        variance = np.einsum("ij,jko,ik->io", centring, covariance, centring)
        inside.append(np.abs(centring @ (Y[groups == g] - mean)) < 1.96 * np.sqrt(variance))
    return single_point_repeatability(Y - model.predict(X), groups), np.mean(inside)


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description="What groups do to a network.")
    parser.add_argument("--seeds", nargs="*", type=int, default=[29, 30, 31])
    parser.add_argument("--machine", nargs="*", default=MIXES, choices=MIXES)
    args = parser.parse_args()
    columns = [("inputs", 24, ""), ("arm", 12, ""), ("seed", 4, "d"), ("positions", 9, "d")]
    columns += [("2S without", 10, ".4f"), ("with", 6, ".4f"), ("ratio", 5, ".3f")]
    columns += [("inside", 6, ".3f"), ("with", 6, ".3f"), ("constants, mm", 13, ".4f")]
    table, ratios = Table(*columns), {}
    for inputs in (PAPER, ALL):
        for mix in args.machine:
            for shape in SHAPES:
                for seed in args.seeds:
                    test, learn, rest = split(mix, seed, *shape)
                    features = make_pipeline(
                        PoseFeatures(test.arm, **INPUTS[inputs]), StandardScaler()
                    ).fit(test.data[learn])
                    X, Y = features.transform(test.data[learn]), targets(test, learn)
                    rows = features.transform(test.data[rest]), targets(test, rest)
                    without, told = (
                        RBFNetRegressor(random_state=0).fit(X, Y, groups=groups)
                        for groups in (None, test.groups[learn])
                    )
                    before, inside = judged(without, *rows, test.groups[rest])
                    after, inside_told = judged(told, *rows, test.groups[rest])
                    ratios.setdefault((inputs, mix, shape), []).append(after / before)
                    table.row(
                        *(inputs, mix, seed, shape[0], before, after, after / before),
                        *(inside, inside_told, np.sqrt(np.mean(told.group_std_**2))),
                    )
    print("\nGeometric mean and largest ratio")
    for (inputs, mix, shape), found in ratios.items():
        mean = np.exp(np.mean(np.log(found)))
        print(f"{inputs:24}  {mix:12}  {shape[0]:2d} positions  {mean:.3f}  {max(found):.3f}")


if __name__ == "__main__":
    main()
