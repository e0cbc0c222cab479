"""The triangle of shoulder, elbow and wrist: equations (2) and (3) of the published method."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.arm import MIN_LENGTH_MM, Arm, carried, check_angles, check_arm

_ORIGIN = (0.0, 0.0, 0.0)


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
    if shortest < MIN_LENGTH_MM:
        raise ValueError(
            f"The elbow lies on the shoulder or on the wrist (distance {shortest:.3g} mm), which "
            "leaves its angle undefined. Choose the arm's pose_joints and pose_frames apart."
        )
    # The arc tangent keeps its digits where the arm is straight; the arc cosine does not.
    across = np.linalg.norm(np.cross(up, down, axis=0), axis=0)
    return np.arctan2(across, np.sum(up * down, axis=0))


def _corners(arm, angles, angle_unit):
    """Shoulder, elbow and wrist, (3, n) each, mm."""
    check_arm(arm)
    angles = check_angles(angles, arm.n_joints, angle_unit)
    first, last = arm.pose_frames
    # The axis of joint i runs through the origin of frame i - 1, in the modified convention of i.
    elbow = arm.pose_joints[1] - (arm.convention == "standard")
    fixed = [(frame, _ORIGIN) for frame in (first, elbow, last)]
    return carried(arm, angles, fixed)
