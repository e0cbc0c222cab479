"""
A live arm at 1 kHz
===================

An arm's software asks for a corrected point at every reading of its encoders, a thousand times a
second. A model that has been fitted, saved and loaded again can answer from Python, from ONNX
Runtime or as C, compiled and loaded by ``load_c``. Here each of them is asked once a millisecond,
and what counts is not the mean but the slowest answers: how many come later than the next reading?

The second part is about poses that the model does not know. It can tell: its standard deviation
grows away from what it was fitted on. A point whose correction is that uncertain is better left
uncorrected, and marked so.

The arm is simulated. ONNX needs ``onnxruntime`` and ``skl2onnx`` (``pip install -e
".[onnx]"`` in the project's folder), C a compiler on the PATH; without them the example does
without.
"""

import argparse
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import joblib
import matplotlib.pyplot as plt
import numpy as np
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import CylindricalResidualTarget, PoseFeatures, RBFNetRegressor
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.export import describe, load_c, to_onnx

DEADLINE = 1e-3  # s
# A correction is refused where it is this many times as uncertain as at the worst training pose.
REFUSE_AT = 1.5


def fit():
    """Fit the chain on a simulated cone-hole test; return the data and the model."""
    data = make_single_point(n_positions=12, n_poses=40, random_state=0)
    model = make_pipeline(
        PoseFeatures(data.arm, joints="all", encoding="periodic", append_azimuth=True),
        CylindricalResidualTarget(make_pipeline(StandardScaler(), RBFNetRegressor(random_state=0))),
    )
    return data, model.fit(data.data, data.target)


def stream(path, seconds, rate=1000):
    """Joint angles of an arm that is led through the poses of `path`, one every 1 / rate s."""
    n = int(seconds * rate)
    places = np.linspace(0, len(path) - 1, n)
    angles = np.stack([np.interp(places, np.arange(len(path)), joint) for joint in path.T], axis=1)
    start = time.perf_counter()
    for i, row in enumerate(angles):
        while time.perf_counter() < start + i / rate:  # to sleep is not exact enough
            pass
        yield row


def answers(model, folder):
    """Ways to ask: name -> function from joint angles (6,) to a correction (3,) in mm."""
    joblib.dump(model, folder / "model.joblib")
    loaded = joblib.load(folder / "model.joblib")
    ways = {"predict": lambda angles: loaded.predict(angles[None])[0]}
    try:
        import onnxruntime

        to_onnx(loaded, folder / "arm.onnx")
    except ImportError:
        print("ONNX is left out: it needs onnxruntime and skl2onnx.")
    else:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1  # more would only wait for one another
        session = onnxruntime.InferenceSession(
            folder / "arm.onnx", options, providers=["CPUExecutionProvider"]
        )
        ways["ONNX"] = lambda angles: session.run(None, {"X": angles[None]})[0][0]
    try:
        ways["C, by load_c"] = load_c(loaded).correct
    except RuntimeError as error:  # no compiler on the PATH
        print(f"C is left out: {error}")
    return ways


def ask(answer, path, seconds):
    """Seconds that each answer of a stream took."""
    answer(path[0])  # the first call loads what it needs
    taken = []
    for angles in stream(path, seconds):
        start = time.perf_counter()
        answer(angles)
        taken.append(time.perf_counter() - start)
    return np.array(taken)


def out_of_the_workspace(data, n=200):
    """Poses from the middle of the training poses to far beyond them, and the share of the way."""
    inside = data.data[np.argmin(np.linalg.norm(data.data - data.data.mean(axis=0), axis=1))]
    outside = inside + np.array([0.0, -0.9, 1.2, -1.3, 0.6, 1.5])
    share = np.linspace(0, 1, n)
    return share, inside + share[:, None] * (outside - inside)


def plot(times, share, length, std, limit):
    """Draw how many answers took longer, and how a correction's uncertainty ends its use."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4), layout="constrained")
    for name, taken in times.items():
        slowest = np.sort(taken)[::-1]
        left.step(1e6 * slowest, np.arange(1, len(slowest) + 1) / len(slowest), label=name)
    left.axvline(1e6 * DEADLINE, color="0.3", ls="--")
    left.annotate("next reading", (1.1e6 * DEADLINE, 0.2), rotation=90, va="center")
    left.set(
        xscale="log",
        yscale="log",
        xlabel="time to the answer, µs",
        ylabel="share of answers that took longer",
        title="One row a millisecond",
        xlim=(0.5, None),  # room for the legend
    )
    left.legend(loc="lower left")
    refused = std > limit
    right.plot(share, 1e3 * length, color="tab:blue", label="correction")
    right.fill_between(
        share,
        1e3 * np.maximum(length - std, 0),
        1e3 * (length + std),
        color="tab:blue",
        alpha=0.2,
        lw=0,
        label="its standard deviation",
    )
    right.plot(share, 1e3 * std, color="tab:orange", label="standard deviation")
    right.axhline(1e3 * limit, color="0.3", ls="--", label="limit")
    if refused.any():
        right.axvspan(share[np.argmax(refused)], share[-1], color="0.5", alpha=0.15, lw=0)
        right.annotate(
            "refused", (0.98, 0.03), xycoords="axes fraction", ha="right", va="bottom", color="0.3"
        )
    right.set(
        xlabel="way from the training poses (0) out of them (1)",
        ylabel="length, µm",
        title="Leaving the poses that the model knows",
        ylim=(0, None),
    )
    right.legend(loc="upper left")
    return figure


def main(argv=None):
    parser = argparse.ArgumentParser(description="Ask a model for a correction at 1 kHz.")
    parser.add_argument("--seconds", type=float, default=2.0, help="length of each stream")
    parser.add_argument("--output", type=Path, default="live_arm.png")
    args = parser.parse_args(argv)
    if not 0.01 <= args.seconds <= 3600:
        parser.error(f"--seconds must be between 0.01 and 3600, got {args.seconds:g}")

    data, model = fit()
    print(describe(model, data.data, data.target, data.groups))

    # A way through poses of several positions, as a hand would lead the arm.
    path = data.data[::23]
    with TemporaryDirectory(ignore_cleanup_errors=True) as folder:  # a loaded library may stay
        ways = answers(model, Path(folder))
        times, found = {}, {}
        for name, answer in ways.items():
            found[name] = np.array([answer(angles).copy() for angles in data.data])
            times[name] = ask(answer, path, args.seconds)
    print(f"{'':<24}{'median us':>10}{'99.9 % us':>11}{'over 1 ms':>11}{'gap to predict mm':>19}")
    for name, taken in times.items():
        median, slow = 1e6 * np.quantile(taken, [0.5, 0.999])
        gap = np.abs(found[name] - found["predict"]).max()
        late = f"{100 * np.mean(taken > DEADLINE):.2f} %"
        print(f"{name:<24}{median:>10.1f}{slow:>11.1f}{late:>11}{gap:>19.0e}")

    # The same model on its way out of what it knows.
    _, known = model.predict(data.data, return_std=True)
    limit = REFUSE_AT * np.linalg.norm(known, axis=1).max()
    share, angles = out_of_the_workspace(data)
    correction, std = model.predict(angles, return_std=True)
    length, std = np.linalg.norm(correction, axis=1), np.linalg.norm(std, axis=1)
    print(
        f"\nStandard deviation of a correction: at most {1e3 * limit / REFUSE_AT:.0f} um at the "
        f"training poses, {1e3 * std[-1]:.0f} um at the end of the way out.\n"
        f"Beyond {REFUSE_AT:g} times the former a point stays uncorrected: "
        f"{np.mean(std > limit):.0%} of that way."
    )
    plot(times, share, length, std, limit).savefig(args.output, dpi=100)
    print(f"\nFigure: {args.output}")


if __name__ == "__main__":
    main()
