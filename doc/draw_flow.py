"""Draw the flow chart of the published method: ``python doc/draw_flow.py``.

Writes ``doc/images/flow.svg`` and, for narrow screens, ``flow_narrow.svg``. Solid arrows are what
happens to every reading, dashed ones what happens once, when the network learns.
"""

import pathlib

import matplotlib as mpl
import matplotlib.pyplot as plt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch
from matplotlib.path import Path

INK, MEASURE, LEARN = "0.2", "#0072B2", "#D55E00"  # safe for colour-blind readers
STYLE = {"svg.fonttype": "none", "svg.hashsalt": "flow", "font.size": 10}
WIDTH, HEIGHT = 2.75, 0.95
# Centre and text of each box; those of learning stand in the lowest row.
BOXES = {
    "angles": (0.0, 1.7, "joint angles\nof one reading"),
    "kinematics": (3.2, 3.2, "forward kinematics,\ncalibrated (eq. 1)"),
    "pose": (3.2, 1.7, "pose: $\\theta_3$, $\\theta_4$, $\\theta_{dis}$\n(eqs. 2 to 6)"),
    "network": (6.4, 1.7, "network of Gaussian\nunits (eqs. 8, 9)"),
    "back": (9.6, 1.7, "turned back to x, y, z\n(eqs. 11 to 13)"),
    "minus": (12.8, 3.2, "point minus correction\n(eq. 14)"),
    "positions": (0.0, 0.0, "many poses at each\nposition of the cone"),
    "means": (3.2, 0.0, "points minus mean\nof their position"),
    "turned": (6.4, 0.0, "radial, tangential,\naxial (eq. 10)"),
}
# The same from top to bottom, in two columns as wide as a telephone.
NARROW = {
    "positions": (0.0, 6.9),
    "means": (0.0, 5.5),
    "turned": (0.0, 4.1),
    "network": (0.0, 2.7),
    "back": (0.0, 1.3),
    "angles": (3.1, 4.1),
    "pose": (3.1, 2.7),
    "kinematics": (3.1, 1.3),
    "minus": (1.55, -0.4),
}
MARGIN = 0.25
ARROWS = [
    ("angles", "kinematics", ""),
    ("angles", "pose", ""),
    ("pose", "network", ""),
    ("network", "back", ""),
    ("kinematics", "minus", "measured point and its azimuth"),
    ("back", "minus", ""),
    ("positions", "means", ""),
    ("means", "turned", ""),
    ("turned", "network", "learn"),
]
LEARNING = ("positions", "means", "turned")


def box(ax, name, centre):
    """One step."""
    (x, y), text = centre, BOXES[name][2]
    colour = LEARN if name in LEARNING else MEASURE
    corner = (x - WIDTH / 2, y - HEIGHT / 2)
    ax.add_patch(
        FancyBboxPatch(
            corner, WIDTH, HEIGHT, "round,pad=0,rounding_size=0.12", fc="white", ec=colour, lw=1.6
        )
    )
    ax.text(x, y, text, ha="center", va="center", color=INK)


def arrow(ax, start, end, label, centres):
    """One arrow, from side to side, or up and down where the boxes stand above each other."""
    (x, y), (u, w) = centres[start], centres[end]
    if abs(x - u) < WIDTH and y != w:
        x = u = (x + u) / 2
        sign = 1 if w > y else -1
        ends = (x, y + sign * HEIGHT / 2), (u, w - sign * HEIGHT / 2)
    else:
        sign = 1 if u > x else -1
        ends = (x + sign * WIDTH / 2, y), (u - sign * WIDTH / 2, w)
    learning = start in LEARNING
    style = {"color": LEARN if learning else MEASURE, "linestyle": "--" if learning else "-"}
    style |= {"arrowstyle": "-|>", "mutation_scale": 13, "lw": 1.4}
    if x == u and any(a == x and min(y, w) < b < max(y, w) for a, b in centres.values()):
        # Around the box between.
        side = x + WIDTH / 2
        corners = [(side, y), (side + MARGIN, y), (side + MARGIN, w), (side, w)]
        ax.add_patch(FancyArrowPatch(path=Path(corners), **style))
        return
    ax.add_patch(FancyArrowPatch(*ends, **style))
    if label:
        if centres is NARROW:
            label = label.replace("point and", "point\nand")
        middle = (ends[0][0] + ends[1][0]) / 2, (ends[0][1] + ends[1][1]) / 2
        shift = (0.15, 0) if x == u else (0, 0.18)
        side = {"ha": "left", "va": "center"} if x == u else {"ha": "center", "va": "bottom"}
        ax.text(middle[0] + shift[0], middle[1] + shift[1], label, color=INK, **side)


def draw(path, centres, size, **limits):
    """Draw and write one file."""
    with mpl.rc_context(STYLE):
        figure, ax = plt.subplots(figsize=size, layout="constrained")
        for start, end, label in ARROWS:
            arrow(ax, start, end, label, centres)
        for name, centre in centres.items():
            box(ax, name, centre)
        ax.set(**limits, aspect="equal")
        ax.axis("off")
        figure.savefig(path, metadata={"Date": None, "Creator": None}, facecolor="white")
    plt.close(figure)


def main(folder=pathlib.Path(__file__).parent / "images"):
    """Draw both."""
    wide = {name: (x, y) for name, (x, y, _) in BOXES.items()}
    draw(folder / "flow.svg", wide, (10.5, 3.2), xlim=(-1.5, 14.3), ylim=(-0.6, 3.8))
    draw(folder / "flow_narrow.svg", NARROW, (4.0, 5.45), xlim=(-1.5, 4.85), ylim=(-1.0, 7.5))


if __name__ == "__main__":
    main()
