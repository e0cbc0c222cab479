"""Draw the usual layouts on the page "Arms": ``python doc/draw_layouts.py``.

Writes a file for each, so that a narrow screen shows one below the other.
"""

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt

INK, SWIVEL, HINGE = "0.25", "tab:orange", "tab:blue"
STYLE = {"svg.fonttype": "none", "svg.hashsalt": "layouts", "font.size": 10}
# Corners of the arm in the drawing's plane: base, shoulder, elbow, wrist, probe.
CORNERS = ((0, 0), (0, 3), (4, 5.5), (7, 2.6), (7.9, 1.0))
LENGTHS = ("shoulder", "upper", "fore", "probe")


def draw(ax, layout):
    """One arm, with a mark for each joint."""
    for (x, z), (u, w), name in zip(CORNERS[:-1], CORNERS[1:], LENGTHS, strict=True):
        ax.plot([x, u], [z, w], color=INK, linewidth=4, zorder=1, solid_capstyle="round")
        if name == "shoulder":
            ax.text(-0.35, 1.1, name, ha="right", va="center", style="italic")
        else:
            place = (x + u) / 2 + 0.35, (z + w) / 2 + 0.15
            if name == "upper":
                place = place[0] - 0.5, place[1] + 0.45
            side = "right" if name == "upper" else "left"
            ax.text(*place, name, style="italic", ha=side)
    shares = {1: (0, 0.6), 3: (1, 0.35), 5: (2, 0.4)}
    if layout == "2-2-3":
        shares[7] = (3, 0.5)
    for joint, (link, share) in shares.items():
        (x, z), (u, w) = CORNERS[link], CORNERS[link + 1]
        place = (x + share * (u - x), z + share * (w - z))
        ax.plot(*place, "s", color=SWIVEL, markersize=9)
        shift = {1: (9, -4), 3: (3, -15)}.get(joint, (-13, -14))
        ax.annotate(str(joint), place, shift, textcoords="offset points", color=SWIVEL)
    for joint, corner in {2: 1, 4: 2, 6: 3}.items():
        ax.plot(*CORNERS[corner], "o", color=HINGE, markersize=12)
        ax.annotate(str(joint), CORNERS[corner], (6, 10), textcoords="offset points", color=HINGE)
    ax.plot(*CORNERS[-1], "o", color="tab:red", markersize=7)
    ax.plot([-1, 1], [0, 0], color=INK, linewidth=6)
    ax.set(title=f"{layout}", aspect="equal", xlim=(-2.6, 9.2), ylim=(-0.6, 7))
    ax.axis("off")


def main(folder=Path(__file__).parent / "images"):
    """Draw both and write the files."""
    with mpl.rc_context(STYLE):
        for layout in ("2-2-2", "2-2-3"):
            figure, ax = plt.subplots(figsize=(4.5, 3.2), layout="constrained")
            draw(ax, layout)
            path = folder / f"layout_{layout.replace('-', '')}.svg"
            figure.savefig(path, metadata={"Date": None, "Creator": None})
            plt.close(figure)


if __name__ == "__main__":
    main()
