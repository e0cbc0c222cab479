"""Tables of arms of the usual layouts from the lengths that a maker's drawing has."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

# Twists in degrees; all neighbouring axes cross at right angles.
from typing import Any

_TWISTS = {
    "2-2-2": (-90.0, -90.0, 90.0, -90.0, 90.0, -90.0),
    "2-2-3": (-90.0, -90.0, 90.0, -90.0, 90.0, -90.0, 0.0),
}


def from_lengths(cls, layout, shoulder, upper, fore, probe, elbow_offset, wrist_offset, params):
    """Arm of class `cls`; see `Arm.from_lengths`."""
    if not (isinstance(layout, str) and layout in _TWISTS):
        raise ValueError(f"layout must be one of {sorted(_TWISTS)}, got {layout!r}.")
    twists = _TWISTS[layout]
    rest = [0.0] * (len(twists) - 6)
    return cls.from_degrees(
        a=[0.0, elbow_offset, 0.0, wrist_offset, 0.0, 0.0, *rest],
        alpha=twists,
        d=[shoulder, 0.0, upper, 0.0, fore, 0.0, *rest],
        **{"probe": (0.0, 0.0, probe), "name": f"{layout} arm", **params},
    )


def usual_pose(n_joints: int, parallel: Any, convention: str) -> dict[str, Any]:
    """Pose of an arm of so many joints; `parallel` if its second and third axes are.

    Returns
    -------
    dict
        ``pose_joints`` and ``pose_frames`` of `Arm`.
    """
    if n_joints < 5:
        return {"pose_joints": (1, 2), "pose_frames": (0, n_joints)}
    if parallel:  # no swivel between shoulder and elbow, as on a UR10: see Arm.from_name
        frames = (1, 3) if convention == "standard" else (2, 4)
        return {"pose_joints": (4, 3), "pose_frames": frames}
    return {"pose_joints": (3, 4), "pose_frames": (2, 5)}
