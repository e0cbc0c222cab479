"""Draw what an encoder, a gear, a tube and a bearing do wrong: ``python doc/draw_causes.py``.

Each cause stands above the column that `ArmResidualRegressor` has for it; writes
``doc/images/cause_*.svg``, which a narrow screen shows two in a row. Sizes are exaggerated.
"""

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Circle, Ellipse

mpl.rcParams["svg.hashsalt"] = "causes"  # the same bytes every time
DARK, TRUE, WRONG = "0.25", "0.65", "tab:orange"
TURN = np.linspace(0, 2 * np.pi, 400)


def disc(ax):
    """Draw a graduated disc that turns about another point than its centre."""
    ax.add_patch(Circle((0, 0), 1.0, fc="0.95", ec=DARK, lw=1.5))
    for angle in np.deg2rad(np.arange(0, 360, 10)):
        direction = np.array([np.cos(angle), np.sin(angle)])
        ax.plot(*np.array([0.9 * direction, direction]).T, color=DARK, lw=0.8)
    ax.plot(0, 0, "+", color=DARK, ms=10)
    ax.plot(0.25, 0.12, "o", color=WRONG, ms=7)
    ax.annotate("axis", (0.25, 0.12), (0.45, 0.42), color=WRONG, fontsize=10)
    ax.annotate("centre of the disc", (0, 0), (-0.55, -0.35), color=DARK, fontsize=10)
    ax.set(xlim=(-1.25, 1.25), ylim=(-1.25, 1.25))


def gear(ax):
    """Draw a strain-wave gear: the oval wave generator inside the toothed ring."""
    teeth = 1.0 + 0.035 * np.sign(np.sin(60 * TURN))
    ax.plot(teeth * np.cos(TURN), teeth * np.sin(TURN), color=DARK, lw=1.2)
    inner = 0.95 + 0.03 * np.sign(np.sin(58 * TURN))
    ax.plot(inner * np.cos(TURN), 0.88 * inner * np.sin(TURN), color=WRONG, lw=1.2)
    ax.add_patch(Ellipse((0, 0), 1.5, 1.25, fc="0.95", ec=DARK, lw=1.5))
    ax.text(0, 0, "wave\ngenerator", ha="center", va="center", fontsize=10, color=DARK)
    ax.set(xlim=(-1.25, 1.25), ylim=(-1.25, 1.25))


def tube(ax):
    """Draw a tube that sags under its own weight and a load."""
    x = np.linspace(0, 2, 100)
    ax.plot(x - 1, np.zeros_like(x), color=TRUE, lw=6, solid_capstyle="round")
    ax.plot(x - 1, -0.09 * x**2, color=WRONG, lw=4, solid_capstyle="round")
    ax.plot([-1, -1], [-0.5, 0.5], color=DARK, lw=6)
    ax.annotate("", (1.0, -0.95), (1.0, -0.42), arrowprops={"arrowstyle": "-|>", "color": DARK})
    ax.text(0.92, -0.85, "weight", ha="right", fontsize=10, color=DARK)
    ax.set(xlim=(-1.25, 1.25), ylim=(-1.25, 1.25))


def bearing(ax):
    """Draw an axis that nods while it turns."""
    ax.plot([-0.8, 0.8], [-0.75, -0.75], color=DARK, lw=6)
    ax.plot([0, 0], [-0.75, 0.95], color=TRUE, lw=2, ls="--")
    for tilt, style in ((-0.18, "-"), (0.18, ":")):
        top = np.array([1.7 * np.sin(tilt), -0.75 + 1.7 * np.cos(tilt)])
        ax.plot([0, top[0]], [-0.75, top[1]], color=WRONG, lw=3, ls=style)
    ax.add_patch(Ellipse((0, 0.95), 0.62, 0.16, fc="none", ec=WRONG, lw=1))
    ax.text(0.42, 0.25, "the axis nods\nonce a turn", fontsize=10, color=DARK)
    ax.set(xlim=(-1.25, 1.25), ylim=(-1.25, 1.25))


def column(ax, wave, label):
    """Draw the error over one turn, or over the elevation."""
    degrees = np.rad2deg(TURN) if label.startswith("joint") else np.linspace(-90, 90, len(TURN))
    ax.axhline(0, color="0.8", lw=1)
    ax.plot(degrees, wave, color=WRONG)
    ax.set(xlabel=label, yticks=[], xticks=np.linspace(degrees[0], degrees[-1], 5).round())
    ax.set_ylabel("error", fontsize=9)


CAUSES = {
    "an eccentric encoder": (
        disc, np.cos(TURN - 0.6) + 0.25 * np.cos(2 * TURN), "joint angle (deg)",
        "harmonics of orders 1 and 2\nof this joint",
    ),
    "a strain-wave gear": (
        gear, np.cos(20 * TURN) + 0.5 * np.cos(40 * TURN + 1), "joint angle (deg)",
        "harmonics of high orders: multiples\nof the gear ratio (drawn: 20)",
    ),
    "a tube that sags": (
        tube, np.cos(np.linspace(-np.pi / 2, np.pi / 2, len(TURN))), "elevation (deg)",
        "gravity: in proportion to the\ntorque of the load",
    ),
    "a bearing that wobbles": (
        bearing, np.sin(TURN) + 0.3 * np.sin(2 * TURN), "joint angle (deg)",
        "wobble: the axis tilts once and\ntwice a turn, in two directions",
    ),
}  # fmt: skip


def main():
    """Draw."""
    for title, (draw, wave, label, text) in CAUSES.items():
        figure, (above, below) = plt.subplots(
            2, 1, figsize=(3, 5), height_ratios=[2.2, 1], layout="constrained"
        )
        draw(above)
        above.set_aspect("equal")
        above.axis("off")
        above.set_title(title, fontsize=12)
        column(below, wave, label)
        below.set_title(text, fontsize=9.5)
        path = Path(__file__).parent / "images" / f"cause_{draw.__name__}.svg"
        figure.savefig(path, metadata={"Date": None})
        plt.close(figure)


if __name__ == "__main__":
    main()
