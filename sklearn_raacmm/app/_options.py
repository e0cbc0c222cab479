"""Options of the words of the command `raacmm`, one function for each word."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause


def learn(parser):
    """Add the options of ``raacmm learn``."""
    parser.add_argument("table", help="one row per pose: joint angles and position")
    parser.add_argument("--arm", required=True, help="arm file, URDF, or name of a built-in arm")
    _add_ends(parser)
    _add_learning(parser, out=None)
    _add_columns(parser)
    text = "columns of a tracker's points, or a file of points"
    parser.add_argument("--points", metavar="X,Y,Z", help=text)
    text = "a known distance in mm and its sd: of a bar in two cones, or of a cone plate moved"
    parser.add_argument("--length", action="append", metavar="FROM:TO:MM:SD", help=text)
    parser.add_argument("--lengths", metavar="CSV", help="known lengths: from, to, mm, sd in mm")
    text = "a plate of known points: position, x, y, z, sd in mm"
    parser.add_argument("--places", metavar="CSV", help=text)
    parser.add_argument("--length-sd", type=float, metavar="MM", help="sd of all known lengths")
    _add_causes(parser)
    text = "folders of corrections of earlier arms of this make"
    parser.add_argument("--like", nargs="+", metavar="FOLDER", help=text)
    parser.add_argument("--serial", help="serial number, for the report")
    parser.add_argument("--operator", help="name, for the report")


def correct(parser):
    """Add the options of ``raacmm correct``."""
    parser.add_argument("table", help="table with joint angles")
    _add_model(parser)
    parser.add_argument("--out", required=True, help="CSV to write; - is the standard output")
    _add_causes(parser)
    _add_columns(parser, labelled=False)


def check(parser):
    """Add the options of ``raacmm check``."""
    _add_today(parser, "a small test of today")
    text = "the tracker was set up anew: find the base from these poses"
    parser.add_argument("--new-base", action="store_true", help=text)
    parser.add_argument("--record", metavar="CSV", help="file to append the line of this check to")
    parser.add_argument("--chart", metavar="SVG", help="control chart of the record to write")


def register(parser):
    """Add the options of ``raacmm register``."""
    _add_today(parser, "poses with the new probe, or in the new place: 15 in two cones will do")
    _add_folder(parser)


def update(parser):
    """Add the options of ``raacmm update``."""
    _add_today(parser, "20 poses or more of the arm as it is now")
    _add_folder(parser)
    parser.add_argument("--date", help="when they were measured (today)")


def move(parser):
    """Add the options of ``raacmm move``."""
    _add_model(parser)
    text = "vector of the new probe in the last frame, mm; --probe=-5,0,250 before a sign"
    parser.add_argument("--probe", metavar="X,Y,Z", required=True, help=text)
    _add_folder(parser)


def export(parser):
    """Add the options of ``raacmm export``."""
    _add_model(parser)
    parser.add_argument("--c", metavar="FOLDER", help="C source and header")
    parser.add_argument("--onnx", metavar="FILE", help="ONNX file to write")
    parser.add_argument("--name", default="arm_correction", help="name of the C functions")
    parser.add_argument("--std", action="store_true", help="standard deviations in C, too")
    text = "functions in C take the vector of the probe, too"
    parser.add_argument("--any-probe", action="store_true", help=text)


def arm(parser):
    """Add the options of ``raacmm arm``."""
    parser.add_argument("source", nargs="?", help="arm file, URDF, or name of a built-in arm")
    _add_ends(parser)
    for layout in ("222", "223"):
        parser.add_argument(
            f"--lengths-{layout}", type=float, nargs=4,
            metavar=("SHOULDER", "UPPER", "FORE", "PROBE"),
            help=f"lengths in mm of a {'-'.join(layout)} arm",
        )  # fmt: skip
    for place in ("elbow", "wrist"):
        text = f"distance in mm at which the axes of the {place} pass each other (0)"
        parser.add_argument(f"--{place}-offset", type=float, default=0.0, metavar="MM", help=text)
    parser.add_argument("--dh", metavar="TABLE", help="table of a, alpha, d and theta offset")
    text = "the table of --dh is in the modified convention"
    parser.add_argument("--modified", action="store_true", help=text)
    text = "probe centre in the last frame, mm, for --dh"
    parser.add_argument("--probe", metavar="X,Y,Z", help=text)
    text = "write the arm's numbers into a copy of the robot's own URDF or UR kinematics"
    parser.add_argument("--into", metavar="FILE", help=text)
    text = "write a workbook to fill in: a sheet for --dh and one for poses"
    parser.add_argument("--template", metavar="XLSX", help=text)
    text = "file to write, JSON or what --into names; - is the standard output"
    parser.add_argument("--out", help=text)
    parser.add_argument("--picture", metavar="SVG", help="picture of the arm and its axes")


def plan(parser):
    """Add the options of ``raacmm plan``."""
    parser.add_argument("--arm", required=True, help="arm file, URDF, or name of a built-in arm")
    parser.add_argument("--out", required=True, help="folder to write into")
    parser.add_argument("--cones", type=int, default=8, help="number of cones (8)")
    parser.add_argument("--poses", type=int, default=12, help="poses in each cone (12)")
    text = "how far the probe may lean from the vertical, degrees (60)"
    parser.add_argument("--lean", type=float, default=60.0, metavar="DEG", help=text)


def demo(parser):
    """Add the options of ``raacmm demo``."""
    _add_learning(parser, out="raacmm-demo")
    parser.set_defaults(
        angles=None, position=None, unit=None, counts_per_turn=None, sheet=None, points=None,
        lengths=None, length=None, places=None, length_sd=None, serial="simulated",
        operator=None, base=None, tip=None, extra=None, in_order=False, like=None,
    )  # fmt: skip


def completion(parser):
    """``raacmm completion`` has no options of its own."""


def _add_causes(parser):
    text = "a cause that a column holds, such as temperature=T1, payload, time"
    parser.add_argument("--extra", nargs="+", metavar="NAME[=COLUMN]", help=text)
    text = "the rows are in the order of measurement: use the directions of the joints"
    parser.add_argument("--in-order", action="store_true", help=text)


def _add_ends(parser):
    parser.add_argument("--base", metavar="LINK", help="first link of a URDF's chain")
    parser.add_argument("--tip", metavar="LINK", help="last link of a URDF's chain: the probe")


def _add_learning(parser, out):
    parser.add_argument("--out", required=out is None, default=out, help="folder to write into")
    parser.add_argument(
        "--limit-2s", type=float, metavar="MM", help="limit of the mean 2S to judge by"
    )
    parser.add_argument("--folds", type=int, help="times that some positions are left out (5)")
    parser.add_argument("--jobs", type=int, help="folds computed at the same time (1)")
    parser.add_argument("--open", action="store_true", help="open the report in the browser")
    text = "replace the correction that the folder holds"
    parser.add_argument("--force", action="store_true", help=text)


def _add_columns(parser, labelled=True):
    parser.add_argument("--angles", metavar="Q1,Q2,...", help="columns of the joint angles")
    if labelled:
        parser.add_argument("--position", metavar="NAME", help="column of the positions' labels")
    parser.add_argument("--unit", choices=("deg", "rad"), help="unit of the joint angles")
    text = "counts of the encoders in a turn, one number or one for each joint"
    parser.add_argument("--counts-per-turn", metavar="N", help=text)
    parser.add_argument("--sheet", metavar="NAME", help="sheet of a spreadsheet, name or number")


def _add_model(parser):
    parser.add_argument("--model", required=True, help="folder written by raacmm learn")


def _add_today(parser, table):
    parser.add_argument("table", help=table)
    _add_model(parser)
    parser.add_argument("--points", metavar="X,Y,Z", help="columns of a tracker's points")
    parser.add_argument("--lengths", metavar="CSV", help="known lengths: from, to, mm, sd in mm")
    parser.add_argument("--length-sd", type=float, metavar="MM", help="sd of all known lengths")
    _add_columns(parser)


def _add_folder(parser):
    parser.add_argument("--out", help="folder to write into (that of --model)")
