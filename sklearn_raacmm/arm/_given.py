"""The arm that an estimator was given, or the built-in one in its place."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

from sklearn_raacmm.arm._arm import Arm
from sklearn_raacmm.utils import Finding

_BUILT_IN = "aacmm6"


def check_arm(arm: object) -> None:
    """Refuse what is no arm."""
    if not isinstance(arm, Arm):
        raise TypeError(f"arm must be an Arm, got {type(arm).__name__}.")


def arm_or_built_in(arm: Arm | None, owner: str) -> Arm:
    """The arm itself; or, with a warning in the name of its `owner`, the built-in arm CMM."""
    if arm is not None:
        check_arm(arm)
        return arm
    text = f"{owner} was given no arm and takes the built-in arm {_BUILT_IN!r}, whose lengths are "
    text += "not those of your arm."
    advice = f'Pass arm=, or arm=Arm.from_name("{_BUILT_IN}") if you mean that one.'
    Finding("built-in-arm", text, advice).report()
    return Arm.from_name(_BUILT_IN)


def arm_for(arm: Arm | None, owner: str, n_columns: int, extra: Any = ()) -> Arm:
    """As `arm_or_built_in`; refuses X without a column for each joint and each name in `extra`."""
    arm = arm_or_built_in(arm, owner)
    needed = f"the arm {arm!r} has {arm.n_joints} joints: one column of joint angles each is needed"
    if extra:
        needed = f"{arm.n_joints + len(extra)} are needed: the angles of {arm.n_joints} joints, "
        needed += f"then {', '.join(map(repr, extra))}"
    if n_columns != arm.n_joints + len(extra):
        raise ValueError(f"X has {n_columns} columns, but {needed}.")
    return arm
