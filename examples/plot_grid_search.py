"""
Search the whole chain, save the best model
===========================================

The chain from joint angles to residual is one scikit-learn estimator. A grid search can therefore
choose anything in it: the inputs, the regressor, its settings. Each fold holds whole positions of
the cone. A random split would put neighbours of the test rows into the training rows, and every
model would seem better than it is. The best chain is judged at positions that the search never saw.
Then it is saved, and another process loads it.

The data are simulated: 12 positions with 30 poses each. The script takes about a minute.
"""

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import joblib
import matplotlib.pyplot as plt
import numpy as np
from sklearn.kernel_ridge import KernelRidge
from sklearn.linear_model import Ridge
from sklearn.model_selection import GridSearchCV, GroupKFold, GroupShuffleSplit
from sklearn.neighbors import KNeighborsRegressor
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from sklearn_raacmm import CylindricalResidualTarget, PoseFeatures, RBFNetRegressor
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.metrics import repeatability_scorer, single_point_repeatability

data = make_single_point(n_positions=12, n_poses=30, random_state=0)
holdout = GroupShuffleSplit(1, test_size=0.25, random_state=0)
train, test = next(holdout.split(data.data, groups=data.groups))
angles, residuals, groups = data.data[train], data.target[train], data.groups[train]

# %%
# The chain and the grid
# ----------------------
# The regressor itself is a key of the grid, beside settings of its own.

chain = Pipeline(
    [
        ("pose", PoseFeatures(data.arm, append_azimuth=True)),
        (
            "residual",
            CylindricalResidualTarget(
                Pipeline([("scaler", StandardScaler()), ("regressor", RBFNetRegressor())])
            ),
        ),
    ]
)
inputs = {"pose__joints": ["pose", "all"], "pose__encoding": ["angle", "periodic"]}
regressor = "residual__regressor__regressor"
grid = [
    {**inputs, regressor: [RBFNetRegressor(random_state=0)]},
    {
        **inputs,
        regressor: [make_pipeline(PolynomialFeatures(), Ridge())],
        f"{regressor}__polynomialfeatures__degree": [1, 2],
        f"{regressor}__ridge__alpha": [1.0, 100.0],
    },
    {
        **inputs,
        regressor: [KernelRidge(kernel="rbf")],
        f"{regressor}__alpha": [0.1, 1.0],
        f"{regressor}__gamma": [0.03, 0.1],
    },
    {**inputs, regressor: [KNeighborsRegressor()], f"{regressor}__n_neighbors": [5, 20]},
]

# %%
# The search
# ----------
# With metadata routing off, which is scikit-learn's default, a scorer has to be given the groups
# beforehand, and the fit by another name; see :doc:`/user_guide/metadata_routing`.

search = GridSearchCV(
    chain, grid, scoring=repeatability_scorer(angles, groups), cv=GroupKFold(4), n_jobs=2
)
search.fit(angles, residuals, groups=groups, residual__groups=groups)
names = {
    RBFNetRegressor: "RBF network",
    Pipeline: "polynomial ridge",
    KernelRidge: "kernel ridge",
    KNeighborsRegressor: "nearest neighbours",
}
best, in_folds = {}, {}
results = search.cv_results_
folds = -np.transpose([results[f"split{i}_test_score"] for i in range(search.n_splits_)])
for params, scores in zip(results["params"], folds, strict=True):
    key = names[type(params[regressor])], f"{params['pose__joints']}, {params['pose__encoding']}"
    if scores.mean() < best.get(key, np.inf):
        best[key], in_folds[key] = scores.mean(), scores
for (name, chosen), score in sorted(best.items(), key=lambda item: item[1]):
    print(f"{name:<20} {chosen:<16} 2S {1e3 * score:.1f} µm")
for parameter, value in search.best_params_.items():
    print(f"best {parameter}: {value}")

# %%
# Positions that the search never saw
# -----------------------------------

points, positions = data.points[test], data.groups[test]
before = single_point_repeatability(points, positions)
after = single_point_repeatability(points - search.predict(data.data[test]), positions)
print(f"{len(np.unique(positions))} positions: 2S {1e3 * before:.1f} µm before, ", end="")
print(f"{1e3 * after:.1f} µm after")

# %%
# Saved, and loaded by another process
# ------------------------------------

with TemporaryDirectory() as folder:
    saved, predicted = Path(folder, "model.joblib"), Path(folder, "predicted.joblib")
    joblib.dump((search.best_estimator_, data.data[test]), saved)
    code = (
        "import joblib, sys; model, angles = joblib.load(sys.argv[1]); "
        "joblib.dump(model.predict(angles), sys.argv[2])"
    )
    subprocess.run([sys.executable, "-c", code, str(saved), str(predicted)], check=True)
    same = np.array_equal(joblib.load(predicted), search.predict(data.data[test]))
print(f"predictions in the other process: {'equal' if same else 'DIFFERENT'}")

# %%
# The scores as a figure
# ----------------------
# A bar is the mean over the folds of the search, and the dots on it are the single folds. Each fold
# has other positions, and positions differ.

figure, axes = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
choices = list(dict.fromkeys(key[1] for key in best))
colors = ("#0072B2", "#E69F00", "#009E73", "#CC79A7")
for i, (name, color) in enumerate(zip(names.values(), colors, strict=True)):
    places = np.arange(len(choices)) + 0.2 * (i - 1.5)
    axes.bar(places, [1e3 * best[name, c] for c in choices], 0.19, color=color, label=name)
    for place, chosen in zip(places, choices, strict=True):
        scores = 1e3 * in_folds[name, chosen]
        axes.plot(np.full(len(scores), place), scores, ".", color="0.2", ms=4)
uncorrected = 1e3 * single_point_repeatability(data.points[train], groups)
axes.axhline(uncorrected, color="0.3", ls="--", label="uncorrected")
labels = [f"joints={a}\nencoding={b}" for a, b in (chosen.split(", ") for chosen in choices)]
axes.set_xticks(range(len(choices)), labels)
axes.set(ylabel="2S in the search's folds (µm)", title="Best setting of each (simulated)")
figure.legend(fontsize="small", loc="outside lower center", ncols=2)
plt.show()
