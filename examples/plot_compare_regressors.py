"""
Which regressor?
================

Six regressors in the same chain, on the same folds of positions of a simulated arm: once with
three inputs as in the paper, and once with all joints. ``ArmResidualRegressor``, the linear model
of the arm itself, is shown beside them. The other methods of the literature are among the six:
polynomials, a database of residuals (nearest neighbours) and a perceptron.

The data are simulated: 10 positions with 40 poses each. The script takes about a minute. It
runs on your own data if you fill ``angles``, ``points`` and ``groups`` from your table.
``benchmarks/make_results.py`` does this at length. It searches every setting, and it measures
costs, lengths and real arms.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np
from sklearn.compose import TransformedTargetRegressor
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, WhiteKernel
from sklearn.linear_model import RidgeCV
from sklearn.model_selection import GroupKFold, cross_val_predict
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from sklearn_raacmm import (
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    position_residuals,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.metrics import repeatability_interval, single_point_repeatability

# %%
# The data
# --------
# Joint angles in rad, the arm after :func:`~sklearn_raacmm.calibrate`, and labels of positions.

data = make_single_point(n_positions=10, n_poses=40, random_state=0)
arm, angles, groups = data.arm, data.data, data.groups
points = arm.forward(angles)
residuals = position_residuals(points, groups)
folds = list(GroupKFold(5).split(angles, groups=groups))

# %%
# The regressors
# --------------
# Any regressor of scikit-learn can stand here. ``n`` is its number of inputs.

POLYNOMIAL = make_pipeline(PolynomialFeatures(2), StandardScaler(), RidgeCV(np.logspace(-3, 3, 7)))
PERCEPTRON = TransformedTargetRegressor(  # its ridge supposes targets of about unit size
    MLPRegressor(hidden_layer_sizes=(64, 64), solver="lbfgs", alpha=10.0, random_state=0),
    transformer=StandardScaler(),
)
REGRESSORS = {
    "polynomial ridge": lambda n: POLYNOMIAL,
    "nearest neighbours": lambda n: KNeighborsRegressor(10),
    "perceptron": lambda n: PERCEPTRON,
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
    """Mean 2S of the positions, each corrected by a model of the others, and its interval, mm."""
    with warnings.catch_warnings():
        # Widths of a Gaussian process at their bound; a perceptron that is stopped early.
        warnings.filterwarnings("ignore", category=ConvergenceWarning)
        correction = cross_val_predict(model, angles, residuals, groups=groups, cv=folds, **options)
    left = points - correction
    return single_point_repeatability(left, groups), repeatability_interval(left, groups)


results = {}
for inputs, (n, parameters) in INPUTS.items():
    for name, regressor in REGRESSORS.items():
        steps = make_pipeline(PoseFeatures(arm, **parameters), StandardScaler(), regressor(n))
        model = CylindricalResidualTarget(steps, azimuth=arm.azimuth)
        results[inputs, name] = two_s(model, params={"groups": groups})
        print(f"{inputs:<24} {name:<23} {1e3 * results[inputs, name][0]:.1f} µm")
# All get the position of each pose, and take the unknown offset of each position into account.
linear = two_s(ArmResidualRegressor(arm), params={"groups": groups})
print(f"{'all joints':<24} {'ArmResidualRegressor':<23} {1e3 * linear[0]:.1f} µm")

# %%
# The figure
# ----------
# The terms of ``ArmResidualRegressor`` are those that the simulation is made of: on real arms its
# lead is smaller. Lines on the bars are 95 % intervals over the choice of poses.


def bars(place, found, color, label):
    """Bars with their intervals and values."""
    values, ends = (1e3 * np.array(part) for part in zip(*found, strict=True))
    length = np.abs(ends.T - values)
    axes.barh(place, values, 0.38, xerr=length, color=color, label=label, error_kw={"lw": 1})
    for y, value, end in zip(place, values, ends[:, 1], strict=True):
        axes.text(end + 0.8, y, f"{value:.0f}", va="center", fontsize="small")


before = 1e3 * single_point_repeatability(points, groups)
floor = 1e3 * single_point_repeatability(points - data.simulation.perfect_correction, groups)
figure, axes = plt.subplots(figsize=(6.4, 5.6), layout="constrained")
rows = np.arange(len(REGRESSORS))
for i, (inputs, color) in enumerate(zip(INPUTS, ("#E69F00", "#0072B2"), strict=True)):
    bars(rows + 0.4 * i, [results[inputs, name] for name in REGRESSORS], color, inputs)
bars([len(rows) + 0.2], [linear], "0.45", "the arm itself, linear")
axes.axvline(before, color="0.2", ls="--", lw=1, label=f"uncorrected: {before:.0f}")
axes.axvline(floor, color="0.2", ls=":", lw=1.5, label=f"noise floor: {floor:.0f}")
axes.set_yticks([*(rows + 0.2), len(rows) + 0.2], [*REGRESSORS, "ArmResidualRegressor"])
axes.set(
    xlabel="mean repeatability 2S at positions left out (µm)",
    title="Regressors in the same chain (simulated arm)",
)
axes.invert_yaxis()
figure.legend(fontsize="small", loc="outside lower center", ncols=2)
plt.show()
