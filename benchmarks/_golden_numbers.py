"""Golden numbers of the arm's model, of what happens after the lab, of calibration and network.

Each function takes the folder of the real data and returns numbers by name, lengths in mm, errors
of the network in standard deviations of the truth.
"""

import time
import warnings
from functools import partial

import numpy as np
from _arm_folds import (
    MIXES,
    MOVED,
    NOMINAL_PANDA,
    TOOLED_UR10,
    UR10,
    learn,
    learn_tracked,
    mean_deviation,
    pairs_known,
    panda_folds,
    read_panda,
    read_ur10,
    scatter,
    sides,
    simulated_folds,
    ur10_folds,
    ur10b_folds,
)
from _problems import GENERATED, Problem, generated
from bench_accuracy import mixtures
from bench_after_the_lab import Robot, known_of_series_b
from bench_check import knock, poses_of_simulated_arm
from bench_speed import simulated as simulated_cones
from scipy.stats import norm
from sklearn.model_selection import GroupKFold
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    calibrate,
    check_correction,
    position_residuals,
    update_correction,
)
from sklearn_raacmm.correction._change import transferred_model
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.network import KERNELS

N_ROWS = 1500  # poses of the UR10 of which a model is made
WITHIN = 1.96  # standard deviations of an interval of 95 %


def of_folds(name, folds, tracked=False):
    """What the model with default parameters leaves in the folds, and what it consists of."""
    lefts, inside, models = [], [], []
    for arm, angles, y, groups, train in folds:
        model, _ = learn(arm, angles, y, groups, train)
        mean, std = model.predict(angles[~train], return_std=True, with_noise=True)
        left = y[~train] - mean
        left = left if tracked else position_residuals(left, groups[~train])
        lefts.append(np.linalg.norm(left, axis=1))
        inside.append(np.abs(left) < WITHIN * std)
        models.append(model)
    left = np.concatenate(lefts)
    orders = [model.harmonics_["order"].max(initial=0) for model in models]
    return {
        f"{name}: mean deviation": left.mean(),
        f"{name}: largest deviation": left.max(),
        f"{name}: share inside 95 %": np.concatenate(inside).mean(),
        f"{name}: columns, mean of folds": np.mean([len(m.linear_model_.coef) for m in models]),
        f"{name}: highest order of a fold": max(orders),
        f"{name}: fading factor, mean of folds": np.mean([m.fading_.factor for m in models]),
        f"{name}: fading size, mean of folds": np.mean([m.fading_.size_mm for m in models]),
    }


def simulated(data_home):
    """The model on three simulated arms; and learnt in one corner of each and used elsewhere."""
    found, ratios = {}, []
    for mix in MIXES:
        found |= of_folds(f"simulated {mix}", simulated_folds(mix))
    for mix in MIXES:
        test = make_single_point(24, 15, machine=mix, random_state=1)
        for away in sides(test).values():
            train = np.isin(test.groups, np.argsort(away)[:8])
            _, left = learn(test.arm, test.data, test.target, test.groups, train)
            left = scatter(left, test.groups[~train])
            ratios.append(left / mean_deviation(test.target[~train]))
    return found | {
        "learnt in a corner: deviation elsewhere over uncorrected, mean": np.mean(ratios),
        "learnt in a corner: deviation elsewhere over uncorrected, worst": np.max(ratios),
    }


def pandas(data_home):
    """The model on real arms in single-point tests, each placement left out once."""
    found = {}
    for name in ("panda_2", "panda_3", "panda_6", "panda_7"):
        found |= of_folds(name, panda_folds(name, data_home))
    return found


def ur10(data_home):
    """The model on a real robot and a tracker."""
    found = {}
    for split, name in (("goal", "UR10 A by goal"), ("space", "UR10 A by region")):
        found |= of_folds(name, ur10_folds(split, N_ROWS, data_home), tracked=True)
    return found | of_folds("UR10 B by region", ur10b_folds(data_home), tracked=True)


def model_of_series_a(data_home):
    """A calibration and a model of poses of series A, and the other poses and points."""
    angles, points, _ = read_ur10("A", data_home)
    rows, others = np.split(np.random.default_rng(0).permutation(len(angles)), [2 * N_ROWS])
    first, model = learn_tracked(UR10, angles[rows], points[rows])
    return first, model, angles[others], points[others]


def update(data_home):
    """A model of series A, registered and updated on series B: medians of three draws."""
    first, model, _, _ = model_of_series_a(data_home)
    found = {}
    for n in (10, 60):
        medians = known_of_series_b(first.arm, model, n, range(3), data_home)
        bare, _, registered, updated = medians
        name = f"A to B, {n} poses"
        found |= {f"{name}: no correction": bare, f"{name}: registered": registered}
        found |= {f"{name}: updated": updated}
    test = make_single_point(12, 20, random_state=0)
    old, new, rest = test.groups < 8, test.groups == 8, test.groups > 8
    model = ArmResidualRegressor(test.arm)
    model.fit(test.data[old], test.target[old], groups=test.groups[old])
    fresh = update_correction(model, test.data[new], test.target[new], groups=test.groups[new])
    left = test.target[rest] - fresh.predict(test.data[rest])
    left = scatter(left, test.groups[rest])
    return found | {"update by one position, simulated: mean deviation": left}


def knocks(name, arm, model, poses, arcsecs, runs=20):
    """Shares of alarms and of causes named rightly; `poses(run)` gives angles and residuals."""
    found, p_values = {}, []
    of_arm = {f"knock of {size} arc seconds": (knock(arm, size), ()) for size in arcsecs}
    for size in arcsecs[-1:]:
        of_arm[f"knock of {size} arc seconds, refitted"] = knock(arm, size), ("base", "probe")
    of_arm["5 K warmer"] = (lambda q, rng, run: (-arm.forward(q) * 11.7e-6 * 5, "scale")), ()
    for run in range(2 * runs):
        p_values.append(check_correction(model, *poses(run)).p_value)
    found[f"check, {name}, no change: alarms"] = np.mean(np.less(p_values, 0.01))
    found[f"check, {name}, no change: mean p value"] = np.mean(p_values)
    for what, (change, refitted) in of_arm.items():
        alarms = right = 0
        for run in range(runs):
            angles, y = poses(run)
            # Of a knock of joint 1 or 5 nothing may be left beside a fitted base and probe.
            moved, cause = change(angles, None, 1 + run % 3 if refitted else run)
            result = check_correction(model, angles, y + moved, refitted=refitted)
            alarms += not result.holds
            right += not result.holds and result.suspect == cause
        found[f"check, {name}, {what}: alarms"] = alarms / runs
        found[f"check, {name}, {what}: named rightly"] = right / runs
    return found


def check(data_home):
    """Checks with 40 poses, on a simulated arm and on other poses of the real UR10."""
    arm = Arm.from_name("aacmm6")
    poses = partial(poses_of_simulated_arm, arm)
    found = knocks(
        "simulated", arm, ArmResidualRegressor(arm).fit(*poses(10**6, 500)), poses, (2, 5)
    )
    first, model, angles, points = model_of_series_a(data_home)

    def others(run):
        some = np.random.default_rng([3, run]).choice(len(angles), 40, replace=False)
        return angles[some], first.residuals(angles[some], points[some])

    return found | knocks("UR10", first.arm, model, others, (10, 20))


def transfer(data_home):
    """New arms that start from two earlier ones of their make: simulated robots, and a Panda."""
    rng = np.random.default_rng(0)
    earlier = [Robot(0, 100 + i).learn(600, rng) for i in range(2)]
    far, found = rng.uniform(-2, 2, (500, 6)), {}
    for n in (20, 100):
        left = []
        for seed in range(3):
            robot, rng = Robot(0, seed), np.random.default_rng([5, seed])
            new = rng.uniform(-2, 2, (n, 6))
            own = calibrate(robot.nominal, new, points=robot.measure(new, rng))
            true = own.residuals(far, robot.measure(far, rng, 0.0))
            moved = transferred_model(earlier, own.arm, new, own.residuals_mm)
            left.append(mean_deviation(true - moved.predict(far)))
        found[f"transfer, robots, {n} poses: mean deviation"] = np.mean(left)
    angles, sockets, _ = read_panda("panda_3", data_home)
    old = calibrate(NOMINAL_PANDA, angles, sockets, **MOVED)
    y = old.residuals(angles, groups=sockets)
    model = ArmResidualRegressor(old.arm).fit(angles, y, groups=sockets)
    angles, sockets, placements = read_panda("panda_2", data_home)
    known = np.isin(placements, np.unique(placements)[:3])
    own = calibrate(NOMINAL_PANDA, angles[known], sockets[known], **MOVED)
    y = own.residuals(angles[known], groups=sockets[known])
    moved = transferred_model([model], own.arm, angles[known], y, groups=sockets[known])
    left = own.residuals(angles[~known], groups=sockets[~known]) - moved.predict(angles[~known])
    name = "transfer, panda_3 to panda_2"
    found[f"{name}: mean deviation"] = scatter(left, sockets[~known])
    found[f"{name}: gain in nats"] = moved.updates_[0]["gain_nats"]
    return found


def calibration(data_home):
    """Calibration: known lengths, single-point tests, a tracker."""
    arm = Arm.from_name("aacmm6")
    found = {}
    angles, _, groups = simulated_cones(arm, 1000, 20)
    test = make_single_point(12, 30, random_state=0)
    places = test.simulation.positions
    pairs = [(i, i + 1) for i in range(0, 6, 2)]
    known = [(i, j, np.linalg.norm(places[i] - places[j]), 0.01) for i, j in pairs]
    ends = np.array([(i, j) for i in range(6, 12) for j in range(6, i)])
    true = np.linalg.norm(places[ends[:, 0]] - places[ends[:, 1]], axis=1)
    for name, lengths in (("no lengths", ()), ("three lengths", known)):
        result = calibrate(test.nominal_arm, test.data, test.groups, lengths=lengths)
        points = result.arm.forward(test.data)
        centres = np.stack([points[test.groups == i].mean(axis=0) for i in range(12)])
        error = np.linalg.norm(centres[ends[:, 0]] - centres[ends[:, 1]], axis=1) - true
        name = f"calibrate, simulated, {name}"
        found |= {
            f"{name}: scatter": result.scatter_after_mm,
            f"{name}: error of other lengths": np.abs(error).mean(),
            f"{name}: relative sd of the scale": result.scale_sd,
        }
    result = calibrate(arm, angles, groups)
    found["calibrate, twenty sockets: scatter"] = result.scatter_after_mm
    found["calibrate, twenty sockets: prior sd of lengths"] = result.prior_sd["length_mm"]
    for name in ("panda_2", "panda_3"):
        angles, sockets, placements = read_panda(name, data_home)
        lengths = pairs_known(np.unique(placements))
        result = calibrate(NOMINAL_PANDA, angles, sockets, lengths=lengths, **MOVED)
        found[f"calibrate, {name}: scatter"] = result.scatter_after_mm
        found[f"calibrate, {name}: prior sd of lengths"] = result.prior_sd["length_mm"]
        found[f"calibrate, {name}: outliers"] = len(result.outliers)
    angles, points, _ = read_ur10("A", data_home)
    rows, rest = np.split(np.random.default_rng(0).permutation(len(angles)), [N_ROWS])
    result = calibrate(TOOLED_UR10, angles[rows], points=points[rows])
    left = result.residuals(angles[rest], points[rest])
    found["calibrate, UR10 and tracker: other poses"] = mean_deviation(left)
    found["calibrate, UR10 and tracker: standard deviation"] = result.sigma_mm
    return found


# -- the network ----------------------------------------------------------------------------------

# Draws of every generated problem by its number of rows; and which of them are drawn once at 1000
# rows: a smooth function with few centres, and rough ones of two and eight features.
DRAWS, AT_1000 = {10: 5, 30: 4, 300: 1}, ("friedman2", "kinks2", "robot_arm8")
LEVEL = norm.ppf(0.975)


def _of_problem(name, problem, **params):
    """Error, coverage, centres and roughness of the kernel, from 0 to 3, of a fitted network."""
    model = RBFNetRegressor(random_state=0, **params).fit(problem.X, problem.y)
    mean, std = model.predict(problem.X_test, return_std=True)
    error = np.square((mean - problem.truth) / problem.truth.std(axis=0))
    order = list(KERNELS)
    return {
        f"network, {name}, error": np.sqrt(np.mean(error)),
        f"network, {name}, inside 95 %": np.mean(np.abs(problem.observed - mean) <= LEVEL * std),
        f"network, {name}, centres": len(model.centers_),
        f"network, {name}, kernel": np.mean([order.index(n.kernel) for n in model.networks_]),
    }


def _of_draws(name, n, draws):
    """The same, means over some draws of the rows."""
    found = [_of_problem(f"{name}, {n} rows", generated(name, n, seed)) for seed in range(draws)]
    return {key: np.mean([one[key] for one in found]) for key in found[0]}


def _of_ways():
    """The same of slips, ranks as inputs, a number and a share of centres, and many rows."""
    rng = np.random.default_rng(0)
    clean = generated("friedman1", 200)
    far = np.zeros(200)
    far[rng.permutation(200)[:6]] = 8 * clean.y.std()
    found = _of_problem("slips, 200 rows", clean._replace(y=clean.y + far))
    X, y = mixtures(rng, 1300)
    uneven = Problem(X[:300], y[:300], X[300:], y[300:], y[300:])
    found |= _of_problem("mixtures, 300 rows", uneven)
    three = generated("periodic3", 300)
    found |= _of_problem("20 shared centres, 300 rows", three, n_centers=20, shared="scaled")
    found |= _of_problem("centres for 99 %, 300 rows", three, n_centers=0.01)
    found |= _of_problem("friedman1, 4000 rows", generated("friedman1", 4000))
    given = {"n_centers": 50, "length_scale": 1.0, "alpha": 1e-4}
    return found | _of_problem("blocks, 110 000 rows", generated("fourier3", 110_000), **given)


def _of_arm(arm, inputs, angles, residuals, folds, groups=None, scatter=None):
    """Share of the residuals that a chain leaves in folds it has not seen, or of their scatter."""
    left, whole = 0.0, 0.0
    for train, test in folds:
        chain = make_pipeline(
            PoseFeatures(arm, append_azimuth=True, **inputs),
            CylindricalResidualTarget(RBFNetRegressor(random_state=0)),
        )
        name = "cylindricalresidualtarget__groups"
        labels = {} if groups is None else {name: groups[train]}
        chain.fit(angles[train], residuals[train], **labels)
        rest = residuals[test] - chain.predict(angles[test])
        if scatter is not None:  # what a position's mean takes out is not known of either
            rest = position_residuals(rest, scatter[test])
        left += np.square(rest).sum()
        whole += np.square(residuals[test]).sum()
    return np.sqrt(left / whole)


def _of_arms(data_home):
    """The same of two folds of two Pandas' placements, and of every 24th goal of the UR10."""
    found = {}
    for name in ("panda_2", "panda_3"):
        angles, groups, placements = read_panda(name, data_home)
        known = pairs_known(np.unique(placements))
        calibrated = calibrate(NOMINAL_PANDA, angles, groups, lengths=known, **MOVED)
        good = calibrated.sample_weight > 0
        angles, groups = angles[good], groups[good]
        y = position_residuals(calibrated.arm.forward(angles), groups)
        folds = list(GroupKFold(4).split(angles, groups=placements[good]))[:2]
        given = calibrated.arm, {}, angles, y, folds
        found[f"network, {name}, groups, error"] = _of_arm(*given, groups, groups)
    found[f"network, {name}, error"] = _of_arm(*given, None, groups)
    angles, points, goals = read_ur10("A", data_home)
    some = goals % 24 == 0
    angles, points, goals = angles[some], points[some], goals[some]
    calibrated = calibrate(TOOLED_UR10, angles, points=points)
    folds = list(GroupKFold(3).split(angles, groups=goals))[:1]
    y = calibrated.residuals(angles, points)
    for name, inputs in (("pose", {}), ("all joints", {"joints": "all", "encoding": "periodic"})):
        found[f"network, UR10, {name}, error"] = _of_arm(calibrated.arm, inputs, angles, y, folds)
    return found


def network(data_home):
    """Golden numbers of the network by name; `data_home` is the folder of the real data."""
    found = {}
    warnings.simplefilter("ignore")
    for name in GENERATED:
        for n, draws in DRAWS.items():
            found |= _of_draws(name, n, draws)
    for name in AT_1000:
        found |= _of_draws(name, 1000, 1)
    return found | _of_ways() | _of_arms(data_home)


def seconds(data_home):
    """CPU seconds of fits, each the least of three or two: they are printed, not compared."""
    test = make_single_point(10, 30, random_state=0)
    angles, points, _ = read_ur10("A", data_home)
    rows = np.random.default_rng(0).permutation(len(angles))[: 2 * N_ROWS]
    first = calibrate(UR10, angles[rows], points=points[rows])

    def cpu_seconds(repeats, arm, *args, **kwargs):
        times = []
        for _ in range(repeats):
            start = time.process_time()
            ArmResidualRegressor(arm).fit(*args, **kwargs)
            times.append(time.process_time() - start)
        return min(times)

    few = test.data, test.target
    many = first.arm, angles[rows], first.residuals_mm
    return {
        "fit of 300 simulated poses": cpu_seconds(3, test.arm, *few, groups=test.groups),
        "fit of 3000 poses of the UR10": cpu_seconds(2, *many),
    }


SECTIONS = {
    "simulated": simulated,
    "pandas": pandas,
    "ur10": ur10,
    "update": update,
    "check": check,
    "transfer": transfer,
    "calibration": calibration,
    "network": network,
}
