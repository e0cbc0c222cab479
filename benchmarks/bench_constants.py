"""What constants of positions cost: deviations from anything but the mean, and small offsets.

    python benchmarks/bench_constants.py

Simulated single-point tests of three kinds of arms. Deviations are taken from the mean, the median,
the first or the last row of each position, and constants of 0 to 0.008 mm a coordinate are added to
the errors of a tracker. Printed is what the model leaves at eight other positions: 2S, mm, and of
the tracker's arms the mean deviation from the truth.
"""

import argparse
import warnings

import numpy as np

from sklearn_raacmm import ArmResidualRegressor
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.metrics import single_point_repeatability

MIXES = ("typical", "gravity", "eccentricity")
FROM = {
    "mean": lambda y: y.mean(axis=0),
    "median": lambda y: np.median(y, axis=0),
    "first row": lambda y: y[0],
    "last row": lambda y: y[-1],
}
CONSTANTS_MM = (0.0, 0.002, 0.004, 0.008, 0.05)


def left_of(test, y, train, truth=None):
    """What a model of y leaves at the other positions, mm."""
    model = ArmResidualRegressor(test.arm)
    model.fit(test.data[train], y[train], groups=test.groups[train])
    correction = model.predict(test.data[~train])
    if truth is not None:
        return float(np.linalg.norm(truth[~train] - correction, axis=1).mean())
    left = test.points[~train] - correction
    return float(single_point_repeatability(left, test.groups[~train]))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    print("deviations from" + "".join(f"{name:>11}" for name in FROM))
    for mix in MIXES:
        for seed in range(options.seeds):
            test = make_single_point(20, 15, machine=mix, random_state=seed)
            train, cells = test.groups < 12, []
            for origin in FROM.values():
                y = test.points.copy()
                for group in np.unique(test.groups):
                    rows = test.groups == group
                    y[rows] -= origin(y[rows])
                cells.append(left_of(test, y, train))
            print(f"{mix:15}" + "".join(f"{cell:11.4f}" for cell in cells), flush=True)
    print("constants, mm  " + "".join(f"{size:>11g}" for size in CONSTANTS_MM))
    for mix in MIXES:
        for seed in range(options.seeds):
            test = make_single_point(20, 15, machine=mix, random_state=seed)
            truth = test.points - test.simulation.true_points
            drawn = np.random.default_rng(seed).normal(size=(20, 3))[test.groups]
            train = test.groups < 12
            cells = [left_of(test, truth + c * drawn, train, truth) for c in CONSTANTS_MM]
            print(f"{mix:15}" + "".join(f"{cell:11.4f}" for cell in cells), flush=True)


if __name__ == "__main__":
    main()
