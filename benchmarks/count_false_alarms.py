"""False alarms on clean data: how often a sound measurement is warned of or refused.

Simulates arms of all four machines and passes what they measure through the doors that a user
takes: calibration from cones and from a tracker, both models of the arm, the chain, cards and
files, planning, and the update and the check of a correction. Nothing is wrong with these data: no
warning and no refusal is due. Rows that a calibration names as outliers are counted, too; its limit
is such that one set in twenty has one by chance. Run it with
``OPENBLAS_NUM_THREADS=1 python benchmarks/count_false_alarms.py --runs 100``.
"""

import argparse
import time
import warnings
from collections import Counter

import numpy as np
from scipy.spatial.transform import Rotation
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    calibrate,
    check_correction,
    learn_correction,
    next_poses,
    transfer_correction,
    update_correction,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.export import describe

MACHINES = ("typical", "gravity", "eccentricity", "none")


def tracker_of(test, rng):
    """Points of a tracker that stands somewhere and sees the true probe to 10 um."""
    turn, shift = Rotation.random(random_state=rng), rng.uniform(-3000, 3000, 3)
    seen = test.simulation.true_points + rng.normal(0, 0.01, test.points.shape)
    return turn.apply(seen) + shift


def doors(seed):
    """Name and function of each door, for one simulated arm."""
    rng = np.random.RandomState(seed)
    machine = MACHINES[seed % len(MACHINES)]
    n_positions, n_poses = int(rng.randint(6, 14)), int(rng.randint(10, 25))
    test = make_single_point(n_positions, n_poses, machine=machine, random_state=seed)
    points, X, groups = tracker_of(test, rng), test.data, test.groups
    known = {}

    def from_cones():
        known["cones"] = calibrate(test.nominal_arm, X, groups)
        return known["cones"]

    def from_tracker():
        known["tracker"] = calibrate(test.nominal_arm, X, points=points)
        return known["tracker"]

    def linear(kind, **targets):
        arm = known[kind].arm
        y = known[kind].residuals(X, **targets)
        known[f"{kind} model"] = ArmResidualRegressor(arm).fit(X, y, groups=groups)
        known[f"{kind} model"].predict(X, return_std=True)

    def chain(kind, **targets):
        arm = known[kind].arm
        inner = make_pipeline(StandardScaler(), RBFNetRegressor(random_state=0))
        model = make_pipeline(
            PoseFeatures(arm, append_azimuth=True), CylindricalResidualTarget(inner)
        )
        model.fit(X, known[kind].residuals(X, **targets)).predict(X)

    def files():
        model = known["cones model"]
        y = known["cones"].residuals(X, groups=groups)
        describe(model, X, y, groups=groups, n_folds=3)

    def front_door():
        model = ArmResidualRegressor(orders=8)
        learn_correction(test.nominal_arm, X, groups, model=model, cv=3).correct(X)

    yield "calibrate, cones", from_cones
    yield "calibrate, tracker", from_tracker
    yield "linear model, cones", lambda: linear("cones", groups=groups)
    yield "linear model, tracker", lambda: linear("tracker", points=points)
    yield "chain, cones", lambda: chain("cones", groups=groups)
    yield "chain, tracker", lambda: chain("tracker", points=points)
    yield "card", files
    yield "front door", front_door
    few = np.isin(groups, np.unique(groups)[:4])
    today = X[few], test.target[few]
    yield "next poses", lambda: next_poses(known["cones model"], X, 3, groups=groups)
    yield "update", lambda: update_correction(known["cones model"], *today, groups=groups[few])
    yield (
        "transfer",
        lambda: transfer_correction(
            known["cones model"], known["cones"].arm, *today, groups=groups[few]
        ),
    )
    yield "check", lambda: check_correction(known["cones model"], *today, groups=groups[few])


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--doors", nargs="*", default=[], help="words of the doors to count")
    args = parser.parse_args()
    started, passed, named = time.process_time(), Counter(), []

    def alarm(seed, door, sentence):
        print(f"{MACHINES[seed % len(MACHINES)]}, seed {seed}, {door}: {sentence}", flush=True)

    for seed in range(args.first, args.first + args.runs):
        for door, enter in doors(seed):
            if args.doors and not any(word in door for word in args.doors):
                continue
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                try:
                    result = enter()
                except Exception as error:  # whatever a user would see
                    alarm(seed, door, f"{type(error).__name__}: {error}")
                    continue
            for warning in caught:
                alarm(seed, door, str(warning.message))
            passed[door] += not caught
            if door.startswith("calibrate"):
                named.append(len(result.outliers))
    for door, count in passed.items():
        print(f"{door:<24}{count:>5} of {args.runs} without a word")
    print(f"sets in which calibrate named rows: {np.count_nonzero(named)} of {len(named)}")
    print(f"{time.process_time() - started:.0f} s of CPU time")


if __name__ == "__main__":
    main()
