"""Draw the arm with its pose and the frame of its residual: ``python doc/draw_arm.py``.

The corners are computed from an arm's table. Writes ``doc/images/arm_side.svg`` and
``arm_above.svg``, which a narrow screen shows one below the other.
"""

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Arc

from sklearn_raacmm import Arm, PoseFeatures

mpl.rcParams["svg.hashsalt"] = "arm"  # the same bytes every time
DARK, ANGLE, LINE, RESIDUAL = "0.25", "tab:red", "tab:blue", "tab:orange"
# Table of the built-in arm, rounded; the swivel turned such that the arm lies in one plane.
ARM = Arm.from_degrees(
    a=[0, 62, 0, 62, 0, 0],
    alpha=[-90, -90, 90, -90, 90, -90],
    d=[376.5, 0, 750, 0, 500, 15],
    probe=(0, 0, 98),
)
POSE = np.array([[0.0, 145.0, 0.0, -112.0, 0.0, 35.0]])  # deg


def arc(ax, centre, radius, start, end, text, at=None, color=ANGLE, push=1.25):
    """Draw an angle in degrees with its name."""
    ax.add_patch(Arc(centre, 2 * radius, 2 * radius, theta1=start, theta2=end, color=color, lw=1.5))
    middle = np.deg2rad((start + end) / 2 if at is None else at)
    place = centre + push * radius * np.array([np.cos(middle), np.sin(middle)])
    ax.text(*place, text, color=color, ha="center", va="center", fontsize=12)


def side_view(ax):
    """Draw the vertical plane of the arm: shoulder, elbow, wrist, and the angles of the pose."""
    frames = ARM.frames(POSE, angle_unit="deg")[0]
    origins = frames[:, :, 3]
    probe = ARM.forward(POSE, angle_unit="deg")[0]
    # The plane is that of the base axis and the probe; seen such that the arm reaches right.
    flat = lambda p: np.array([np.hypot(*p[:2]) * np.sign(p @ [*probe[:2], 0]), p[2]])  # noqa: E731
    o1, o2, o3, o5, tip = (flat(p) for p in (origins[1], origins[2], origins[3], origins[5], probe))
    o4 = flat(origins[4])
    ax.plot([-120, 120], [0, 0], color=DARK, lw=5, solid_capstyle="round")
    ax.plot(*np.array([[0, 0], o1]).T, color=DARK, lw=7)
    ax.plot(*np.array([o1, o2, o3, o4, o5, tip]).T, color=DARK, lw=4, solid_joinstyle="round")
    for place, name, shift in ((o2, "$O_2$", (35, -75)), (o5, "$O_5$", (30, 25))):
        ax.plot(*place, "o", ms=9, color="white", mec=DARK, mew=2, zorder=5)
        ax.text(*(place + shift), name, fontsize=13)
    ax.plot(*tip, "o", ms=9, color=RESIDUAL, zorder=5)
    ax.text(*np.add(tip, (22, -55)), "probe in\nthe cone", fontsize=10, va="center", color=RESIDUAL)
    ax.plot(*np.array([o2, o5]).T, "--", color=LINE, lw=1.5)
    ax.text(*(0.35 * o2 + 0.65 * o5 + [-60, 35]), "Dis", color=LINE, fontsize=12)
    # theta_dis: elevation of the line above the base plane.
    ax.plot([o2[0], o2[0] + 420], [o2[1]] * 2, ":", color="0.5")
    elevation = np.rad2deg(PoseFeatures(ARM, angle_unit="deg").fit_transform(POSE)[0, 2])
    low, high = sorted((0.0, elevation))
    arc(ax, o2, 330, low, high, r"$\theta_{dis}$", push=1.18)
    # theta4: how far the forearm is bent away from the upper arm's direction.
    along, beyond = o3 - o2, o5 - o4
    ax.plot(*np.array([o3, o3 + 0.28 * along]).T, ":", color="0.5")
    directions = [np.rad2deg(np.arctan2(*v[::-1])) for v in (beyond, along)]
    arc(ax, o3, 120, *directions, r"$\theta_4$", push=1.45)
    # theta3: the upper arm's roll about itself.
    middle, angle = o2 + 0.5 * along, directions[1]
    roll = Arc(middle, 60, 170, angle=angle, theta1=-60, theta2=240, color=ANGLE, lw=1.5)
    ax.add_patch(roll)
    ax.text(*np.add(middle, (-150, 45)), r"$\theta_3$", color=ANGLE, fontsize=12)
    ax.text(*(o2 + 0.8 * along + [-40, 0]), "upper arm", fontsize=9, ha="right")
    ax.text(*(o4 + 0.5 * beyond + [35, 20]), "forearm", fontsize=9)
    ax.text(-45, 150, "base swivel " + r"$\theta_1$", fontsize=9, ha="right")
    ax.set(xlim=(-420, 1200), ylim=(-80, 1300))
    ax.set_title("In the vertical plane of the arm: its pose", fontsize=11)


def top_view(ax):
    """Draw the arm from above: the residual in the frame of the probe's azimuth."""
    phi, reach = np.deg2rad(35), 900.0
    tip = reach * np.array([np.cos(phi), np.sin(phi)])
    radial, tangential = np.array([[np.cos(phi), np.sin(phi)], [-np.sin(phi), np.cos(phi)]])
    ax.plot(*np.array([[0, 0], tip]).T, color=DARK, lw=4)
    ax.plot(0, 0, "o", ms=16, color=DARK)
    ax.annotate("", (1000, 0), (0, 0), arrowprops={"arrowstyle": "->", "color": "0.5"})
    ax.annotate("", (0, 850), (0, 0), arrowprops={"arrowstyle": "->", "color": "0.5"})
    ax.text(1010, -10, "x", color="0.4", va="center")
    ax.text(-15, 860, "y", color="0.4", ha="center")
    arc(ax, np.zeros(2), 300, 0, 35, r"azimuth $\varphi$", color=LINE, push=1.62)
    ax.plot(*tip, "o", ms=9, color=RESIDUAL, zorder=5)
    for direction, name, shift in (
        (radial, "radial", (12, 0)),
        (tangential, "tangential", (-30, 25)),
    ):
        end = tip + 260 * direction
        arrow = {"arrowstyle": "-|>", "color": RESIDUAL, "lw": 2}
        ax.annotate("", end, tip, arrowprops=arrow)
        ax.text(*(end + shift), name, color=RESIDUAL, fontsize=11, va="center")
    ax.text(*np.add(tip, (45, -70)), "axial: towards you", color=RESIDUAL, fontsize=10)
    ax.set(xlim=(-100, 1330), ylim=(-120, 980))
    ax.set_title("From above: the frame of its residual", fontsize=11)


def main():
    """Draw both views."""
    for name, draw in (("side", side_view), ("above", top_view)):
        figure, ax = plt.subplots(figsize=(4.8, 4.4), layout="constrained")
        draw(ax)
        ax.set_aspect("equal")
        ax.set_anchor("N")  # titles at one height
        ax.axis("off")
        path = Path(__file__).parent / "images" / f"arm_{name}.svg"
        figure.savefig(path, metadata={"Date": None})
        plt.close(figure)


if __name__ == "__main__":
    main()
