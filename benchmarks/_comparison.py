"""What the examples share: the models that they compare, and tables for the terminal."""

import argparse
import sys
import time
import warnings
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from matplotlib.backend_bases import FigureCanvasBase
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.linear_model import Ridge
from sklearn.model_selection import GridSearchCV, GroupKFold
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from sklearn_raacmm import CylindricalResidualTarget, PoseFeatures, RBFNetRegressor

# What the regressor is given: parameters of PoseFeatures by the name that the tables use.
PAPER = "pose angles"
PERIODIC = "pose angles, cos and sin"
ALL = "all joints, cos and sin"
INPUTS = {
    PAPER: {},
    PERIODIC: {"encoding": "periodic"},
    ALL: {"joints": "all", "encoding": "periodic"},
}
WHERE = """\
The data are not part of this package. They are downloaded once to scikit-learn's data folder, or to
that of --data-home. On a computer without a network, copy there what another one has downloaded, or
git clone https://github.com/platonics-delft/kinematics_calibration (commit 05a05ab, folder data, to
panda_ball_socket) and https://github.com/christianlandgraf/ipa-robot-accuracy (commit 507fba6,
Series_A/measurements_grid.csv, to ur10_tracker)."""
UNCORRECTED = ("-", "uncorrected")
ONE_WIDTH = (PAPER, "RBF network, one width")
# Another arm may need other settings: each model finds its own, from its training rows alone.
POLYNOMIAL_GRID = {PAPER: [1, 2, 3, 4, 5], ALL: [1, 2]}
ALPHAS = [1e-2, 1.0, 1e2]


def chain(arm, regressor, inputs):
    """Build the whole model: joint angles in rad in, residual dx, dy, dz in mm out."""
    # The network has widths of its own.
    scaler = [] if isinstance(regressor, RBFNetRegressor) else [StandardScaler()]
    steps = make_pipeline(PoseFeatures(arm, **INPUTS[inputs]), *scaler, regressor)
    return CylindricalResidualTarget(steps, azimuth=arm.azimuth)


def polynomial(arm, inputs, scoring, n_splits):
    """Ridge on polynomial terms, degree and ridge chosen by cross-validation by group."""
    regressor = make_pipeline(PolynomialFeatures(include_bias=False), StandardScaler(), Ridge())
    name = "regressor__pipeline"
    grid = {
        f"{name}__polynomialfeatures__degree": POLYNOMIAL_GRID[inputs],
        f"{name}__ridge__alpha": ALPHAS,
    }
    return GridSearchCV(
        chain(arm, regressor, inputs), grid, scoring=scoring, cv=GroupKFold(n_splits)
    )


def gaussian_process(arm, inputs):
    """Gaussian process with one width per feature, found by marginal likelihood."""
    pose = PoseFeatures(arm, **INPUTS[inputs]).fit(np.zeros((1, arm.n_joints)))
    widths = np.ones(len(pose.get_feature_names_out()))
    kernel = ConstantKernel(1.0, (1e-4, 1e4)) * RBF(widths, (1e-2, 1e5)) + WhiteKernel(
        0.5, (1e-5, 1e2)
    )
    return chain(arm, GaussianProcessRegressor(kernel, normalize_y=True), inputs)


def models_to_compare(arm, scoring="neg_root_mean_squared_error", n_splits=5):
    """Unfitted models by (inputs, regressor); none of their settings come from the test rows."""
    network = RBFNetRegressor(random_state=0)
    return {
        (PAPER, "polynomial ridge"): polynomial(arm, PAPER, scoring, n_splits),
        (PAPER, "Gaussian process"): gaussian_process(arm, PAPER),
        ONE_WIDTH: chain(arm, RBFNetRegressor(length_scale="isotropic", random_state=0), PAPER),
        (PAPER, "RBF network"): chain(arm, network, PAPER),
        (PERIODIC, "RBF network"): chain(arm, network, PERIODIC),
        (ALL, "polynomial ridge"): polynomial(arm, ALL, scoring, n_splits),
        (ALL, "Gaussian process"): gaussian_process(arm, ALL),
        (ALL, "RBF network"): chain(arm, network, ALL),
    }


def fit(model, angles, residuals, groups, positions=None):
    """Fit a model, which is told the positions; a search splits its rows by group."""
    if isinstance(model, GridSearchCV):
        return model.fit(angles, residuals, groups=groups, regressor__groups=positions)
    with warnings.catch_warnings():
        # A Gaussian process says so when a width runs to its bound: a feature without influence.
        warnings.filterwarnings("ignore", message=".*close to the specified.*bound")
        return model.fit(angles, residuals, groups=positions)


def in_parallel(function, calls, jobs, title=""):
    """List of results of ``function(*call)`` for each call, and the seconds they took."""
    start = time.perf_counter()
    tasks = (delayed(function)(*call) for call in calls)
    results = []
    for result in Parallel(n_jobs=jobs, return_as="generator")(tasks):
        results.append(result)
        _progress(f"{title}: {len(results)} of {len(calls)}")
    _progress("")
    return results, time.perf_counter() - start


def _progress(text):
    """Overwrite the line on a terminal; leave files and logs alone."""
    if sys.stderr.isatty():
        print(f"\r{text:<70}\r", end="", file=sys.stderr, flush=True)


def processes(text):
    """Number of processes, as joblib counts them; for argparse."""
    number = int(text)
    if number == 0:
        raise argparse.ArgumentTypeError(
            "0 processes cannot work; say 1 or more, or -1 for one per core"
        )
    return number


def fetched(fetch, *args, **options):
    """Open data of a real arm; where they cannot be had, say where they are."""
    try:
        return fetch(*args, **options)
    except OSError as error:
        raise SystemExit(f"{error}\n\n{WHERE}") from None


def figure_file(text):
    """Check the name of the figure before the work, not after it; for argparse."""
    path = Path(text)
    if not path.resolve().parent.is_dir():
        raise argparse.ArgumentTypeError(f"no such folder: {path.resolve().parent}")
    kinds = FigureCanvasBase.get_supported_filetypes()
    if path.suffix[1:].lower() not in kinds:
        raise argparse.ArgumentTypeError(
            f"{text} must end in one of {', '.join(f'.{kind}' for kind in sorted(kinds))}"
        )
    return path


class Table:
    """A table for the terminal whose rows appear as soon as they are known."""

    def __init__(self, *columns):
        self.widths = [max(width, len(name)) for name, width, _ in columns]
        self.formats = [form for *_, form in columns]
        self._print([name for name, *_ in columns])
        print("  ".join("-" * width for width in self.widths))

    def row(self, *values):
        """Print one row; None leaves a field empty."""
        self._print(
            "" if value is None else format(value, form)
            for value, form in zip(values, self.formats, strict=True)
        )

    def _print(self, texts):
        # Words to the left, numbers to the right.
        aligned = [
            f"{text:>{width}}" if form else f"{text:<{width}}"
            for text, width, form in zip(texts, self.widths, self.formats, strict=True)
        ]
        print("  ".join(aligned).rstrip(), flush=True)
