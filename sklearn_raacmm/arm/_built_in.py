"""Tables of the built-in arms, with their sources, and what arms of the usual layouts share."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

UR_NAMES = (
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint",
    "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
)  # fmt: skip


def _ur(d1, a2, a3, d4, d5, d6):
    """Arm of Universal Robots: three parallel axes, so that the pose is joint 4 and joint 3."""
    return {
        "a": [0.0, -a2, -a3, 0.0, 0.0, 0.0],
        "alpha": [90.0, 0.0, 0.0, 90.0, -90.0, 0.0],
        "d": [d1, 0.0, 0.0, d4, d5, d6],
        "pose_joints": (4, 3),
        "pose_frames": (1, 3),
        "names": UR_NAMES,
    }


def _iiwa(shoulder, upper):
    """KUKA LBR iiwa with the flange without media, 126 mm."""
    return {
        "a": [0.0] * 7,
        "alpha": [0.0, -90.0, 90.0, 90.0, -90.0, -90.0, 90.0],
        "d": [shoulder, 0.0, upper, 0.0, 400.0, 0.0, 126.0],
        "convention": "modified",
        "names": tuple(f"A{i}" for i in range(1, 8)),
    }


_UR10 = _ur(127.3, 612.0, 572.3, 163.941, 115.7, 92.2)

BUILT_IN: dict = {
    # Table 2 of article 1760190, Mathematical Problems in Engineering 2018: identified.
    "aacmm6": {
        "a": [-0.0226, 62.1163, -0.0061, 62.1025, 0.0049, 0.0],
        "alpha": [-89.9683, -90.0312, 90.0071, -90.0338, 90.0373, -90.0],
        "d": [376.5, -0.0525, 750.7422, 0.0597, 500.5566, 15.0695],
        "theta_offset": [0.0, 0.0040, 0.0466, -0.0374, 0.0127, -0.0060],
        "probe": (0.0, 0.0, 97.8110),
    },
    # Franka control interface documentation, Denavit-Hartenberg parameters; package franka_ros.
    "panda": {
        "a": [0.0, 0.0, 0.0, 82.5, -82.5, 0.0, 88.0],
        "alpha": [0.0, -90.0, 90.0, 90.0, -90.0, 90.0, 90.0],
        "d": [333.0, 0.0, 316.0, 0.0, 384.0, 0.0, 0.0],
        "probe": (0.0, 0.0, 107.0),
        "convention": "modified",
        "names": tuple(f"panda_joint{i}" for i in range(1, 8)),
    },
    # Universal Robots, "DH parameters for calculations of kinematics and dynamics"; the UR5e's are
    # those of the package ur_description, the UR16e's and the UR5's of other open kinematics too.
    "ur3": _ur(151.9, 243.65, 213.25, 112.35, 85.35, 81.9),
    "ur5": _ur(89.159, 425.0, 392.25, 109.15, 94.65, 82.3),
    "ur10": _UR10,
    "ur3e": _ur(151.85, 243.55, 213.2, 131.05, 85.35, 92.1),
    "ur5e": _ur(162.5, 425.0, 392.2, 133.3, 99.7, 99.6),
    "ur10e": _ur(180.7, 612.7, 571.55, 174.15, 119.85, 116.55),
    "ur16e": _ur(180.7, 478.4, 360.0, 174.15, 119.85, 116.55),
    # The rail is horizontal, along the z axis of the base.
    "ur10_rail": {
        **{f: [v, *_UR10[f]] for f, v in (("a", 0.0), ("alpha", -90.0), ("d", 0.0))},
        "pose_joints": (5, 4),
        "pose_frames": (2, 4),
        "names": ("rail", *UR_NAMES),
        "joint_types": "PRRRRRR",
        "limits": [(0.0, 4000.0)] + 6 * [(None, None)],
        "up": (0.0, 1.0, 0.0),
    },
    # KUKA Sunrise Toolbox (constDhDataOf14R820); for the R800 the twists and lengths of
    # explicit-robotics: shoulder at 0.34, elbow at 0.74, wrist at 1.14 m.
    "iiwa7": _iiwa(340.0, 400.0),
    "iiwa14": _iiwa(360.0, 420.0),
    # ABB, product specification IRB 120: flange at x 374, z 630 mm at zero; package
    # abb_irb120_support for the axes and the names.
    "irb120": {
        "a": [0.0, 270.0, 70.0, 0.0, 0.0, 0.0],
        "alpha": [-90.0, 0.0, -90.0, 90.0, -90.0, 0.0],
        "d": [290.0, 0.0, 0.0, 302.0, 0.0, 72.0],
        "theta_offset": [0.0, -90.0, 0.0, 0.0, 0.0, 180.0],
        "pose_joints": (4, 3),
        "pose_frames": (1, 4),
        "names": tuple(f"joint_{i}" for i in range(1, 7)),
    },
}

# Twists in degrees; all neighbouring axes cross at right angles.
TWISTS = {
    "2-2-2": (-90.0, -90.0, 90.0, -90.0, 90.0, -90.0),
    "2-2-3": (-90.0, -90.0, 90.0, -90.0, 90.0, -90.0, 0.0),
}


def usual_pose(n_joints: int, parallel: bool, convention: str) -> dict[str, Any]:
    """The fields of `Arm` that say its pose; `parallel` if its second and third axes are."""
    if n_joints < 5:
        return {"pose_joints": (1, 2), "pose_frames": (0, n_joints)}
    if parallel:  # no swivel between shoulder and elbow, as on a UR10: see Arm.from_name
        frames = (1, 3) if convention == "standard" else (2, 4)
        return {"pose_joints": (4, 3), "pose_frames": frames}
    return {"pose_joints": (3, 4), "pose_frames": (2, 5)}
