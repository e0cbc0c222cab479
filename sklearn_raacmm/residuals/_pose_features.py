"""The pose of a measuring arm: its shape, as seen in the vertical plane that its base turns.

And the triangle of shoulder, elbow and wrist, equations (2) and (3) of the published method.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils.validation import _check_feature_names_in, check_is_fitted

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.utils import (
    Floats,
    VersionedTransformer,
    check_features,
    param_checks,
    whole_fit,
)

_ORIGIN = (0.0, 0.0, 0.0)
# Part of gravity across the base axis that an arm may have, the sine of its tilt: of a simulated
# arm under 37 degrees the chain left 195 um of 166, on a wall 266 of 235, upright 16 of 44.
_MOST_ACROSS = 0.1
_TURN = 2 * np.pi


class PoseFeatures(VersionedTransformer):
    """Describe the pose of an arm by three angles, from its joint angles.

    They are the swivel of the upper arm `theta3`, the elbow `theta4` and `theta_dis`, the elevation
    of the line from shoulder to wrist above the base plane: on these an arm's errors depend most.

    Parameters
    ----------
    arm : Arm, default=None
        The arm. Its `pose_joints` (swivel, elbow) and `pose_frames` (shoulder, wrist) say which
        angles make the pose; features are named by the numbers of these joints. If None, the
        built-in six-joint arm CMM, ``Arm.from_name("aacmm6")``.
    angle_unit : {"rad", "deg"}, default="rad"
        Unit of the joint angles in `X`. Features are in rad in either case.
    encoding : {"angle", "periodic"}, default="angle"
        Each angle in rad, those of joints within one turn whose ends are as far as can be from the
        angles seen in `fit`; or "periodic": its cosine and sine.
    joints : {"pose", "all"}, default="pose"
        The pose, or the angles of all joints.
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

    Notes
    -----
    With O2 and O5 the origins of the shoulder and wrist frames, equations (4) to (6) of Gao et al.
    (2020), doi 10.1177/1729881420925638, come to
    ``theta_dis = atan2(z5 - z2, hypot(x5 - x2, y5 - y2))``. Input in float32 gives output in
    float32; the kinematics is computed in float64.

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
        "angle_unit": [param_checks.StrOptions({"rad", "deg"})],
        "encoding": [param_checks.StrOptions({"angle", "periodic"})],
        "joints": [param_checks.StrOptions({"pose", "all"})],
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

    @whole_fit(prefer_skip_nested_validation=True)
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

        Raises
        ------
        ValueError
            If the number of columns is not the arm's number of joints, or `X` holds NaN or
            infinity; if a joint slides; if the pose is asked for, and the arm's base axis is
            neither upright nor upside down, or turns with a positioner.
        """
        X = check_features(self, X, dtype=[np.float64, np.float32])
        self.arm_: Arm = Arm.or_default(self.arm, type(self).__name__, X.shape[1])
        if slides := self.arm_.slides:
            raise ValueError(
                f"joint {slides[0] + 1} of the arm slides, and these features are angles of joints "
                "that turn: take ArmResidualRegressor, which knows both."
            )
        across = float(np.hypot(*self.arm_.up[:2]))
        if self.joints == "pose" and (across > _MOST_ACROSS or self.arm_.up_frame):
            shown = ", ".join(f"{value:.2g}" for value in self.arm_.up)
            shown = f"({shown})" + f" in frame {self.arm_.up_frame}" * bool(self.arm_.up_frame)
            raise ValueError(
                f"up of the arm is {shown}, which is not along the base axis: gravity bends the "
                "arm otherwise at each angle of joint 1, and the pose does not hold that angle. "
                'Take joints="all", or ArmResidualRegressor.'
            )
        factor = np.pi / 180 if self.angle_unit == "deg" else 1.0
        self.turn_start_: np.ndarray = np.array(
            [_turn_start(factor * column) for column in X.T.astype(float)]
        )
        return self

    def transform(self, X: ArrayLike) -> Floats:
        """Compute the pose.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_joints)
            As in `fit`.

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
        X = check_features(self, X, dtype=[np.float64, np.float32], reset=False)
        angles = self.arm_.check_angles(X, self.angle_unit)
        turns = np.floor((angles - self.turn_start_) / _TURN)
        if turns.any():
            angles = angles - _TURN * turns
        columns, probe = list(angles.T), None
        if self.joints == "pose":
            columns, probe = _pose(self.arm_, angles)
        elif self.append_azimuth:
            probe = self.arm_.points_at(angles).T
        if self.encoding == "periodic":
            columns = [part(column) for column in columns for part in (np.cos, np.sin)]
        if self.append_azimuth:
            columns += _checked_direction(probe)
        features = np.empty((len(X), len(columns)), X.dtype)
        for i, column in enumerate(columns):
            features[:, i] = column
        return features

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
        check_is_fitted(self)
        _check_feature_names_in(self, input_features)
        if self.joints == "all":
            names = [f"theta{i + 1}" for i in range(self.arm_.n_joints)]
        else:
            names = [f"theta{joint}" for joint in self.arm_.pose_joints] + ["theta_dis"]
        if self.encoding == "periodic":
            names = [f"{name}_{part}" for name in names for part in ("cos", "sin")]
        names += ["azimuth_cos", "azimuth_sin"] if self.append_azimuth else []
        return np.asarray(names, dtype=object)

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


def _pose(arm, angles):
    """Columns (n,) of the pose, in rad, and probe points (3, n), mm: sines serve both."""
    shoulder, wrist = arm.pose_frames
    fixed = [(shoulder, _ORIGIN), (wrist, _ORIGIN), (arm.n_joints, arm.probe.tolist())]
    start, end, probe = arm.carried(angles, fixed)
    x, y, z = end - start
    reach = np.hypot(x, y)
    short = np.flatnonzero(np.hypot(reach, z) < Arm.MIN_LENGTH_MM)
    if short.size:
        raise ValueError(
            f"theta_dis is undefined: the origins of frames {shoulder} and {wrist} coincide, first "
            f"in row {short[0]}. Choose the arm's pose_frames (shoulder, wrist) apart."
        )
    return [angles[:, joint - 1] for joint in arm.pose_joints] + [np.arctan2(z, reach)], probe


def _checked_direction(points):
    """Cosine and sine of the azimuth of points (3, n) about the base axis, which has to exist."""
    x, y, _ = points
    radius = np.hypot(x, y)
    on_axis = np.flatnonzero(radius < Arm.MIN_LENGTH_MM)
    if on_axis.size:
        raise ValueError(
            f"The azimuth is undefined: the probe lies on the base axis, first in row {on_axis[0]} "
            f"(radius {radius[on_axis[0]]:.3g} mm). Leave such poses out."
        )
    return x / radius, y / radius


def shoulder_wrist_distance(arm: Arm, angles: ArrayLike, *, angle_unit: str = "rad") -> np.ndarray:
    """Distance from shoulder to wrist, `Dis` in equation (2).

    Parameters
    ----------
    arm : Arm
        The arm. Its `pose_frames` name the frames of the shoulder and of the wrist.
    angles : array-like of shape (n, n_joints)
        Joint angles.
    angle_unit : {"rad", "deg"}, default="rad"
        Unit of `angles`.

    Returns
    -------
    distance : ndarray of shape (n,)
        Distance of the origins O2 and O5 of the two frames, mm.

    Raises
    ------
    ValueError
        If `angles` is not finite or does not have one column for each joint.

    Notes
    -----
    With right twists and a = (0, a2, 0, a4, 0, 0), L1 = d3, L2 = hypot(a4, d5) and
    phi = atan2(a4, d5), the square of the distance is L1^2 + L2^2 + 2 L1 L2 cos(theta4 - phi). Here
    it follows from the table as it is, with its imperfect twists.

    Examples
    --------
    >>> from sklearn_raacmm import Arm, shoulder_wrist_distance
    >>> arm = Arm.from_lengths("2-2-2", shoulder=375, upper=750, fore=500, probe=100)
    >>> straight, right_angle = [0, 90, 0, 0, 0, 0], [0, 90, 0, 90, 0, 0]
    >>> shoulder_wrist_distance(arm, [straight, right_angle], angle_unit="deg").round(3)
    array([1250.   ,  901.388])
    """
    shoulder, _, wrist = _corners(arm, angles, angle_unit)
    return np.linalg.norm(wrist - shoulder, axis=0)


def elbow_angle(arm: Arm, angles: ArrayLike, *, angle_unit: str = "rad") -> np.ndarray:
    """Inner angle at the elbow, `gamma` in equation (3).

    Parameters
    ----------
    arm, angles, angle_unit
        As in :func:`shoulder_wrist_distance`; `pose_joints` name the joint of the elbow.

    Returns
    -------
    gamma : ndarray of shape (n,)
        Angle at the elbow between the directions to shoulder and wrist, rad, from 0 (folded) to pi
        (straight).

    Raises
    ------
    ValueError
        As :func:`shoulder_wrist_distance`; or if the elbow lies on the shoulder or the wrist.

    Notes
    -----
    With the sides L1 and L2 of the triangle and the distance Dis of equation (2),
    cos(gamma) = (L1^2 + L2^2 - Dis^2) / (2 L1 L2). On an ideal arm of layout 2-2-2,
    theta4 = phi +- (pi - gamma), with phi = atan2(a4, d5).

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_raacmm import Arm, elbow_angle
    >>> arm = Arm.from_lengths("2-2-2", shoulder=375, upper=750, fore=500, probe=100)
    >>> straight, right_angle = [0, 90, 0, 0, 0, 0], [0, 90, 0, 90, 0, 0]
    >>> np.rad2deg(elbow_angle(arm, [straight, right_angle], angle_unit="deg")).round(3)
    array([180.,  90.])
    """
    shoulder, elbow, wrist = _corners(arm, angles, angle_unit)
    up, down = shoulder - elbow, wrist - elbow
    shortest = min(np.linalg.norm(side, axis=0).min(initial=np.inf) for side in (up, down))
    if shortest < Arm.MIN_LENGTH_MM:
        raise ValueError(
            f"The elbow lies on the shoulder or on the wrist (distance {shortest:.3g} mm), which "
            "leaves its angle undefined. Choose the arm's pose_joints and pose_frames apart."
        )
    # The arc tangent keeps its digits where the arm is straight; the arc cosine does not.
    across = np.linalg.norm(np.cross(up, down, axis=0), axis=0)
    return np.arctan2(across, np.sum(up * down, axis=0))


def _corners(arm, angles, angle_unit):
    """Shoulder, elbow and wrist, (3, n) each, mm."""
    Arm.check(arm)
    angles = arm.check_angles(angles, angle_unit)
    first, last = arm.pose_frames
    # The axis of joint i runs through the origin of frame i - 1, in the modified convention of i.
    elbow = arm.pose_joints[1] - (arm.convention == "standard")
    fixed = [(frame, _ORIGIN) for frame in (first, elbow, last)]
    return arm.carried(angles, fixed)
