"""Draw the card of an example that was not run: ``python doc/draw_not_run.py``.

The gallery shows it where the data of an example were missing when the pages were built. Writes
``doc/images/not_run.png``.
"""

from pathlib import Path

import matplotlib.pyplot as plt


def main():
    """Say on a plain ground that there is no figure."""
    figure = plt.figure(figsize=(6.4, 4.48), facecolor="0.93")
    figure.text(0.5, 0.58, "No figure", ha="center", va="center", fontsize=30, color="0.25")
    words = "The measured data were not there\nwhen these pages were built."
    figure.text(0.5, 0.38, words, ha="center", va="center", fontsize=17, color="0.25")
    figure.savefig(Path(__file__).parent / "images" / "not_run.png", metadata={"Software": None})


if __name__ == "__main__":
    main()
