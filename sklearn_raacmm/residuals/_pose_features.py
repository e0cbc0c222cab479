"""The pose of a measuring arm: its shape, as seen in the vertical plane that its base turns."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.arm import (
    MIN_LENGTH_MM,
    Arm,
    arm_for,
    carried,
    check_angles,
    dh_theta,
    probe_points,
)
from sklearn_raacmm.utils import (
    StrOptions,
    TransformerMixin,
    VersionedEstimator,
    check_feature_names_in,
    check_features,
    check_fitted,
    chunks,
    fit_context,
    whole_fit,
)

# Rows computed at once: sines, cosines and points of a batch (about 200 bytes per row) stay in a
# core's cache.
_BATCH_ROWS = 4096
_ORIGIN = (0.0, 0.0, 0.0)
_TURN = 2 * np.pi


class PoseFeatures(TransformerMixin, VersionedEstimator):
    """Describe the pose of an arm by three angles, from its joint angles.

    What bends and misaligns a measuring arm depends on how its links hang, hardly on where its
    base points. The pose says just that: the swivel of the upper arm `theta3`, the elbow `theta4`
    and `theta_dis`, the elevation of the line from shoulder to wrist above the base plane, which
    comes from the arm's calibrated forward kinematics.

    Parameters
    ----------
    arm : Arm, default=None
        The arm. Its `pose_joints` (swivel, elbow) and `pose_frames` (shoulder, wrist) say which
        angles make the pose; features are named by the numbers of these joints. If None, the
        built-in six-joint arm CMM, ``Arm.from_name("aacmm6")``.
    angle_unit : {"rad", "deg"}, default="rad"
        Unit of the joint angles in `X`. Features are in rad in either case.
    encoding : {"angle", "periodic"}, default="angle"
        - "angle": each angle in rad. Joint angles are taken into one turn, whose ends are as far
          as can be from the angles seen in `fit`, so that a joint that turns on gives the same
          pose the same features.
        - "periodic": cosine and sine of each angle, in which a whole turn is no difference.
    joints : {"pose", "all"}, default="pose"
        - "pose": the pose, as above.
        - "all": the angles of all joints, with what the pose leaves out: the other encoders, the
          wrist, and the azimuth through joint 1.
    append_azimuth : bool, default=False
        Append the direction of the probe's azimuth, `azimuth_cos` and `azimuth_sin`, as two last
        columns for :class:`CylindricalResidualTarget`, which takes them off again.

    Attributes
    ----------
    arm_ : Arm
        The arm in use.
    turn_start_ : ndarray of shape (n_joints,)
        Where the turn of each joint angle starts, in rad.
    n_features_in_ : int
        Number of joints.
    feature_names_in_ : ndarray of shape (`n_features_in_`,)
        Names of the columns of `X`, where they are all text.

    See Also
    --------
    CylindricalResidualTarget : Regress on residuals in the frame of the azimuth.

    Notes
    -----
    With O2 and O5 the origins of the shoulder and wrist frames, equations (4) to (6) come to
    ``theta_dis = atan2(z5 - z2, hypot(x5 - x2, y5 - y2))``. It does not depend on joint 1 at all,
    nor, on an ideal arm, on the joints past the elbow's roll. Two shoulder angles share one
    elevation: the second reaches over the top.

    Input in float32 gives output in float32; the kinematics is computed in float64.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_raacmm import PoseFeatures
    >>> pose = PoseFeatures(angle_unit="deg")
    >>> angles = [[0, 60, 20, 80, 0, 30], [90, 60, 20, 80, 0, 30]]
    >>> pose.fit_transform(angles).round(3)
    array([[ 0.349,  1.396, -0.056],
           [ 0.349,  1.396, -0.056]])
    >>> pose.get_feature_names_out().tolist()
    ['theta3', 'theta4', 'theta_dis']
    """

    _parameter_constraints: dict = {
        "arm": [Arm, None],
        "angle_unit": [StrOptions({"rad", "deg"})],
        "encoding": [StrOptions({"angle", "periodic"})],
        "joints": [StrOptions({"pose", "all"})],
        "append_azimuth": ["boolean"],
    }

    def __init__(
        self,
        arm: Arm | None = None,
        *,
        angle_unit: str = "rad",
        encoding: str = "angle",
        joints: str = "pose",
        append_azimuth: bool = False,
    ) -> None:
        self.arm = arm
        self.angle_unit = angle_unit
        self.encoding = encoding
        self.joints = joints
        self.append_azimuth = append_azimuth

    @fit_context(prefer_skip_nested_validation=True)
    @whole_fit
    def fit(self, X: ArrayLike, y: ArrayLike | None = None) -> Self:
        """Check the number of joints, and find where each joint's turn starts.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_joints)
            Joint angles, in the unit of `angle_unit`.
        y : None
            Ignored.

        Returns
        -------
        self : object
            Fitted transformer.

        Raises
        ------
        ValueError
            If the number of columns is not the arm's number of joints, or `X` holds NaN or
            infinity.
        """
        X = check_features(self, X, dtype=[np.float64, np.float32])
        self.arm_: Arm = arm_for(self.arm, type(self).__name__, X.shape[1])
        factor = np.pi / 180 if self.angle_unit == "deg" else 1.0
        self.turn_start_: np.ndarray = np.array(
            [_turn_start(factor * column) for column in X.T.astype(float)]
        )
        return self

    def transform(self, X: ArrayLike) -> np.ndarray:
        """Compute the pose.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_joints)
            Joint angles, in the unit of `angle_unit`.

        Returns
        -------
        features : ndarray of shape (n_samples, n_features_out)
            Angles in rad, or cosines and sines; see `get_feature_names_out` for the columns.

        Raises
        ------
        ValueError
            If the wrist lies on the shoulder, which leaves `theta_dis` undefined, or, with
            `append_azimuth`, the probe on the base axis, which leaves its azimuth undefined.
        """
        check_fitted(self, "arm_")
        X = check_features(self, X, dtype=[np.float64, np.float32], reset=False)
        features = np.empty((len(X), len(self._names())), dtype=X.dtype)
        # All rows at once: a unit cannot be told from some of them.
        angles = check_angles(X, self.arm_.n_joints, self.angle_unit)
        turns = np.floor((angles - self.turn_start_) / _TURN)
        if turns.any():
            angles = angles - _TURN * turns
        for rows in chunks(len(X), _BATCH_ROWS):
            for i, column in enumerate(self._columns(angles[rows], rows.start)):
                features[rows, i] = column
        return features

    def _columns(self, angles, first_row):
        """Features of some rows of angles in rad, one array (n,) for each."""
        columns, probe = list(angles.T), None
        if self.joints == "pose":
            columns, probe = pose_columns(self.arm_, angles, first_row)
        elif self.append_azimuth:
            probe = probe_points(self.arm_, dh_theta(self.arm_, angles))
        if self.encoding == "periodic":
            columns = [part(column) for column in columns for part in (np.cos, np.sin)]
        if self.append_azimuth:
            columns += _checked_direction(probe, first_row)
        return columns

    def get_feature_names_out(self, input_features: ArrayLike | None = None) -> np.ndarray:
        """Get the names of the features.

        Parameters
        ----------
        input_features : array-like of str, default=None
            Only checked against the names or the number of columns seen in `fit`.

        Returns
        -------
        names : ndarray of str
            `theta3`, `theta4`, `theta_dis` by the numbers of the arm's joints, or these with
            `_cos` and `_sin` for the periodic encoding.
        """
        check_fitted(self, "arm_")
        check_feature_names_in(self, input_features)
        return np.asarray(self._names(), dtype=object)

    def _names(self):
        if self.joints == "all":
            names = [f"theta{i + 1}" for i in range(self.arm_.n_joints)]
        else:
            names = [f"theta{joint}" for joint in self.arm_.pose_joints] + ["theta_dis"]
        if self.encoding == "periodic":
            names = [f"{name}_{part}" for name in names for part in ("cos", "sin")]
        return names + (["azimuth_cos", "azimuth_sin"] if self.append_azimuth else [])

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.transformer_tags.preserves_dtype = ["float64", "float32"]
        return tags


def _turn_start(angles):
    """Start of the turn in which angles of less than a turn, or most others, stay as they are."""
    low, high = angles.min(), angles.max()
    if high - low < _TURN:
        return (low + high) / 2 - np.pi
    # Cut in the middle of the widest gap.
    places = np.sort(angles % _TURN)
    gaps = np.append(np.diff(places), places[0] + _TURN - places[-1])
    widest = np.argmax(gaps)
    start = places[widest] + gaps[widest] / 2
    return start + _TURN * np.floor(np.median((angles - start) / _TURN))


def pose_columns(arm, angles, first_row=0):
    """Compute the pose and the probe together: the sines and cosines of the joints serve both.

    Parameters
    ----------
    arm : Arm
    angles : ndarray of shape (n, n_joints)
        Joint angles in rad, checked before.
    first_row : int
        Number of the first row, for messages.

    Returns
    -------
    columns : list of ndarray of shape (n,)
        The angles of the pose's joints and theta_dis, in rad.
    probe : ndarray of shape (3, n)
        Probe points in mm.

    Raises
    ------
    ValueError
        If the wrist lies on the shoulder.
    """
    shoulder, wrist = arm.pose_frames
    fixed = [(shoulder, _ORIGIN), (wrist, _ORIGIN), (arm.n_joints, arm.probe.tolist())]
    start, end, probe = carried(arm, dh_theta(arm, angles), fixed)
    theta_dis = _elevation(end - start, arm.pose_frames, first_row)
    return [angles[:, joint - 1] for joint in arm.pose_joints] + [theta_dis], probe


def _elevation(line, pose_frames, first_row=0):
    """Elevation of lines (3, n) from shoulder to wrist, equations (4) to (6)."""
    x, y, z = line
    reach = np.hypot(x, y)
    length = np.hypot(reach, z)
    if length.min() < MIN_LENGTH_MM:
        short = np.flatnonzero(length < MIN_LENGTH_MM)
        shoulder, wrist = pose_frames
        raise ValueError(
            f"theta_dis is undefined: the origins of frames {shoulder} and {wrist} coincide, first "
            f"in row {first_row + short[0]}. Choose the arm's pose_frames (shoulder, wrist) apart."
        )
    return np.arctan2(z, reach)


def _checked_direction(points, first_row=0):
    """Cosine and sine of the azimuth of points (3, n) about the base axis, which has to exist."""
    x, y, _ = points
    radius = np.hypot(x, y)
    if radius.min() < MIN_LENGTH_MM:
        on_axis = np.flatnonzero(radius < MIN_LENGTH_MM)
        raise ValueError(
            f"The azimuth is undefined: the probe lies on the base axis, first in row "
            f"{first_row + on_axis[0]} (radius {radius[on_axis[0]]:.3g} mm). Leave such poses out."
        )
    return x / radius, y / radius
