"""The word ``plan``: a sheet for a first test, to be taken to the arm."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from pathlib import Path

import numpy as np

from sklearn_raacmm.app._cells import check_installed
from sklearn_raacmm.app._figures import draw_plan
from sklearn_raacmm.app._files import load_arm
from sklearn_raacmm.app._report import render
from sklearn_raacmm.correction import plan_poses
from sklearn_raacmm.utils import check_places, write_whole


def plan(options):
    """Plan a first single-point test for an arm, and write the sheet of it."""
    out = Path(options.out)
    paths = {name: out / name for name in ("plan.html", "plan.csv")}
    check_installed("jinja2", "matplotlib")
    check_places(paths.values(), [options.arm])
    arm = load_arm(options.arm)
    found = plan_poses(arm, options.cones, options.poses, lean_deg=options.lean)
    out.mkdir(parents=True, exist_ok=True)
    names = [f"q{i} [deg]" for i in range(1, arm.n_joints + 1)]
    poses = list(zip(found.groups, np.rad2deg(found.angles).tolist(), strict=True))
    lines = [",".join(["cone", *names])]
    lines += [",".join([f"cone {cone}", *(f"{value:.2f}" for value in row)]) for cone, row in poses]
    shown = {"plan": found, "names": names, "poses": poses}
    page = render("_plan.html", arm=repr(arm), figure=draw_plan(arm, found), **shown)
    write_whole({paths["plan.csv"]: "\n".join(lines) + "\n", paths["plan.html"]: page})
    print(
        f"{options.cones} cones, {options.poses} poses in each: about {found.minutes:.0f} minutes."
    )
    print("What matters is that the cones are spread over the places where you will measure.")
    print(f"Written to {out}: plan.html, plan.csv")
    return 0, {"minutes": found.minutes, "positions_mm": found.positions.tolist()}
