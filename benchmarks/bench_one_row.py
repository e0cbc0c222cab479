"""Time `predict` of one row against that of a bare scikit-learn Ridge, in one run.

    python benchmarks/bench_one_row.py

Of one row nearly all is validation: what counts is how often it is done. Each estimator takes its
turn in every round, so that a slow moment of the machine meets all; medians of CPU time, ratios to
Ridge.
"""

import sys
import time

import numpy as np
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
)
from sklearn_raacmm.datasets import make_single_point


def main(rounds=60, calls=20):
    data = make_single_point(n_positions=12, n_poses=30, random_state=0)
    X, y, arm = data.data, data.target, data.arm
    network = RBFNetRegressor(60, random_state=0)
    inner = make_pipeline(StandardScaler(), network)
    pose = PoseFeatures(arm)
    models = {
        "Ridge": Ridge(),
        "StandardScaler, Ridge": make_pipeline(StandardScaler(), Ridge()),
        "RBFNetRegressor": network,
        "PoseFeatures (transform)": pose,
        "StandardScaler, RBFNetRegressor": inner,
        "chain, outermost": CylindricalResidualTarget(
            make_pipeline(pose, StandardScaler(), network), azimuth=arm.azimuth
        ),
        "chain, pipeline": make_pipeline(
            PoseFeatures(arm, append_azimuth=True), CylindricalResidualTarget(inner)
        ),
        "ArmResidualRegressor": ArmResidualRegressor(arm, orders=8),
    }
    times = {}
    for name, model in models.items():
        model.fit(X, y)
        times[name] = []
    row = X[:1].copy()
    for _ in range(rounds):
        for name, model in models.items():
            call = getattr(model, "predict", None) or model.transform
            start = time.process_time()
            for _ in range(calls):
                call(row)
            times[name].append((time.process_time() - start) / calls)
    medians = {name: np.median(values) for name, values in times.items()}
    print(f"{'one row, 60 centres':<36}{'CPU us':>8}{'ratio':>8}")
    for name, seconds in medians.items():
        print(f"{name:<36}{1e6 * seconds:>8.0f}{seconds / medians['Ridge']:>8.2f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
