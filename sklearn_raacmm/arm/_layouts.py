"""Tables of arms of the usual layouts from the lengths that a maker's drawing has."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

# Twists in degrees; all neighbouring axes cross at right angles.
TWISTS = {
    "2-2-2": (-90.0, -90.0, 90.0, -90.0, 90.0, -90.0),
    "2-2-3": (-90.0, -90.0, 90.0, -90.0, 90.0, -90.0, 0.0),
}


def usual_pose(n_joints: int, parallel: Any, convention: str) -> dict[str, Any]:
    """The fields of `Arm` that say its pose; `parallel` if its second and third axes are."""
    if n_joints < 5:
        return {"pose_joints": (1, 2), "pose_frames": (0, n_joints)}
    if parallel:  # no swivel between shoulder and elbow, as on a UR10: see Arm.from_name
        frames = (1, 3) if convention == "standard" else (2, 4)
        return {"pose_joints": (4, 3), "pose_frames": frames}
    return {"pose_joints": (3, 4), "pose_frames": (2, 5)}
