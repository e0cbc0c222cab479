"""
Which regressor?
================

Five regressors in the same chain, on the same folds of positions of a simulated arm, with three
inputs as in the paper and with all joints; and the linear model of the arm itself.
``benchmarks/compare_regressors.py`` does this at length: every setting searched, costs, lengths,
real arms. The data are simulated.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, WhiteKernel
from sklearn.linear_model import RidgeCV
from sklearn.model_selection import GroupKFold, cross_val_predict
from sklearn.neighbors import KNeighborsRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from sklearn_raacmm import (
    CylindricalResidualTarget,
    JointHarmonicRegressor,
    PoseFeatures,
    RBFNetRegressor,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.metrics import single_point_repeatability

data = make_single_point(n_positions=10, n_poses=40, random_state=0)
folds = list(GroupKFold(5).split(data.data, groups=data.groups))
POLYNOMIAL = make_pipeline(PolynomialFeatures(2), StandardScaler(), RidgeCV(np.logspace(-3, 3, 7)))
REGRESSORS = {
    "polynomial ridge": lambda n: POLYNOMIAL,
    "nearest neighbours": lambda n: KNeighborsRegressor(10),
    "extra trees": lambda n: ExtraTreesRegressor(100, min_samples_leaf=3, random_state=0),
    "Gaussian process": lambda n: GaussianProcessRegressor(
        RBF(np.ones(n), (0.1, 1e4)) + WhiteKernel(0.3), normalize_y=True
    ),
    "RBF network": lambda n: RBFNetRegressor(random_state=0),
}
INPUTS = {
    "three pose angles": (3, {}),
    "all joints, cos and sin": (12, {"joints": "all", "encoding": "periodic"}),
}


def two_s(model, **options):
    """Mean 2S of the positions, each corrected by a model of the others, mm."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*close to the specified.*bound")
        correction = cross_val_predict(
            model, data.data, data.target, groups=data.groups, cv=folds, **options
        )
    return single_point_repeatability(data.points - correction, data.groups)


results = {}
for inputs, (n, parameters) in INPUTS.items():
    for name, regressor in REGRESSORS.items():
        steps = make_pipeline(PoseFeatures(data.arm, **parameters), StandardScaler(), regressor(n))
        model = CylindricalResidualTarget(steps, azimuth=data.arm.azimuth)
        results[inputs, name] = two_s(model)
        print(f"{inputs:<24} {name:<20} {results[inputs, name]:.4f} mm")
# This one fits an offset for each position, and has to know which rows are of one position.
linear = two_s(JointHarmonicRegressor(data.arm), params={"groups": data.groups})
print(f"{'all joints':<24} {'JointHarmonicRegressor':<20} {linear:.4f} mm")

# %%
# The terms of ``JointHarmonicRegressor`` are those that the simulation is made of: on real arms its
# lead is smaller.

before = single_point_repeatability(data.points, data.groups)
perfect = data.points - data.simulation.perfect_correction
floor = single_point_repeatability(perfect, data.groups)
figure, axes = plt.subplots(figsize=(8, 4.4), layout="constrained")
for i, (inputs, colour) in enumerate(zip(INPUTS, ("tab:orange", "tab:blue"), strict=True)):
    values = [results[inputs, name] for name in REGRESSORS]
    axes.barh(np.arange(len(values)) + 0.4 * i, values, 0.38, color=colour, label=inputs)
axes.barh(len(REGRESSORS) + 0.2, linear, 0.5, color="tab:green", label="the arm itself, linear")
axes.axvline(before, color="0.3", ls="--", lw=1, label="uncorrected")
axes.axvline(floor, color="0.3", ls=":", lw=1.5, label="noise floor")
axes.set_yticks(np.arange(len(REGRESSORS) + 1) + 0.2, [*REGRESSORS, "JointHarmonicRegressor"])
axes.set(
    xlabel="mean repeatability 2S at positions left out (mm)",
    title="Regressors in the same chain (simulated arm)",
)
axes.invert_yaxis()
axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1, 0.5))
plt.show()
