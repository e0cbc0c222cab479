"""Arms, poses, and what errors do to the probe by forward kinematics rather than the Jacobian."""

import numpy as np
from scipy.spatial.transform import Rotation

from sklearn_raacmm import Arm
from sklearn_raacmm.error_model._columns import ARCSEC, Terms, columns_of

ARMS = {
    "standard": Arm.from_name("aacmm6", joint_signs=[1, -1, 1, 1, -1, 1]),
    "modified": Arm.from_name("panda", probe=(10.0, -20.0, 150.0)),
}
ARM = ARMS["standard"]
NONE = np.empty((0, 2), int)


def draw_angles(arm, n, seed=0, width=2.0):
    return np.random.default_rng(seed).uniform(-width, width, (n, arm.n_joints))


def displaced(arm, angles, errors_arcsec):
    """What small angle errors do to the probe."""
    return arm.forward(angles + errors_arcsec * ARCSEC) - arm.forward(angles)


def turned(arm, angles, frame, axis, turn):
    """Move the probe by turning frame `frame` about its axis by `turn` (n,) rad: by Rodrigues."""
    frames = arm.frames(angles)
    probe, origin = arm.forward(angles), frames[:, frame, :, 3]
    rotation = Rotation.from_rotvec(turn[:, None] * frames[:, frame, :, axis])
    return rotation.apply(probe - origin) + origin - probe


def columns_by_name(arm, rows, *causes):
    """Columns (n, 3) of gravity, kinematics, wobble and extra, each under a name of its own."""
    columns = columns_of(arm, Terms(NONE, *causes))
    assert len(set(columns.names)) == len(columns.names) == len(columns.others)
    return dict(zip(columns.names, np.moveaxis(columns.at(rows), 2, 0), strict=True))
