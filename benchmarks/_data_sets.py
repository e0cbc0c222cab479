"""Data sets of `make_results.py`, each split into folds, and what regressors leave of them.

Outer folds keep positions (placements, goals) together; every setting is chosen by inner folds of
the training rows, which keep them together, too. Simulated arms come with the package; real data
are downloaded the first time. There calibration, too, sees the training rows only.
"""

from typing import NamedTuple

import numpy as np
from _arm_folds import MOVED
from _regressors import Fold, run
from joblib import Parallel, delayed
from sklearn.metrics import r2_score
from sklearn.model_selection import GroupKFold
from sklearn.utils import Bunch

from sklearn_raacmm import calibrate, position_residuals
from sklearn_raacmm.datasets import (
    fetch_panda_ball_socket,
    fetch_ur10_tracker,
    make_gauge,
    make_single_point,
)
from sklearn_raacmm.metrics import (
    gauge_lengths,
    length_error,
    single_point_repeatability,
    within_position_r2_score,
)

UNCORRECTED, PERFECT = ("-", "uncorrected"), ("-", "perfect model")
WHERE = """\
The data are not part of this package. They are downloaded once to scikit-learn's data folder, or to
that of --data-home. On a computer without a network, copy there what another one has downloaded, or
git clone https://github.com/platonics-delft/kinematics_calibration (commit 05a05ab, folder data, to
panda_ball_socket) and https://github.com/christianlandgraf/ipa-robot-accuracy (commit 507fba6,
Series_A/measurements_grid.csv, to ur10_tracker)."""
UR10_ROWS = 1500
# What `run` returns beside a prediction. These hang on the machine and its load.
COSTS = ("fit_seconds", "predict_seconds_per_row", "pickle_bytes")


def fetched(fetch, *args, **options):
    """Open data of a real arm; where they cannot be had, say where they are."""
    try:
        return fetch(*args, **options)
    except OSError as error:
        raise SystemExit(f"{error}\n\n{WHERE}") from None


class Problem(NamedTuple):
    """A data set, split, and what was measured at the test rows of each fold."""

    name: str
    folds: list
    measured: list  # of arrays (n_test, 3): points, or residuals where they are known in full
    pairs: np.ndarray = None  # labels of the ends of known lengths
    lengths: np.ndarray = None  # mm
    gauge: bool = False  # the last fold's test rows are gauges, apart from the positions
    perfect: list = None  # what a perfect model would predict, fold by fold


def simulated(mix, seed, n_positions, n_poses, n_folds):
    """Cones in five folds, and gauges corrected by a model that learns from all cones."""
    cone = make_single_point(n_positions, n_poses, machine=mix, random_state=seed)
    gauge = make_gauge(machine=mix, random_state=seed)
    n = len(cone.data)
    angles, residuals = np.vstack([cone.data, gauge.data]), np.vstack([cone.target, gauge.target])
    labels = np.concatenate([cone.groups, cone.groups.max() + 1 + gauge.groups])
    perfect = [cone.simulation.perfect_correction, gauge.simulation.perfect_correction]
    perfect, points = np.vstack(perfect), np.vstack([cone.points, gauge.points])
    rows = [*GroupKFold(n_folds).split(cone.data, groups=cone.groups)]
    rows.append((np.arange(n), np.arange(n, len(angles))))
    folds = [Fold(cone.arm, angles, residuals, labels, labels, *r, absolute=False) for r in rows]
    return Problem(
        f"simulated, {mix}, seed {seed}",
        folds,
        [points[fold.test] for fold in folds],
        cone.groups.max() + 1 + gauge.pairs,
        gauge.lengths,
        gauge=True,
        perfect=[perfect[fold.test] for fold in folds],
    )


def some_goals(data, n_rows):
    """Keep goal positions drawn at random, with about so many rows."""
    order = np.random.default_rng(0).permutation(data.groups.max() + 1)
    kept = order[: max(3, n_rows * len(order) // len(data.groups))]
    some = np.isin(data.groups, kept)
    rows = {name: data[name][some] for name in ("data", "tracker_points", "groups")}
    return Bunch(**rows, nominal_arm=data.nominal_arm)


def calibrated(data, train):
    """Calibrate on the training rows: the arm, and the residuals of all rows in its base frame."""
    result = calibrate(data.nominal_arm, data.data[train], points=data.tracker_points[train])
    residuals = result.residuals(data.data, data.tracker_points)
    return result.arm, residuals


def panda(arm, data_home):
    """Every placement of the sockets left out once, by calibration, too."""
    data = fetched(fetch_panda_ball_socket, arm, data_home=data_home)
    folds, measured = [], []
    for name in np.unique(data.placements):
        train = data.placements != name
        known = [length for length in data.lengths if not length[0].startswith(f"{name}/")]
        given = data.nominal_arm, data.data[train], data.groups[train]
        result = calibrate(*given, lengths=known, **MOVED)
        # Calibration weighs outliers down by itself; least squares of the residuals would not.
        learn = np.flatnonzero(train)[result.sample_weight > 0]
        points, residuals = result.arm.forward(data.data), np.zeros((len(data.data), 3))
        residuals[learn] = position_residuals(points[learn], data.groups[learn])
        labels, rows = (data.groups, data.placements), (learn, np.flatnonzero(~train))
        folds.append(Fold(result.arm, data.data, residuals, *labels, *rows, absolute=False))
        measured.append(points[~train])
    pairs = np.array([(first, second) for first, second, *_ in data.lengths])
    holes = np.array([length for _, _, length, _ in data.lengths])
    return Problem(f"real, {arm}", folds, measured, pairs, holes)


def ur10(n_rows, data_home):
    """Three folds of goal positions; residuals against the tracker."""
    data = fetched(fetch_ur10_tracker, data_home=data_home)
    data = some_goals(data, n_rows)
    folds, measured = [], []
    for train, test in GroupKFold(3).split(data.data, groups=data.groups):
        arm, residuals = calibrated(data, train)
        labels = (data.groups, data.groups)
        folds.append(Fold(arm, data.data, residuals, *labels, train, test, absolute=True))
        measured.append(residuals[test])
    return Problem("real, ur10", folds, measured)


def half_width(gain, places, n_draws=2000):
    """Half of a 95 % interval of a mean gain: a bootstrap over places that stay together."""
    index = np.unique(places, return_inverse=True)[1]
    sums, counts = np.bincount(index, gain), np.bincount(index)
    draws = np.random.default_rng(0).integers(0, len(counts), (n_draws, len(counts)))
    low, high = np.quantile(sums[draws].sum(1) / counts[draws].sum(1), [0.025, 0.975])
    return (high - low) / 2


def assess(problem, corrections):
    """Every measure of a correction, given for the test rows of each fold."""
    n = len(problem.folds) - problem.gauge
    labels = np.concatenate([fold.positions[fold.test] for fold in problem.folds[:n]])
    before = np.concatenate(problem.measured[:n])
    prediction = np.concatenate(corrections[:n])
    after = before - prediction
    absolute = problem.folds[0].absolute
    deviation = np.linalg.norm(after if absolute else position_residuals(after, labels), axis=1)
    target = before if absolute else position_residuals(before, labels)
    gain = np.linalg.norm(target, axis=1) - deviation
    places = np.concatenate([fold.splits[fold.test] for fold in problem.folds[:n]])
    codes = np.unique(labels, return_inverse=True)[1]
    repeated = np.bincount(codes)[codes] > 1  # a goal may have one pose only
    spread = single_point_repeatability(after[repeated], labels[repeated], aggregate=None)
    results = {
        "mean_mm": deviation.mean(),
        "half_mm": half_width(gain, places),
        "max_mm": deviation.max(),
        "two_s_mean_mm": spread.mean(),
        "two_s_max_mm": spread.max(),
        "r2": r2_score(target, prediction, multioutput="variance_weighted"),
        "r2_within": within_position_r2_score(
            target[repeated], prediction[repeated], groups=labels[repeated]
        ),
    }
    if problem.pairs is not None:
        if problem.gauge:
            after = problem.measured[-1] - corrections[-1]
            labels = problem.folds[-1].positions[problem.folds[-1].test]
        lengths = gauge_lengths(after, labels, problem.pairs)
        sizes = np.unique(problem.lengths)
        for size in sizes:
            some = length_error(lengths[problem.lengths == size], size)
            results[f"length_{size:g}_mean_mm"] = np.abs(some).mean()
            results[f"length_{size:g}_max_mm"] = np.abs(some).max()
        if len(sizes) > 1:
            # A cone test cannot see the scale: find it with the shorter gauges, judge the longest.
            longest = problem.lengths == sizes[-1]
            scale = lengths[~longest] @ problem.lengths[~longest] / np.sum(lengths[~longest] ** 2)
            results["scaled_mean_mm"] = np.abs(scale * lengths[longest] - sizes[-1]).mean()
    return results


def compare(problem, names, jobs):
    """Print a line for every model on one data set; return a record of each."""
    records = []
    # What a correction is judged by: the deviation where it is known, else 2S.
    measure = "mean_mm" if problem.folds[0].absolute else "two_s_mean_mm"
    nothing = [np.zeros_like(points) for points in problem.measured]
    base = assess(problem, nothing)
    possible = None
    if problem.perfect is not None:
        possible = base[measure] - assess(problem, problem.perfect)[measure]

    def show(name, corrections, costs=None):
        results = assess(problem, corrections)
        gain = base[measure] - results[measure]
        if name != UNCORRECTED:
            results["less"] = gain / base[measure]
            if possible is not None:
                results["of_possible"] = gain / possible
        if costs is not None:
            results |= dict(zip(COSTS, np.mean(costs, axis=0), strict=True))
        shown = ", ".join(f"{key} {value:.3g}" for key, value in results.items())
        print(f"{name[0]:<24}  {name[1]:<26}  {shown}", flush=True)
        records.append({"data": problem.name, "inputs": name[0], "regressor": name[1]} | results)

    show(UNCORRECTED, nothing)
    for name in names:
        calls = (delayed(run)(name, fold) for fold in problem.folds)
        show(name, *zip(*Parallel(n_jobs=jobs)(calls), strict=True))
    if problem.perfect is not None:
        show(PERFECT, problem.perfect)
    return records
