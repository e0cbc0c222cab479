"""What each idea of a correction is worth on real arms, at positions that no stage has seen.

Run ``python benchmarks/bench_harmonics.py [--rows N] [sets ...]`` with the real data in
``../shared/data`` beside the project, or in the folder that SKLEARN_RAACMM_DATA names. `sets` are
some of ur10-goal, ur10-space, panda_3, panda_2 (default: all); `--rows` draws so many of the UR10's
11 911 poses.

Every fold calibrates the arm on its own training rows. The settings of every method are its
defaults, or found inside the training rows. Entries are in mm: mean deviation over test poses with
the half width of a 95 % interval of its paired difference to no correction, by resampling positions
(seed 0); maximum; mean over positions of 2S about zero (tracker) or about the position's mean.
"""

import argparse
import importlib.util
import os
import sys
import warnings
from pathlib import Path

import numpy as np
from sklearn.cluster import KMeans
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    JointHarmonicRegressor,
    PoseFeatures,
    RBFNetRegressor,
    calibrate,
    position_residuals,
)

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("SKLEARN_RAACMM_DATA", ROOT.parent / "shared" / "data"))


def network(arm, joints):
    return CylindricalResidualTarget(
        make_pipeline(PoseFeatures(arm, joints=joints), StandardScaler(), RBFNetRegressor()),
        azimuth=arm.azimuth,
    )


def methods(arm):
    """Name, estimator, and whether it takes groups."""
    bare = {"gravity": False, "kinematics": False, "wobble": False}
    yield "network, 3 pose inputs (the paper's)", network(arm, "pose"), False
    yield "network, all joints", network(arm, "all"), False
    yield "harmonics alone", JointHarmonicRegressor(arm, **bare), True
    yield "+ gravity", JointHarmonicRegressor(arm, **{**bare, "gravity": True}), True
    no_offsets = JointHarmonicRegressor(arm, offsets=False)
    yield "+ kinematics, wobble; no offsets", no_offsets, True
    yield "+ kinematics, wobble (default)", JointHarmonicRegressor(arm), True
    free = {"use": "harmonics+network", "fade": 0, "cap": None}
    yield "default + network", ArmResidualRegressor(arm, **free), True
    yield "default + network, joint", ArmResidualRegressor(arm, joint=True, **free), True
    yield "default + guards", ArmResidualRegressor(arm, use="harmonics"), True
    yield "default + network + guards", ArmResidualRegressor(arm, use="harmonics+network"), True
    yield "chosen by its own check", ArmResidualRegressor(arm), True


def readers():
    spec = importlib.util.spec_from_file_location("readers", ROOT / "tests" / "conftest.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def ur10_folds(split, n_rows):
    data = readers().read_ur10(DATA / "ur10_tracker" / "measurements_grid.csv")
    rng = np.random.default_rng(0)
    rows = np.sort(rng.permutation(len(data.angles))[:n_rows])
    theta, points, goals = data.angles[rows], data.points[rows], data.groups[rows]
    if split == "goal":
        fold = (rng.permutation(goals.max() + 1) % 5)[goals]
    else:
        labels, index = np.unique(goals, return_inverse=True)
        means = np.stack([points[index == i].mean(axis=0) for i in range(len(labels))])
        fold = KMeans(5, n_init=5, random_state=0).fit_predict(means)[index]
    for k in range(5):
        train = fold != k
        result = calibrate(
            Arm.from_name("ur10", probe=(0, 0, 109)), theta[train], points=points[train]
        )
        measured = (points - result.base_translation) @ result.base_rotation
        y = result.arm.forward(theta) - measured
        yield result.arm, theta, y, goals, train


def panda_folds(name):
    data = readers().read_panda(DATA / "panda_ball_socket" / name)
    for placement in np.unique(data.placements):
        train = data.placements != placement
        lengths = [(f"{p}/0", f"{p}/1", 50.0, 0.1) for p in np.unique(data.placements[train])]
        nominal = Arm.from_name("panda", probe=(0, 0, 138))
        arm = calibrate(nominal, data.angles[train], data.groups[train], lengths=lengths).arm
        y = position_residuals(arm.forward(data.angles), data.groups)
        yield arm, data.angles, y, data.groups, train


def statistics(left, groups, reference):
    """Mean, half width of the interval of the mean's difference to the reference, maximum, 2S."""
    length = np.linalg.norm(left, axis=1)
    _, index = np.unique(groups, return_inverse=True)
    counts = np.bincount(index)
    sums = np.bincount(index, length - reference)
    rng = np.random.default_rng(0)
    draws = rng.integers(0, len(counts), (2000, len(counts)))
    differences = sums[draws].sum(axis=1) / counts[draws].sum(axis=1)
    low, high = np.quantile(differences, [0.025, 0.975])
    two_s = 2 * np.sqrt(np.bincount(index, length**2) / np.maximum(counts - 1, 1))
    return length.mean(), (high - low) / 2, length.max(), two_s[counts > 1].mean()


def run(name, n_rows):
    tracked = name.startswith("ur10")
    folds = ur10_folds(name.split("-")[1], n_rows) if tracked else panda_folds(name)
    lefts, labels = {}, []
    for arm, theta, y, groups, train in folds:
        labels.append(groups[~train])
        lefts.setdefault("no correction", []).append(y[~train])
        for title, model, takes_groups in methods(arm):
            extra = {"groups": groups[train]} if takes_groups else {}
            left = y[~train] - model.fit(theta[train], y[train], **extra).predict(theta[~train])
            if not tracked:
                left = position_residuals(left, groups[~train])
            lefts.setdefault(title, []).append(left)
        print(f"  {name}: fold done", file=sys.stderr, flush=True)
    groups = np.concatenate(labels)
    reference = np.linalg.norm(np.concatenate(lefts["no correction"]), axis=1)
    print(f"\n{name}: {len(groups)} poses, {len(np.unique(groups))} positions")
    print(f"{'':<40}{'mean':>8}{'+-':>8}{'max':>8}{'2S':>8}")
    for title, parts in lefts.items():
        mean, half, largest, two_s = statistics(np.concatenate(parts), groups, reference)
        print(f"{title:<40}{mean:8.4f}{half:8.4f}{largest:8.3f}{two_s:8.4f}")
    sys.stdout.flush()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=None)
    parser.add_argument(
        "sets", nargs="*", default=["panda_3", "panda_2", "ur10-goal", "ur10-space"]
    )
    args = parser.parse_args()
    warnings.filterwarnings("ignore", message=".*known lengths disagree")
    for name in args.sets:
        run(name, args.rows)


if __name__ == "__main__":
    main()
