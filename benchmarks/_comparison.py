"""What the comparisons share: the models that they compare, and the data."""

import numpy as np
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

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


def fetched(fetch, *args, **options):
    """Open data of a real arm; where they cannot be had, say where they are."""
    try:
        return fetch(*args, **options)
    except OSError as error:
        raise SystemExit(f"{error}\n\n{WHERE}") from None
