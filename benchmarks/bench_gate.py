"""What the gate does for data that are not as they should be, on simulated arms.

    python benchmarks/bench_gate.py [dwells] [slips] [constants] [set-ups] [update]

``dwells``: 90 poses of which a logger wrote 100 rows each, beside one row a pose. ``slips``: one
pose of each position is 1 mm off; a network and the arm's model with means with and without them.
``constants``: references that are off by a constant in each position. ``set-ups``: a tracker or a
target that moved half way. ``update``: new poses with one mistake. Simulated data throughout, mean
distances in um at positions that no fit has seen.
"""

import sys
import warnings
from collections import Counter

import numpy as np
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    calibrate,
    position_residuals,
    update_correction,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.utils import centred

MACHINES = ("typical", "gravity", "eccentricity")


def um(vectors):
    """Mean length in micrometres."""
    return f"{1e3 * np.linalg.norm(vectors, axis=1).mean():.1f}"


def halves(test, n_new):
    """Rows of the positions that are fitted, and of the others."""
    new = test.groups >= test.groups.max() + 1 - n_new
    return ~new, new


def dwells():
    for seed in range(2):
        test = make_single_point(19, 10, random_state=seed)
        train, new = halves(test, 10)
        truth = test.points - test.simulation.true_points
        rng = np.random.default_rng(seed)
        for kind in ("cones", "tracker"):
            found = []
            for n in (1, 100):
                rows = np.repeat(np.flatnonzero(train), n)
                angles = test.data[rows] + (n > 1) * rng.normal(0, 5e-6, (len(rows), 6))
                points, groups = test.arm.forward(angles), test.groups[rows]
                y = points - test.simulation.true_points[rows]
                y = position_residuals(points, groups) if kind == "cones" else y
                model = ArmResidualRegressor(test.arm).fit(angles, y, groups=groups)
                left = truth[new] - model.predict(test.data[new])
                found.append(um(centred(left, test.groups[new] - 9)))
            nothing = um(centred(truth[new], test.groups[new] - 9))
            print(f"{kind}, seed {seed}: none {nothing}, one row {found[0]}, stream {found[1]}")


def slips():
    for seed in range(3):
        test = make_single_point(20, 23, random_state=seed)
        train, new = halves(test, 5)
        rng, points = np.random.default_rng(seed), test.points.copy()
        for group in np.unique(test.groups):
            step = rng.normal(size=3)
            points[rng.choice(np.flatnonzero(test.groups == group))] += step / np.linalg.norm(step)
        for name, y in (
            ("with slips", centred(points, test.groups)),
            ("without them", position_residuals(points, test.groups)),
        ):
            arm_model = ArmResidualRegressor(test.arm)
            network = RBFNetRegressor(loss="tukey", random_state=0)
            pose = PoseFeatures(test.arm, joints="all")
            network = CylindricalResidualTarget(
                make_pipeline(pose, StandardScaler(), network), azimuth=test.arm.azimuth
            )
            left = []
            for model, known in ((arm_model, {"groups": test.groups[train]}), (network, {})):
                model.fit(test.data[train], y[train], **known)
                rest = test.target[new] - model.predict(test.data[new])
                left.append(um(centred(rest, test.groups[new] - 15)))
            dropped = np.count_nonzero(network.regressor_[-1].row_weight_ < 0.01)
            print(
                f"seed {seed}, means {name}: none {um(test.target[new])}, arm {left[0]}, "
                f"network without groups {left[1]} ({dropped} of {train.sum()} rows dropped)"
            )


def constants():
    for machine in MACHINES:
        for seed in range(3):
            test = make_single_point(15, 25, machine=machine, random_state=seed)
            train, new = halves(test, 5)
            truth = test.points - test.simulation.true_points
            rng = np.random.default_rng(seed)
            for size in (0.0, 0.02, 0.1, 1.0):
                y = truth + rng.normal(0, size, (15, 3))[test.groups]
                model = ArmResidualRegressor(test.arm)
                model.fit(test.data[train], y[train], groups=test.groups[train])
                left = truth[new] - model.predict(test.data[new])
                of = test.groups[new] - 10
                print(
                    f"{machine}, seed {seed}, constants {size} mm: within positions "
                    f"{um(centred(truth[new], of))} -> {um(centred(left, of))}, absolute "
                    f"{um(truth[new])} -> {um(left)}"
                )


def set_ups():
    named = Counter()
    for machine in MACHINES[:2]:
        for seed in range(2):
            test = make_single_point(12, 20, machine=machine, random_state=seed)
            rng = np.random.default_rng(seed)
            for order in ("by cone", "shuffled"):
                rows = rng.permutation(240) if order == "shuffled" else np.arange(240)
                angles, points = test.data[rows], test.simulation.true_points[rows] + [1e3, 500, 0]
                points += rng.normal(0, 0.01, points.shape)
                turns = test.arm.frames(angles)[:, -1, :3, :3]
                for size in (0.0, 0.1, 0.5, 5.0, 50.0):
                    step = size * np.array([0.6, -0.6, 0.5])
                    for what, moved in (
                        ("station", points + step),
                        ("tool", points + turns @ step),
                    ):
                        half = np.where(np.arange(240)[:, None] < 120, points, moved)
                        found = calibrate(test.nominal_arm, angles, points=half).findings
                        rightly = {(f.code, f.rows) for f in found if f.weight == "repair"}
                        named[what, order, size] += (f"moved-{what}", (120,)) in rightly
    for case, n in named.items():
        print(*case, f"mm: named, with its row, in {n} of 4")


def update():
    said = {}
    for machine in MACHINES:
        for seed in range(3):
            test = make_single_point(15, 20, machine=machine, random_state=seed)
            train, new = halves(test, 5)
            X, groups = test.data[new], test.groups[new]
            model = ArmResidualRegressor(test.arm)
            model.fit(test.data[train], test.target[train], groups=test.groups[train])
            y, expected = test.target[new], model.predict(X)
            knock = np.zeros_like(X)
            knock[:, 1] = np.deg2rad(40 / 3600) * np.cos(X[:, 1])
            knock = np.einsum("nij,nj->ni", test.arm.jacobian(X), knock)
            nominal = position_residuals(test.nominal_arm.forward(X), groups)
            exchanged = X[:, [0, 2, 1, 3, 4, 5]]
            for name, angles, residuals in (
                ("nothing", X, y), ("a knock of 40 arc seconds", X, y + knock), ("the sign", X, -y),
                ("corrected already", X, y - expected), ("corrected twice", X, y - 2 * expected),
                ("one row late", X, np.roll(y, 1, axis=0)), ("joints 2 and 3", exchanged, y),
                ("the nominal table", X, nominal),
            ):  # fmt: skip
                found = update_correction(model, angles, residuals, groups=groups).findings_
                codes = ", ".join(f.code for f in found) or "nothing"
                said.setdefault(name, Counter())[codes] += 1
    for name, counts in said.items():
        print(f"{name}: {dict(counts)}")


PARTS = {
    "dwells": dwells, "slips": slips, "constants": constants, "set-ups": set_ups, "update": update
}  # fmt: skip


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    for name in sys.argv[1:] or PARTS:
        print(f"\n{name}", flush=True)
        PARTS[name]()
