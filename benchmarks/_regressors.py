"""The regressors that `make_results.py` compares, and the chain that holds each."""

import pickle
import time
import warnings
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.compose import TransformedTargetRegressor
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.kernel_ridge import KernelRidge
from sklearn.linear_model import Ridge
from sklearn.model_selection import GridSearchCV, GroupKFold
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer, PolynomialFeatures, StandardScaler

from sklearn_raacmm import (
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
)
from sklearn_raacmm.metrics import repeatability_scorer

# What the regressor is given: parameters of PoseFeatures by the name that the tables use.
PAPER = "pose angles"
PERIODIC = "pose angles, cos and sin"
ALL = "all joints, cos and sin"
INPUTS = {
    PAPER: {},
    PERIODIC: {"encoding": "periodic"},
    ALL: {"joints": "all", "encoding": "periodic"},
}
PLANE, ANGLES = "theta2 to theta4", "all joints"
ALPHAS = [1e-2, 1.0, 1e2, 1e4]
INNER_FOLDS = 3


class Fold(NamedTuple):
    """What one outer fold needs: a model learns from some rows and predicts others."""

    arm: object
    angles: np.ndarray  # (n, n_joints) rad
    residuals: np.ndarray  # (n, 3) mm
    positions: np.ndarray  # (n,) labels: points of one position coincide
    splits: np.ndarray  # (n,) labels that inner folds keep together
    learn: np.ndarray  # rows
    test: np.ndarray  # rows
    absolute: bool  # residuals are known in full, not only up to a constant per position


def chain(arm, regressor, inputs):
    """Build the whole model: joint angles in rad in, residual dx, dy, dz in mm out."""
    # The network has widths of its own.
    scaler = [] if isinstance(regressor, RBFNetRegressor) else [StandardScaler()]
    steps = make_pipeline(PoseFeatures(arm, **INPUTS[inputs]), *scaler, regressor)
    return CylindricalResidualTarget(steps, azimuth=arm.azimuth)


def gaussian_process(arm, inputs):
    """Gaussian process with one width per feature, found by marginal likelihood."""
    pose = PoseFeatures(arm, **INPUTS[inputs]).fit(np.zeros((1, arm.n_joints)))
    widths = np.ones(len(pose.get_feature_names_out()))
    kernel = ConstantKernel(1.0, (1e-4, 1e4)) * RBF(widths, (1e-2, 1e5)) + WhiteKernel(
        0.5, (1e-5, 1e2)
    )
    return chain(arm, GaussianProcessRegressor(kernel, normalize_y=True), inputs)


def fourier_terms(angles, order, joints):
    """Cosine and sine of every sum of whole multiples of angles, multiples up to `order` in all."""
    used = angles[:, joints]
    multiples = np.array(list(product(range(-order, order + 1), repeat=used.shape[1])))
    size = np.abs(multiples).sum(axis=1)
    # Of k and -k one is enough: the one whose first entry other than 0 is positive.
    first = np.sign(multiples[np.arange(len(multiples)), (multiples != 0).argmax(axis=1)])
    waves = used @ multiples[(size <= order) & (first > 0)].T
    return np.hstack([np.cos(waves), np.sin(waves)])


def _fourier(arm, orders, joints):
    regressor = make_pipeline(FunctionTransformer(fourier_terms), StandardScaler(), Ridge())
    settings = [{"order": order, "joints": joints} for order in orders]
    grid = {"functiontransformer__kw_args": settings, "ridge__alpha": ALPHAS}
    return _named(CylindricalResidualTarget(regressor, azimuth=arm.azimuth), "regressor", grid)


def _polynomial(arm, inputs, degree):
    # Powers of numbers far from 1 differ by more than a ridge can serve.
    terms = PolynomialFeatures(degree, include_bias=False)
    ridge = make_pipeline(terms, StandardScaler(), Ridge())
    return _chain(arm, ridge, inputs, {"ridge__alpha": ALPHAS})


def _chain(arm, regressor, inputs, grid):
    step = type(regressor).__name__.lower()
    return _named(chain(arm, regressor, inputs), f"regressor__{step}", grid)


def _named(model, prefix, grid):
    return model, {f"{prefix}__{name}": values for name, values in grid.items()}


class Newrb(RegressorMixin, BaseEstimator):
    """MATLAB's newrb: plain least squares, targets not centred, one width, so many neurons."""

    def __init__(self, n_centers=30, length_scale=1.0):
        self.n_centers, self.length_scale = n_centers, length_scale

    def fit(self, X, y):
        """Choose centres by the sum of the outputs' squared error-reduction ratios."""
        Y = np.reshape(y, (len(X), -1))
        W, chosen = self._radial(X, X), []
        for _ in range(min(self.n_centers, len(X) - 1)):
            lengths = np.square(W).sum(axis=0)
            lengths[chosen] = np.inf
            ratios = np.square(W.T @ Y) / lengths[:, None] / np.square(Y).sum(axis=0)
            chosen.append(int(np.argmax(np.square(ratios).sum(axis=1))))
            w = W[:, chosen[-1]] / np.linalg.norm(W[:, chosen[-1]])
            W -= np.outer(w, w @ W)
        self.centers_ = X[chosen]
        self.coef_ = np.linalg.lstsq(self._columns(X), y, rcond=1e-12)[0]
        return self

    def predict(self, X):
        """Radial functions and a bias."""
        return self._columns(X) @ self.coef_

    def _radial(self, X, C):
        return np.exp(-0.5 * cdist(X, C, "sqeuclidean") / self.length_scale**2)

    def _columns(self, X):
        return np.column_stack([self._radial(X, self.centers_), np.ones(len(X))])


def _newrb(arm):
    """The paper's network: MATLAB's newrb, one width for all, a given number of centres."""
    grid = {"n_centers": [10, 30], "length_scale": [1.0, 2.0, 4.0]}
    return _chain(arm, Newrb(), PAPER, grid)


def _kernel_ridge(arm, inputs, widths):
    grid = {"alpha": [1e-3, 1e-2, 1e-1, 1.0], "gamma": [1 / (2 * w**2) for w in widths]}
    return _chain(arm, KernelRidge(kernel="rbf"), inputs, grid)


def _neighbours(arm, inputs):
    nearest = KNeighborsRegressor(weights="distance")
    return _chain(arm, nearest, inputs, {"n_neighbors": [3, 10, 30]})


def _perceptron(arm, inputs):
    options = {"solver": "lbfgs", "max_iter": 200, "random_state": 0}
    network = MLPRegressor(hidden_layer_sizes=(64, 64), **options)
    # Any usual weight decay outweighs hundredths of a millimetre.
    scaled = TransformedTargetRegressor(network, transformer=StandardScaler())
    return _chain(arm, scaled, inputs, {"regressor__alpha": [1.0, 10.0]})


def _trees(arm, inputs):
    trees = ExtraTreesRegressor(100, random_state=0)
    return _chain(arm, trees, inputs, {"min_samples_leaf": [3, 10]})


# From (inputs, regressor) to a function of the arm that gives an unfitted model; or a model and
# the grid of settings among which an inner cross-validation on the training rows chooses.
MODELS = {
    **{
        (PAPER, f"polynomial ridge, degree {degree}"): (
            lambda arm, degree=degree: _polynomial(arm, PAPER, degree)
        )
        for degree in range(1, 6)
    },
    (PLANE, "Fourier ridge"): lambda arm: _fourier(arm, [1, 2, 3], [1, 2, 3]),
    (PAPER, "RBF network, newrb"): _newrb,
    (PAPER, "RBF network, one width"): lambda arm: chain(
        arm, RBFNetRegressor(length_scale="isotropic", random_state=0), PAPER
    ),
    (PAPER, "RBF network"): lambda arm: chain(arm, RBFNetRegressor(random_state=0), PAPER),
    # The paper's text also trains on dx, dy, dz as they are.
    (PAPER, "RBF network, Cartesian"): lambda arm: chain(
        arm, RBFNetRegressor(random_state=0), PAPER
    ).set_params(azimuth=None),
    (PAPER, "Gaussian process"): lambda arm: gaussian_process(arm, PAPER),
    (PAPER, "kernel ridge"): lambda arm: _kernel_ridge(arm, PAPER, [0.5, 1, 2, 4]),
    (PAPER, "nearest neighbours"): lambda arm: _neighbours(arm, PAPER),
    (PAPER, "perceptron"): lambda arm: _perceptron(arm, PAPER),
    (PAPER, "extra trees"): lambda arm: _trees(arm, PAPER),
    (ALL, "polynomial ridge, degree 2"): lambda arm: _polynomial(arm, ALL, 2),
    (ANGLES, "Fourier ridge"): lambda arm: _fourier(arm, [1, 2], list(range(arm.n_joints))),
    (ALL, "RBF network"): lambda arm: chain(arm, RBFNetRegressor(random_state=0), ALL),
    (ALL, "Gaussian process"): lambda arm: gaussian_process(arm, ALL),
    (ALL, "kernel ridge"): lambda arm: _kernel_ridge(arm, ALL, [2, 4, 8]),
    (ALL, "nearest neighbours"): lambda arm: _neighbours(arm, ALL),
    (ALL, "perceptron"): lambda arm: _perceptron(arm, ALL),
    (ALL, "extra trees"): lambda arm: _trees(arm, ALL),
    (ANGLES, "ArmResidualRegressor"): ArmResidualRegressor,
}


def run(name, fold, max_gp_rows=1000):
    """Fit one model on one fold: its prediction of the test rows, and what it costs."""
    learn = fold.learn
    if "Gaussian" in name[1] and len(learn) > max_gp_rows:  # its cost is cubic
        learn = np.sort(np.random.default_rng(0).choice(learn, max_gp_rows, replace=False))
    X, y, positions = fold.angles[learn], fold.residuals[learn], fold.positions[learn]
    model = MODELS[name](fold.arm)
    start = time.process_time()
    if isinstance(model, tuple):
        splits = fold.splits[learn]
        scoring = (
            "neg_root_mean_squared_error" if fold.absolute else repeatability_scorer(X, positions)
        )
        inner = GroupKFold(min(INNER_FOLDS, len(np.unique(splits))))
        search = GridSearchCV(*model, scoring=scoring, cv=inner)
        with warnings.catch_warnings():
            # A perceptron that is stopped early is one of the settings that are compared.
            warnings.simplefilter("ignore", ConvergenceWarning)
            search.fit(X, y, groups=splits, regressor__groups=positions)
        model = search.best_estimator_
    else:
        with warnings.catch_warnings():
            # A width of a Gaussian process runs to its bound: a feature without influence.
            warnings.filterwarnings("ignore", message=".*close to the specified.*bound")
            model.fit(X, y, groups=positions)
    seconds = time.process_time() - start
    test = fold.angles[fold.test]
    start = time.process_time()
    with warnings.catch_warnings():
        # A correction that is 0, because it did not help in the fold, is compared as such.
        warnings.filterwarnings("ignore", message="The correction is 0")
        prediction = model.predict(test)
    per_row = (time.process_time() - start) / len(test)
    return prediction, [seconds, per_row, len(pickle.dumps(model))]
