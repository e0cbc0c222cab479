"""The arm that an estimator was given, or the built-in one in its place."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import warnings

from sklearn_raacmm.arm._arm import Arm

_BUILT_IN = "aacmm6"


def arm_or_built_in(arm, owner, stacklevel=3):
    """The arm itself; or, with a warning in the name of its `owner`, the built-in arm CMM."""
    if arm is not None:
        return arm
    warnings.warn(
        f"{owner} was given no arm and takes the built-in arm {_BUILT_IN!r}, whose lengths are not "
        f'those of your arm. Pass arm=, or arm=Arm.from_name("{_BUILT_IN}") if you mean that one.',
        UserWarning,
        stacklevel=stacklevel,
    )
    return Arm.from_name(_BUILT_IN)


def arm_for(arm, owner, n_columns, stacklevel=4):
    """As `arm_or_built_in`; refuses angles of another number of columns than it has joints."""
    arm = arm_or_built_in(arm, owner, stacklevel)
    if n_columns != arm.n_joints:
        raise ValueError(
            f"X has {n_columns} columns, but the arm {arm!r} has {arm.n_joints} joints: one column "
            "of joint angles each is needed."
        )
    return arm
