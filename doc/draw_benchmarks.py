"""Draw the figures of measured results: ``python doc/draw_benchmarks.py``.

Reads ``doc/benchmarks.json``, which says with which command each number was measured, and
``doc/results.json``; writes ``doc/images/bench_*.svg``. Each file says by a digest which numbers it
shows, so that a test finds a figure that is older than its numbers.
"""

import hashlib
import json
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from _results import (
    ALL,
    BENCHMARKS,
    LINEAR,
    MIXES,
    PERFECT,
    REAL,
    THREE,
    UNCORRECTED,
    read,
    simulated,
)

DOC = Path(__file__).resolve().parent
OURS, PROCESS = "#D55E00", "#0072B2"  # safe for colour-blind readers
COLOURS = ("#009E73", "#CC79A7", "#56B4E9", "0.45")
FLOOR = 1e-3  # as in ``benchmarks/bench_accuracy.py --tables``: below, a table is solved
STYLE = {"svg.fonttype": "none", "svg.hashsalt": "benchmarks", "font.size": 10}


def over_the_network(results):
    """Error of each peer over that of the network, by table: {peer: (n_tables,)}."""
    errors = np.maximum(list(results["tables"]["error"].values()), FLOOR)
    peers = results["tables"]["regressors"][1:]
    return dict(zip(peers, (errors[:, 1:] / errors[:, :1]).T, strict=True))


def error(figure, results):
    """Errors of peers over that of the network: generated problems, and tables."""
    left, right = figure.subplots(2, 1, height_ratios=(1.6, 1))
    found = results["problems"]
    names = list(found["over_gaussian_process"]["of"])
    place = np.arange(len(names))[::-1]
    process = [1 / found["over_gaussian_process"]["of"][name][0] for name in names]
    left.plot(process, place, "o", color=PROCESS, label="Gaussian process")
    peers = found["peers_over_network_300_rows"]
    for i, (name, colour) in enumerate(zip(peers["peers"], COLOURS, strict=True)):
        values = [peers["of"][problem][i] for problem in names]
        left.plot(values, place, "sD^v"[i], color=colour, label=name, mfc="none")
    left.set_yticks(place, names)
    left.set_title("Ten generated problems, 300 rows", fontsize=10)
    names_of = left.get_legend_handles_labels()
    figure.legend(*names_of, fontsize=8, ncols=3, loc="outside upper center")
    for i, ratio in enumerate(over_the_network(results).values()):
        right.plot(
            np.clip(ratio, 0.3, 20), np.full(len(ratio), -i), "o", color="0.6", ms=4, mfc="none"
        )
        right.plot(np.exp(np.log(ratio).mean()), -i, "|", color=OURS, ms=22, mew=3)
    shown = {"GP": "Gaussian process", "KernelRidge": "kernel ridge"}
    names = [shown.get(peer, peer) for peer in over_the_network(results)]
    right.set_yticks(-np.arange(len(names)), names)
    right.set_title("25 tables drawn at random; bar: mean", fontsize=10)
    for ax in (left, right):
        ax.axvline(1, color=OURS, lw=1.5)
        ax.set(xscale="log", xlabel="error over that of RBFNetRegressor()")
        ax.grid(axis="x", alpha=0.3)
        ticks = [0.5, 1, 2, 4] if ax is left else [0.5, 1, 2, 5, 10]
        ax.set_xticks(ticks, map(str, ticks))
        ax.minorticks_off()


def rows(figure, results):
    """CPU time of a fit against the number of rows."""
    ax = figure.subplots()
    found = results["problems"]["cpu_seconds_network_and_process"]
    seconds = np.array(list(found["of"].values()))  # (n_problems, n_sizes, 2)
    for i, (name, colour) in enumerate((("RBFNetRegressor", OURS), ("Gaussian process", PROCESS))):
        ax.fill_between(
            found["rows"], seconds[..., i].min(0), seconds[..., i].max(0), color=colour, alpha=0.2
        )
        ax.plot(found["rows"], np.exp(np.log(seconds[..., i]).mean(0)), "o-", color=colour,
                label=f"{name}, ten problems: mean and range")  # fmt: skip
    large = results["rows"]
    points = [(one["rows"], one["cpu_seconds"]) for one in large["found_by_itself"]]
    ax.plot(*np.transpose(points), "s--", color=OURS,
            label="RBFNetRegressor, a smooth function of 6 features")  # fmt: skip
    ax.set(xscale="log", yscale="log", xlabel="rows", ylabel="CPU time of a fit (s), one thread")
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8, loc="upper left")
    ax.set_ylim(top=2e4)
    ax.set_xticks(
        [1e3, 1e4, 1e5, 1e6, 1e7], ["1000", "10 000", "100 000", "a million", "ten million"]
    )
    ax.set_yticks([1, 10, 100, 1000], ["1", "10", "100", "1000"])


def one_row(figure, results):
    """Time of one row in Python, ONNX and C."""
    ax = figure.subplots()
    found = results["one_row"]["microseconds"]
    ways = list(next(iter(found.values())))
    for i, ((model, times), colour) in enumerate(zip(found.items(), (PROCESS, OURS), strict=True)):
        place = np.arange(len(ways)) + (0.2 if i else -0.2)
        bars = ax.barh(place, [times[way] for way in ways], 0.38, color=colour, label=model)
        ax.bar_label(bars, fmt="%g", padding=3, fontsize=9)
    ridge = results["one_row"]["ridge_predict"]
    ax.axvline(ridge, color="0.4", ls="--", lw=1)
    ax.text(ridge * 1.15, 1.9, "predict of a\nbare Ridge", va="center", fontsize=8, color="0.3")
    ax.set_yticks(np.arange(len(ways)), ways)
    ax.set(xscale="log", xlabel="time of one row (µs)", xlim=(0.2, 2000), ylim=(3.6, -0.6))
    ax.set_xticks([1, 10, 100, 1000], ["1", "10", "100", "1000"])
    ax.grid(axis="x", alpha=0.3)
    ax.legend(fontsize=9, loc="lower right")


def ideas(figure, results):
    """What is left of the deviation as causes join the arm's model."""
    ax = figure.subplots()
    found = results["ideas"]
    for i, (name, values) in enumerate(found["mean_mm"].items()):
        share = 100 * np.array(values) / values[0]
        style = "o--" if name.startswith("simulated") else "s-"
        ax.plot(share, style, color=(*COLOURS[:3], OURS, PROCESS, "0.3")[i], label=name)
    ax.set_xticks(range(len(found["steps"])), found["steps"])
    ax.set(ylabel="deviation that is left (%)", ylim=(0, 105))
    ax.grid(axis="y", alpha=0.3)
    ax.legend(fontsize=8, ncols=2, loc="lower left")


def _bars(ax, data, results, titles):
    """Mean deviation of some data sets by model, with the interval of what each model gained."""
    models = {UNCORRECTED: "0.75", THREE: COLOURS[2], ALL: PROCESS, LINEAR: OURS}
    labels = ("calibrated only", "network, the paper's inputs", "network, all joints",
              "ArmResidualRegressor")  # fmt: skip
    for i, ((model, colour), label) in enumerate(zip(models.items(), labels, strict=True)):
        found = [results.of(name, model) for name in data]
        place = np.arange(len(data)) + 0.2 * (i - 1.5)
        half = None if model == UNCORRECTED else [r["half_mm"] for r in found]
        ax.bar(place, [r["mean_mm"] for r in found], 0.19, yerr=half, color=colour, label=label,
               error_kw={"elinewidth": 1, "capsize": 2})  # fmt: skip
    for i, name in enumerate(data):
        if results.has(name, PERFECT):
            floor = results.of(name, PERFECT)["mean_mm"]
            label = "a perfect model" if i == 0 else None
            ax.plot([i - 0.42, i + 0.42], [floor, floor], "k--", lw=1, label=label)
    ax.set_xticks(range(len(data)), titles)
    ax.set(ylabel="mean deviation (mm)")
    ax.legend(fontsize=8, loc="upper left", ncols=2)
    ax.grid(axis="y", alpha=0.3)
    ax.set_axisbelow(True)


def real_arms(figure, _):
    """Mean deviation of three real robots before and after corrections."""
    ax = figure.subplots()
    _bars(ax, REAL, read(), ["Franka Panda 3", "Franka Panda 2", "UR10"])
    ax.set_title("Three real robots, at places that no stage had seen", fontsize=10)
    ax.set_ylim(top=0.52)


def simulated_arms(figure, _):
    """The same of three simulated measuring arms."""
    ax = figure.subplots()
    titles = ["gravity dominates", "both", "eccentric encoders dominate"]
    _bars(ax, [simulated(mix) for mix in MIXES], read(), titles)
    ax.set_title("Three simulated measuring arms", fontsize=10)
    ax.set_ylim(top=0.05)


FIGURES = {  # narrow enough to be read on a telephone; what of both files each one shows
    "error": (error, (6, 6), ["problems", "tables"]),
    "rows": (rows, (5.6, 4), ["problems", "rows"]),
    "one_row": (one_row, (5.6, 3), ["one_row"]),
    "ideas": (ideas, (5.6, 4), ["ideas"]),
    "real_arms": (real_arms, (5.6, 3.6), REAL),
    "simulated_arms": (simulated_arms, (5.6, 3.6), [simulated(mix) for mix in MIXES]),
}


def digest(shown, measured, results):
    """SHA-256 of the numbers that a figure shows."""
    numbers = [
        measured[name]
        if name in measured
        else [
            [results.of(name, model).get(key) for key in ("mean_mm", "half_mm")]
            for model in (UNCORRECTED, THREE, ALL, LINEAR, PERFECT)
            if results.has(name, model)
        ]
        for name in shown
    ]
    return hashlib.sha256(json.dumps(numbers, sort_keys=True).encode()).hexdigest()


def main(folder=DOC / "images"):
    """Draw and write the files."""
    measured, results = json.loads(BENCHMARKS.read_text(encoding="utf-8")), read()
    with mpl.rc_context(STYLE):
        for name, (draw, size, shown) in FIGURES.items():
            figure = plt.figure(figsize=size, layout="constrained")
            draw(figure, measured)
            said = {"Date": None, "Creator": None, "Source": digest(shown, measured, results)}
            figure.savefig(folder / f"bench_{name}.svg", metadata=said, facecolor="white")
            plt.close(figure)


if __name__ == "__main__":
    main()
