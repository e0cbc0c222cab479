"""What extra columns are worth where they are a cause of errors, and what they cost as noise.

Simulated arms, a single-point test of 12 positions with 25 poses each. Every other position is left
out of the fit, and its deviations are compared: with the extra columns over without them. "cause":
the column says what has moved the probe. "noise": the same arm without that cause, and a column of
the same kind that has nothing to do with its errors.

    python benchmarks/bench_extra.py --seeds 10
"""

import argparse

import numpy as np

from sklearn_raacmm import JointHarmonicRegressor, position_residuals
from sklearn_raacmm.datasets import ArmErrors, make_single_point
from sklearn_raacmm.metrics import single_point_repeatability

JOINTS = range(1, 7)
# Name of the case: what the arm has, and the extra columns.
CASES = {
    "direction": ({"play_arcsec": 6.0}, [f"direction {j}" for j in JOINTS]),
    "temperature": ({"drift_k": 8.0}, ["temperature"]),
    "payload": ({"payload_n": 20.0}, ["payload"]),
    "tool": ({}, ["tool"]),
}
TOOL_MM = 0.05  # how far the second probe is from where the first one is


def values_of(test, extra, rng=None):
    """The extra columns of a simulated test; drawn at random where `rng` is given."""
    columns = []
    for name in extra:
        kind, *joint = name.split()
        if kind == "direction":
            value = test.directions[:, int(joint[0]) - 1]
        elif kind == "tool":
            value = np.arange(len(test.data)) % 2
        else:
            value = test[kind]
        if rng is not None:
            value = {
                "direction": lambda: rng.choice([-1.0, 1.0], len(test.data)),
                "temperature": lambda: 20 + rng.uniform(0, 8, len(test.data)),
                "payload": lambda: rng.uniform(0, 20, len(test.data)),
                "tool": lambda: rng.integers(0, 2, len(test.data)),
            }[kind]()
        columns.append(value)
    return np.column_stack(columns)


def deviations(test, extra, values, tracker, moved=0.0):
    """2S at positions left out, mm: without and with the extra columns."""
    points = test.points + moved
    y = points - test.simulation.true_points
    groups = test.groups
    if not tracker:
        y = position_residuals(points, groups)
    train = groups % 2 == 0
    left = []
    for names, X in (([], test.data), (extra, np.hstack([test.data, values]))):
        model = JointHarmonicRegressor(test.arm, max_order=8, extra=names)
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
    moved = 0.0
    if case == "tool" and cause:
        offset = rng.normal(0, TOOL_MM, 3)
        of_second = values_of(test, extra)[:, 0] == 1
        moved = of_second[:, None] * (test.arm.frames(test.data)[:, -1, :, :3] @ offset)
    values = values_of(test, extra, None if cause else rng)
    without, with_them = deviations(test, extra, values, tracker, moved)
    return with_them / without


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--cases", nargs="*", default=list(CASES))
    options = parser.parse_args()
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
