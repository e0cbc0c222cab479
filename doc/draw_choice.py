"""Draw the choice of an estimator: ``python doc/draw_choice.py``.

Writes ``doc/images/choice.svg``: questions from top to bottom, and beside each what to take.
"""

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

INK, ASK, TAKE = "0.2", "#0072B2", "#D55E00"  # safe for colour-blind readers
STYLE = {"svg.fonttype": "none", "svg.hashsalt": "choice", "font.size": 10}
WIDTH, HEIGHT, STEP, BESIDE = 2.4, 0.85, 1.45, 3.1
# Question, answer that leads to the right, and what to take then.
CHOICES = [
    ("Is there an arm?", "no", "RBFNetRegressor"),
    ("Is it calibrated, and\nare residuals known?", "no", "raacmm learn, or\nlearn_correction"),
    (
        "A regressor of your own,\nor the published one?",
        "yes",
        "CylindricalResidualTarget\nwith PoseFeatures",
    ),
]
LAST = "ArmResidualRegressor"


def box(ax, x, y, text, colour):
    """A question or an answer."""
    corner = (x - WIDTH / 2, y - HEIGHT / 2)
    shape = FancyBboxPatch(
        corner, WIDTH, HEIGHT, "round,pad=0,rounding_size=0.12", fc="white", ec=colour, lw=1.6
    )
    ax.add_patch(shape)
    ax.text(x, y, text, ha="center", va="center", color=INK, fontsize=11)


def arrow(ax, start, end, label):
    """An arrow with its answer."""
    ax.add_patch(
        FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=13, lw=1.4, color=INK)
    )
    down = start[0] == end[0]
    x, y = (start[0] + end[0]) / 2, (start[1] + end[1]) / 2
    shift, ha, va = ((0.1, 0), "left", "center") if down else ((0, 0.08), "center", "bottom")
    ax.text(x + shift[0], y + shift[1], label, ha=ha, va=va, color=INK)


def main(path=Path(__file__).parent / "images" / "choice.svg"):
    """Draw and write the file."""
    other = {"yes": "no", "no": "yes"}
    with mpl.rc_context(STYLE):
        figure, ax = plt.subplots(figsize=(5.6, 5.2), layout="constrained")
        for i, (question, answer, take) in enumerate(CHOICES):
            y = -i * STEP
            box(ax, 0, y, question, ASK)
            box(ax, BESIDE, y, take, TAKE)
            arrow(ax, (WIDTH / 2, y), (BESIDE - WIDTH / 2, y), answer)
            arrow(ax, (0, y - HEIGHT / 2), (0, y - STEP + HEIGHT / 2), other[answer])
        y = -len(CHOICES) * STEP
        box(ax, 0, y, LAST, TAKE)
        ax.set(xlim=(-1.3, BESIDE + 1.3), ylim=(y - 0.5, 0.5), aspect="equal")
        ax.axis("off")
        figure.savefig(path, metadata={"Date": None, "Creator": None}, facecolor="white")
    plt.close(figure)


if __name__ == "__main__":
    main()
