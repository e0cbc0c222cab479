"""
Search the whole chain, save the best model
===========================================

The chain from joint angles to residual is one scikit-learn estimator, so a grid search can choose
anything in it: which inputs, which regressor, which settings. Folds are made of whole positions of
the cone; a random split would put neighbours of the test rows into training, and flatter. The best
chain is judged at positions that the search never saw, saved, and loaded by another process.

The data are simulated.
"""

import argparse
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import joblib
import matplotlib.pyplot as plt
import numpy as np
from _comparison import Table, figure_file, processes
from sklearn.kernel_ridge import KernelRidge
from sklearn.linear_model import Ridge
from sklearn.model_selection import GridSearchCV, GroupKFold, GroupShuffleSplit
from sklearn.neighbors import KNeighborsRegressor
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from sklearn_raacmm import CylindricalResidualTarget, PoseFeatures, RBFNetRegressor
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.metrics import repeatability_scorer, single_point_repeatability

INPUTS = {
    "pose__joints": ["pose", "all"],
    "pose__encoding": ["angle", "periodic"],
}
# The regressor itself is a key of the grid, beside settings of its own.
REGRESSOR = "residual__regressor__regressor"
GRID = [
    {**INPUTS, REGRESSOR: [RBFNetRegressor(random_state=0)]},
    {
        **INPUTS,
        REGRESSOR: [make_pipeline(PolynomialFeatures(), Ridge())],
        f"{REGRESSOR}__polynomialfeatures__degree": [1, 2],
        f"{REGRESSOR}__ridge__alpha": [1.0, 100.0],
    },
    {
        **INPUTS,
        REGRESSOR: [KernelRidge(kernel="rbf")],
        f"{REGRESSOR}__alpha": [0.1, 1.0],
        f"{REGRESSOR}__gamma": [0.03, 0.1, 0.3],
    },
    {**INPUTS, REGRESSOR: [KNeighborsRegressor()], f"{REGRESSOR}__n_neighbors": [5, 20]},
]
NAMES = {
    RBFNetRegressor: "RBF network",
    Pipeline: "polynomial ridge",
    KernelRidge: "kernel ridge",
    KNeighborsRegressor: "nearest neighbours",
}
IN_A_NEW_PROCESS = """
import joblib, sys
model, angles = joblib.load(sys.argv[1])
joblib.dump(model.predict(angles), sys.argv[2])
"""


def build_chain(arm):
    """Build the chain: joint angles in rad in, residual dx, dy, dz in mm out."""
    return Pipeline(
        [
            ("pose", PoseFeatures(arm, append_azimuth=True)),
            (
                "residual",
                CylindricalResidualTarget(
                    Pipeline([("scaler", StandardScaler()), ("regressor", RBFNetRegressor())])
                ),
            ),
        ]
    )


def best_of_each(search):
    """Return the best score of every regressor with every choice of inputs."""
    results = search.cv_results_
    best = {}
    for params, score in zip(results["params"], results["mean_test_score"], strict=True):
        inputs = f"{params['pose__joints']}, {params['pose__encoding']}"
        key = inputs, NAMES[type(params[REGRESSOR])]
        best[key] = min(-score, best.get(key, np.inf))
    return best


def same_in_a_new_process(model, angles):
    """Save the model, let another process load it and predict, and compare bit by bit."""
    with TemporaryDirectory() as folder:
        saved, predicted = Path(folder, "model.joblib"), Path(folder, "predicted.joblib")
        joblib.dump((model, angles), saved)
        command = [sys.executable, "-c", IN_A_NEW_PROCESS, str(saved), str(predicted)]
        subprocess.run(command, check=True)
        return np.array_equal(joblib.load(predicted), model.predict(angles))


def plot(best, before):
    """Draw the scores as bars."""
    figure, axes = plt.subplots(figsize=(9, 4), layout="constrained")
    inputs = list(dict.fromkeys(key[0] for key in best))
    for i, name in enumerate(NAMES.values()):
        values = [best[key, name] for key in inputs]
        axes.bar(np.arange(len(inputs)) + 0.2 * (i - 1.5), values, 0.2, label=name)
    axes.axhline(before, color="0.4", ls="--", label="uncorrected")
    axes.set_xticks(
        range(len(inputs)),
        [f"joints={a}\nencoding={b}" for a, b in (key.split(", ") for key in inputs)],
    )
    axes.set(
        ylabel="repeatability 2S (mm)",
        title="Best setting of each, in the search's own folds (simulated)",
    )
    figure.legend(fontsize="small", loc="outside right upper")
    return figure


def main(argv=None):
    """Run the job."""
    parser = argparse.ArgumentParser(description="Search the whole chain, save the best model.")
    parser.add_argument("--positions", type=int, default=12, help="of the cone (default: 12)")
    parser.add_argument("--poses", type=int, default=40, help="at each position (default: 40)")
    parser.add_argument("--jobs", type=processes, default=2, help="processes (default: 2)")
    parser.add_argument(
        "--output", type=figure_file, default="grid_search.png", help="file of the figure"
    )
    args = parser.parse_args(argv)
    if args.positions < 6:
        parser.error(f"--positions must be at least 6 to split them, got {args.positions}.")

    try:
        data = make_single_point(args.positions, args.poses)
    except ValueError as error:
        parser.error(str(error))
    holdout = GroupShuffleSplit(1, test_size=0.25, random_state=0)
    train, test = next(holdout.split(data.data, groups=data.groups))
    angles, residuals, groups = data.data[train], data.target[train], data.groups[train]

    search = GridSearchCV(
        build_chain(data.arm),
        GRID,
        # With metadata routing off, scikit-learn's default, a scorer is told the groups beforehand.
        scoring=repeatability_scorer(angles, groups),
        cv=GroupKFold(4),
        n_jobs=args.jobs,
    ).fit(angles, residuals, groups=groups)

    best = best_of_each(search)
    print(
        f"Simulated: {args.positions} positions, {args.poses} poses at each; "
        f"{len(search.cv_results_['params'])} settings in 4 folds of positions."
    )
    print()
    table = Table(("inputs", 15, ""), ("regressor", 18, ""), ("2S (mm)", 7, ".4f"))
    for (inputs, regressor), score in sorted(best.items(), key=lambda item: item[1]):
        table.row(inputs, regressor, score)

    points, positions = data.points[test], data.groups[test]
    before = single_point_repeatability(points, positions)
    after = single_point_repeatability(points - search.predict(data.data[test]), positions)
    print()
    print(f"Best: {search.best_params_}")
    print(
        f"At {len(np.unique(positions))} positions that the search never saw: "
        f"2S {before:.4f} mm before, {after:.4f} mm after."
    )
    same = same_in_a_new_process(search.best_estimator_, data.data[test])
    print(f"Saved, loaded in a new process: predictions {'equal' if same else 'DIFFER'}.")
    plot(best, single_point_repeatability(data.points[train], groups)).savefig(args.output, dpi=100)
    print()
    print(f"Figure: {args.output}")
    if not same:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
