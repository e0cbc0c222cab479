"""Data of arms in folds, and what the benchmarks of the arm's model share.

The real data are looked for in ``../shared/data`` beside the project, or in the folder that the
environment variable SKLEARN_RAACMM_DATA names. Every real fold calibrates the arm on its own
training rows.
"""

import argparse
import importlib.util
import os
import warnings
from pathlib import Path

import numpy as np
from sklearn.cluster import KMeans
from sklearn.model_selection import GroupKFold

from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate, position_residuals
from sklearn_raacmm.datasets import make_single_point

ARCSEC = np.pi / 180 / 3600
MIXES = ("typical", "gravity", "eccentricity")
UR10 = Arm.from_name("ur10", probe=(0, 0, 93))
TOOLED_UR10 = Arm.from_name("ur10", probe=(0, 0, 109))
NOMINAL_PANDA = Arm.from_name("panda", probe=(0, 0, 138))
MOVED = {"accept": "moved-position"}  # sockets of two Pandas did
ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("SKLEARN_RAACMM_DATA", ROOT.parent / "shared" / "data"))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def mean_deviation(residuals):
    return float(np.linalg.norm(residuals, axis=1).mean())


def scatter(residuals, groups):
    """Mean length of vectors from their position's mean."""
    return mean_deviation(position_residuals(residuals, groups))


def sides(test):
    """How far each position of a simulated test is from one side of the volume, by its name."""
    x, y, z = (test.simulation.positions - test.simulation.machine.shoulder).T
    far = np.sqrt(x**2 + y**2 + z**2)
    return {"side": np.abs(np.arctan2(y, x)), "low": z, "near": far, "far": -far}


def geometric(ratios):
    """Geometric mean and largest of some ratios, as text."""
    return f"{np.exp(np.mean(np.log(ratios))):.3f} ({max(ratios):.2f})"


def run_part(doc, parts, **options):
    """Run one of some functions, which the command line names, with the options given there.

    `options` are the names of all options and their defaults; False is a switch.
    """
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parts = {part.__name__.replace("_", "-"): part for part in parts}
    parser.add_argument("part", choices=parts)
    for name, default in options.items():
        kind = {"action": "store_true"} if default is False else {"type": int, "default": default}
        parser.add_argument(f"--{name}", **kind)
    given = parser.parse_args()
    warnings.simplefilter("ignore", UserWarning)  # of few poses, and of what has faded
    parts[given.part](given)


def show(title, columns, rows):
    """Print a line for each row: its name, and a number for each column; return them by names."""
    print(f"{title}: {', '.join(columns)}")
    for name, values in rows.items():
        print(f"  {name}: {', '.join(f'{value:.4g}' for value in values)}", flush=True)
    named = {str(n): dict(zip(columns, map(float, v), strict=True)) for n, v in rows.items()}
    return {title: named}


def learn(arm, X, y, groups, train, **params):
    """The arm's model of the training rows, and what it leaves of the others."""
    model = ArmResidualRegressor(arm, **params).fit(X[train], y[train], groups=groups[train])
    return model, y[~train] - model.predict(X[~train])


def learn_tracked(arm, angles, points):
    """A calibration by a tracker's points, and a model of what it leaves."""
    found = calibrate(arm, angles, points=points)
    return found, ArmResidualRegressor(found.arm).fit(angles, found.residuals_mm)


def pairs_known(placements):
    """Known lengths of a Panda's placements: two sockets are 50 mm apart."""
    return [(f"{p}/0", f"{p}/1", 50.0, 0.1) for p in placements]


def readers():
    """The tests' readers of the real data."""
    spec = importlib.util.spec_from_file_location("readers", ROOT / "tests" / "conftest.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def read_ur10(series, data_home=DATA):
    """Angles in rad, points in mm and number of the goal of a UR10's series "A" or "B"."""
    name = {"A": "measurements_grid.csv", "B": "measurements_joint_configurations.csv"}[series]
    data = readers().read_ur10(Path(data_home) / "ur10_tracker" / name)
    return data.angles, data.points, data.groups


def read_panda(name, data_home=DATA):
    """Angles in rad, socket and placement of each pose of a Panda."""
    data = readers().read_panda(Path(data_home) / "panda_ball_socket" / name)
    return data.angles, data.groups, data.placements


def ur10_folds(split, n_rows, data_home=DATA):
    """Arm, angles, residuals, groups and training rows of five folds of series A.

    `split` is "goal", goal positions at random, or "space", neighbouring ones.
    """
    angles, points, goals = read_ur10("A", data_home)
    rng = np.random.default_rng(0)
    rows = np.sort(rng.permutation(len(angles))[:n_rows])
    angles, points, goals = angles[rows], points[rows], goals[rows]
    if split == "goal":
        fold = (rng.permutation(goals.max() + 1) % 5)[goals]
    else:
        labels, index = np.unique(goals, return_inverse=True)
        means = np.stack([points[index == i].mean(axis=0) for i in range(len(labels))])
        fold = KMeans(5, n_init=5, random_state=0).fit_predict(means)[index]
    yield from tracked_folds(angles, points, goals, fold)


def ur10b_folds(data_home=DATA):
    """The same of series B, by region."""
    angles, points, _ = read_ur10("B", data_home)
    fold = KMeans(5, n_init=1, random_state=0).fit_predict(points)
    regions = KMeans(60, n_init=1, random_state=0).fit_predict(points)  # it has no goals
    yield from tracked_folds(angles, points, regions, fold)


def tracked_folds(angles, points, groups, fold):
    """Arm, angles, residuals, groups and training rows of each of five folds."""
    for k in range(5):
        train = fold != k
        result = calibrate(TOOLED_UR10, angles[train], points=points[train])
        yield result.arm, angles, result.residuals(angles, points), groups, train


def panda_folds(name, data_home=DATA):
    """The same of a Panda, each placement left out once."""
    angles, sockets, placements = read_panda(name, data_home)
    for placement in np.unique(placements):
        train = placements != placement
        lengths = pairs_known(np.unique(placements[train]))
        arm = calibrate(NOMINAL_PANDA, angles[train], sockets[train], lengths=lengths, **MOVED).arm
        yield arm, angles, position_residuals(arm.forward(angles), sockets), sockets, train


def simulated_folds(mix):
    """The same of a simulated arm: ten positions of 40 poses in five folds."""
    cone = make_single_point(10, 40, machine=mix, random_state=0)
    for train, _ in GroupKFold(5).split(cone.data, groups=cone.groups):
        mask = np.isin(np.arange(len(cone.data)), train)
        yield cone.arm, cone.data, cone.target, cone.groups, mask
