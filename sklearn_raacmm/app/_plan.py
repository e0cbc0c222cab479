"""The word ``plan``: a sheet for a first test, to be taken to the arm."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from html import escape
from pathlib import Path

import numpy as np

from sklearn_raacmm.app._figures import draw_plan
from sklearn_raacmm.app._files import load_arm
from sklearn_raacmm.correction import plan_poses
from sklearn_raacmm.utils import check_places, html_table, write_whole

OK = 0
_STEPS = (
    "Fix a cone, or another seat that holds the probe's centre, near each place: some centimetres "
    "more or less do not matter, but it must not move while you measure in it.",
    "Take the poses of a cone one after another, the probe seated each time. With a hand-guided "
    "arm turn elbow and handle as far as they go between poses; a robot takes the angles of the "
    "table.",
    "Write down joint angles and the name of the cone for every pose: raacmm learn reads that "
    "table.",
    "One known distance between two cones fixes the scale of the arm: measure it if you can.",
)


def plan(options):
    """Plan a first single-point test for an arm, and write the sheet of it."""
    out = Path(options.out)
    paths = {name: out / name for name in ("plan.html", "plan.csv")}
    check_places(paths.values(), [options.arm])
    arm = load_arm(options.arm)
    found = plan_poses(arm, options.cones, options.poses, lean_deg=options.lean)
    out.mkdir(parents=True, exist_ok=True)
    names = [f"q{i} [deg]" for i in range(1, arm.n_joints + 1)]
    rows = np.rad2deg(found.angles)
    lines = [",".join(["cone", *names])]
    lines += [
        ",".join([f"cone {group}", *(f"{value:.2f}" for value in row)])
        for group, row in zip(found.groups, rows, strict=True)
    ]
    write_whole(
        {paths["plan.csv"]: "\n".join(lines) + "\n", paths["plan.html"]: _sheet(arm, found, names)}
    )
    print(
        f"{options.cones} cones, {options.poses} poses in each: about {found.minutes:.0f} minutes."
    )
    print("What matters is that the cones are spread over the places where you will measure.")
    print(f"Written to {out}: plan.html, plan.csv")
    return OK, {"minutes": found.minutes, "positions_mm": found.positions.tolist()}


def _sheet(arm, found, names):
    """The page."""
    places = [
        [number, *(f"{value:.0f}" for value in place)]
        for number, place in enumerate(found.positions, start=1)
    ]
    poses = [
        [group, *(f"{value:.0f}" for value in row)]
        for group, row in zip(found.groups, np.rad2deg(found.angles), strict=True)
    ]
    steps = "".join(f"<li>{escape(step)}</li>" for step in _STEPS)
    title = f"Plan of a first test: about {found.minutes:.0f} minutes"
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{title}</title>"
        "<style>body{font:14px sans-serif;max-width:60em;margin:2em auto}td,th{padding:0 .6em;"
        f"text-align:right}}svg{{max-width:100%}}</style><h1>{title}</h1><p>{escape(repr(arm))}</p>"
        f"<ol>{steps}</ol>{draw_plan(arm, found.positions)}"
        f"{html_table('Places of the cones', ['cone', 'x / mm', 'y / mm', 'z / mm'], places)}"
        f"{html_table('Poses, in their order', ['cone', *names], poses)}</html>\n"
    )
