"""What extra columns are worth where they are a cause of errors, and what they cost as noise.

Simulated arms, a single-point test of 12 positions with 25 poses each. Every other position is left
out of the fit, and its deviations are compared: with the extra columns over without them. "cause":
the column says what has moved the probe. "noise": the same arm without that cause, and a column of
the same kind that has nothing to do with its errors.

    python benchmarks/bench_extra.py --seeds 8

``--real`` asks the UR10 of `fetch_ur10_tracker` instead: what the directions from which its joints
came are worth at three draws of a fifth of its goals.
Calibration and models learn from poses of the other goals.

    python benchmarks/bench_extra.py --real --rows 1500
"""

import argparse

import numpy as np
from _arm_folds import DATA

from sklearn_raacmm import ArmResidualRegressor, calibrate, position_residuals
from sklearn_raacmm.datasets import ArmErrors, fetch_ur10_tracker, make_single_point
from sklearn_raacmm.metrics import single_point_repeatability

JOINTS = range(1, 7)
# Name of the case: what the arm has, and the extra columns.
CASES = {
    "direction": ({"play_arcsec": 6.0}, [f"direction {j}" for j in JOINTS]),
    "temperature": ({"drift_k": 8.0}, ["temperature"]),
    "payload": ({"payload_n": 20.0}, ["payload"]),
}


def values_of(test, extra, rng=None):
    """The extra columns of a simulated test; drawn at random where `rng` is given."""
    columns = []
    for name in extra:
        kind, *joint = name.split()
        value = test.directions[:, int(joint[0]) - 1] if kind == "direction" else test[kind]
        if rng is not None:
            value = {
                "direction": lambda: rng.choice([-1.0, 1.0], len(test.data)),
                "temperature": lambda: 20 + rng.uniform(0, 8, len(test.data)),
                "payload": lambda: rng.uniform(0, 20, len(test.data)),
            }[kind]()
        columns.append(value)
    return np.column_stack(columns)


def deviations(test, extra, values, tracker):
    """2S at positions left out, mm: without and with the extra columns."""
    points = test.points
    y = points - test.simulation.true_points
    groups = test.groups
    if not tracker:
        y = position_residuals(points, groups)
    train = groups % 2 == 0
    left = []
    for names, X in (([], test.data), (extra, np.hstack([test.data, values]))):
        model = ArmResidualRegressor(test.arm, orders=8, extra=names)
        model.fit(X[train], y[train], groups=groups[train])
        rest = points[~train] - model.predict(X[~train])
        if tracker:
            error = rest - test.simulation.true_points[~train]
            left.append(np.linalg.norm(error, axis=1).mean())
        else:
            left.append(single_point_repeatability(rest, groups[~train]))
    return left


def run(case, seed, cause, tracker):
    """Ratio of the deviations with and without the columns of a case."""
    sizes, extra = CASES[case]
    errors = ArmErrors(**sizes) if cause else ArmErrors()
    test = make_single_point(12, 25, machine=errors, random_state=seed)
    rng = np.random.default_rng(seed)
    values = values_of(test, extra, None if cause else rng)
    without, with_them = deviations(test, extra, values, tracker)
    return with_them / without


def print_real(n_rows):
    """What directions of joints are worth on the UR10, at a fifth of its goals, left out."""
    data, n_draws = fetch_ur10_tracker(data_home=DATA), 3
    draws = []
    for seed in range(n_draws):
        rng, n_goals = np.random.default_rng(seed), data.groups.max() + 1
        out = np.isin(data.groups, rng.permutation(n_goals)[: n_goals // 5])
        train = np.sort(rng.permutation(np.flatnonzero(~out))[:n_rows])
        found = calibrate(data.nominal_arm, data.data[train], points=data.tracker_points[train])
        draws.append((found, train, out))
    for n in (0, 3, 6):
        X, left = np.hstack([data.data, data.directions[:, :n]]), []
        for found, train, out in draws:
            y = found.residuals(data.data, data.tracker_points)
            names = [f"direction {joint}" for joint in range(1, n + 1)]
            model = ArmResidualRegressor(found.arm, extra=names)
            model.fit(X[train], y[train], groups=data.groups[train])
            lags = model.terms_[model.terms_["family"] == "direction"]["value"]
            distance = np.linalg.norm(y[out] - model.predict(X[out]), axis=1)
            left.append(f"{distance.mean():.4f} (lags {np.round(lags, 1)})")
        print(f"directions of {n} joints: mean deviation {', '.join(left)}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--cases", nargs="*", default=list(CASES))
    parser.add_argument("--real", action="store_true", help="the UR10 instead")
    parser.add_argument("--rows", type=int, default=1500, help="training poses of the UR10")
    options = parser.parse_args()
    if options.real:
        print_real(options.rows)
        return
    print("| case | data | as cause: median, worst | as noise: median, worst |\n|---|---|---|---|")
    for case in options.cases:
        for tracker in (False, True):
            cells = []
            for cause in (True, False):
                ratios = [run(case, seed, cause, tracker) for seed in range(options.seeds)]
                cells.append(f"{np.median(ratios):.3f}, {max(ratios):.3f}")
            kind = "tracker" if tracker else "single-point"
            print(f"| {case} | {kind} | {cells[0]} | {cells[1]} |", flush=True)


if __name__ == "__main__":
    main()
