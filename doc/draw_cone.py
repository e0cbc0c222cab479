"""Draw an arm in a cone, and its points before and after: ``python doc/draw_cone.py``.

The data are those of the first example of README.md, a simulated single-point test. Each position
is corrected by a model of the other ones. Writes ``doc/images/cone.svg`` and, for
narrow screens, ``cone_narrow.svg``.
"""

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

from sklearn_raacmm import Arm, learn_correction
from sklearn_raacmm.datasets import make_single_point

mpl.rcParams["svg.hashsalt"] = "cone"  # the same bytes every time
DARK, BEFORE, AFTER = "0.25", "#D55E00", "#0072B2"
POSES = 5  # drawn


def side_view(ax, arm, angles):
    """Draw a few poses of one position from the side: one cone, the elbow elsewhere."""
    points = arm.forward(angles)
    frames = arm.frames(angles)[:, :, :3, 3]
    along = points.mean(axis=0) * [1, 1, 0]
    along /= np.linalg.norm(along)

    def flat(places):
        return np.stack([places @ along, places[..., 2]], axis=-1)

    heights = frames[:, 3, 2]
    shown = np.argsort(heights)[np.linspace(0, len(angles) - 1, POSES).round().astype(int)]
    for pose, alpha in zip(shown, np.linspace(0.4, 0.95, POSES), strict=True):
        chain = flat(np.vstack([[0, 0, 0], frames[pose, 1:], points[pose]]))
        ax.plot(*chain.T, "-", color=DARK, lw=3, alpha=alpha, solid_joinstyle="round")
        ax.plot(*chain[3], "o", color="white", mec=DARK, ms=6, alpha=alpha)
    ax.plot([-130, 130], [0, 0], color=DARK, lw=5, solid_capstyle="round")
    tip = flat(points.mean(axis=0))
    cone = tip + np.array([[-60, 35], [0, -8], [60, 35], [60, -75], [-60, -75]])
    ax.fill(*cone.T, color="0.75", zorder=0)
    ax.plot(*tip, "o", color=BEFORE, ms=7, zorder=5)
    ax.set_title("One cone, many poses", fontsize=11)
    ax.set_aspect("equal")
    ax.margins(0.08)
    ax.axis("off")


def scatter(ax, left, color, two_s, title):
    """Draw the deviations of a position from its mean, in micrometres."""
    ax.axhline(0, color="0.85", lw=1, zorder=0)
    ax.axvline(0, color="0.85", lw=1, zorder=0)
    ax.scatter(1e3 * left[:, 0], 1e3 * left[:, 2], 22, color=color)
    ax.set_title(f"{title}: 2S {1e3 * two_s:.0f} µm", fontsize=11)
    ax.set(xlabel="x (µm)", aspect="equal")


def draw(name, learned, angles, mosaic, size, **ratios):
    """Draw and write one file."""
    scores = learned.scores
    shown = int(np.argsort(scores.table["after"])[len(scores.table["after"]) // 2])
    rows = scores.rows_by_position[shown]
    figure, axes = plt.subplot_mosaic(mosaic, figsize=size, layout="constrained", **ratios)
    side_view(axes["arm"], learned.arm, angles[rows])
    before, after = axes["before"], axes["after"]
    scatter(before, scores.left_before[rows], BEFORE, scores.table["before"][shown], "Before")
    scatter(after, scores.left_after[rows], AFTER, scores.table["after"][shown], "After")
    before.set_ylabel("z (µm)")
    end = 1.1e3 * np.abs(scores.left_before[rows][:, [0, 2]]).max()
    for ax in (before, after):
        ax.set(xlim=(-end, end), ylim=(-end, end))
    path = Path(__file__).parent / "images" / name
    figure.savefig(path, metadata={"Date": None}, bbox_inches="tight", pad_inches=0.05)
    print(f"{name}: position {shown}; {learned.verdict}")


def main():
    """Learn, and draw the position of median scatter after correction."""
    test = make_single_point(n_positions=8, n_poses=20, bars=[500], random_state=0)
    arm = Arm.from_lengths(
        "2-2-2", shoulder=376, upper=750, fore=500, probe=113, elbow_offset=62, wrist_offset=62
    )
    learned = learn_correction(arm, test.data, test.groups, lengths=test.lengths)
    wide, narrow = [["arm", "before", "after"]], [["arm", "arm"], ["before", "after"]]
    draw("cone.svg", learned, test.data, wide, (8.2, 3.0), width_ratios=[1.15, 1, 1])
    draw("cone_narrow.svg", learned, test.data, narrow, (4.0, 4.4), height_ratios=[1.2, 1])


if __name__ == "__main__":
    main()
