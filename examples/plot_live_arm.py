"""
A live arm at 1 kHz
===================

An arm's software asks for a corrected point at every reading of its encoders, a thousand times a
second. A fitted model can answer from Python, from ONNX Runtime, or as compiled C code. Here each
of them is asked once a millisecond. What matters is not the mean time but the slowest answers: how
many of them come later than the next reading?

The second part is about poses that the model does not know. Its standard deviation is large there.
A point whose correction is so uncertain is better left uncorrected, and marked as such.

The arm is simulated, with 12 positions and 40 poses each. ONNX needs ``onnxruntime`` and
``onnx`` (``pip install -e ".[onnx]"`` in the project's folder), and C needs a compiler on the
PATH. The example leaves out what is missing. It takes about ten seconds.
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import joblib
import matplotlib.pyplot as plt
import numpy as np
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import CylindricalResidualTarget, PoseFeatures, RBFNetRegressor
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.export import load_c, to_onnx

SECONDS = 1.0  # how long each way of answering is asked; more shows rarer delays
DEADLINE = 1e-3  # s

# %%
# The model
# ---------

data = make_single_point(n_positions=12, n_poses=40, random_state=0)
model = make_pipeline(
    PoseFeatures(data.arm, joints="all", encoding="periodic", append_azimuth=True),
    CylindricalResidualTarget(RBFNetRegressor(random_state=0)),
).fit(data.data, data.target, cylindricalresidualtarget__groups=data.groups)

# %%
# Three ways to answer
# --------------------
# Each takes six joint angles and returns a correction in mm. The model is saved and loaded first,
# as it would be in the arm's software.

folder = TemporaryDirectory(ignore_cleanup_errors=True)  # Windows keeps loaded libraries open
joblib.dump(model, Path(folder.name, "model.joblib"))
loaded = joblib.load(Path(folder.name, "model.joblib"))
ways = {"predict": lambda angles: loaded.predict(angles[None])[0]}
try:
    import onnxruntime

    to_onnx(loaded, Path(folder.name, "arm.onnx"))
except ImportError:
    print("ONNX is left out: it needs onnx and onnxruntime.")
else:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # one row is too little work for several threads
    session = onnxruntime.InferenceSession(
        Path(folder.name, "arm.onnx"), options, providers=["CPUExecutionProvider"]
    )
    ways["ONNX"] = lambda angles: session.run(None, {"X": angles[None]})[0][0]
try:
    ways["C, by load_c"] = load_c(loaded).correct
except RuntimeError as error:  # no compiler on the PATH
    print(f"C is left out: {error}")

# %%
# One reading every millisecond
# -----------------------------
# A hand leads the arm through poses of several positions.


def stream(path, seconds, rate=1000):
    """Joint angles between the poses of `path`, one row every 1 / rate s."""
    n = int(seconds * rate)
    places = np.linspace(0, len(path) - 1, n)
    angles = np.stack([np.interp(places, np.arange(len(path)), joint) for joint in path.T], axis=1)
    start = time.perf_counter()
    for i, row in enumerate(angles):
        while time.perf_counter() < start + i / rate:  # time.sleep is not exact enough
            pass
        yield row


def ask(answer, path, seconds):
    """Time that each answer of a stream took, s."""
    answer(path[0])  # the first call loads what it needs
    taken = []
    for angles in stream(path, seconds):
        start = time.perf_counter()
        answer(angles)
        taken.append(time.perf_counter() - start)
    return np.array(taken)


expected = model.predict(data.data)
times = {}
print(f"{'':<16}{'median, µs':>11}{'99.9 %, µs':>12}{'over 1 ms':>11}{'off predict, mm':>17}")
for name, answer in ways.items():
    gap = np.abs(np.array([answer(angles).copy() for angles in data.data]) - expected).max()
    times[name] = ask(answer, data.data[::23], SECONDS)
    median, slow = 1e6 * np.quantile(times[name], [0.5, 0.999])
    late = f"{np.mean(times[name] > DEADLINE):.2%}"
    print(f"{name:<16}{median:>11.1f}{slow:>12.1f}{late:>11}{gap:>17.0e}")
folder.cleanup()

# %%
# Out of the poses that it knows
# ------------------------------
# A correction is refused where its standard deviation is more than 1.5 times the largest one at the
# training poses.

_, known = model.predict(data.data, return_std=True)
limit = 1.5 * np.linalg.norm(known, axis=1).max()
inside = data.data[np.argmin(np.linalg.norm(data.data - data.data.mean(axis=0), axis=1))]
share = np.linspace(0, 1, 200)[:, None]
correction, std = model.predict(
    inside + share * np.array([0.0, -0.9, 1.2, -1.3, 0.6, 1.5]), return_std=True
)
share = share[:, 0]
length, std = np.linalg.norm(correction, axis=1), np.linalg.norm(std, axis=1)
refused = std > limit
print(f"limit {1e3 * limit:.0f} µm; standard deviation at the end {1e3 * std[-1]:.0f} µm")
print(f"stays uncorrected: {np.mean(refused):.0%} of the way")

# %%
# Both as a figure
# ----------------

figure, (above, below) = plt.subplots(2, 1, figsize=(6, 8), layout="constrained")
colors = {"predict": "#0072B2", "ONNX": "#D55E00", "C, by load_c": "#009E73"}
for (name, taken), style in zip(times.items(), ("-", "--", "-."), strict=False):
    slowest = np.sort(taken)[::-1]
    rank = np.arange(1, len(slowest) + 1) / len(slowest)
    above.step(1e6 * slowest, rank, style, color=colors[name], label=name)
above.axvline(1e6 * DEADLINE, color="0.3", ls=":", label="next reading")
above.set(
    xscale="log",
    yscale="log",
    xlabel="time to the answer (µs)",
    ylabel="share of answers that took longer",
    title="One row every millisecond",
    xlim=(0.5, None),  # room for the legend
)
above.legend(loc="lower left", fontsize="small")
below.plot(share, 1e3 * length, color="#0072B2", label="length of the correction")
below.plot(share, 1e3 * std, "--", color="#D55E00", label="its standard deviation")
below.axhline(1e3 * limit, color="0.3", ls=":", label="limit")
below.axvspan(share[np.argmax(refused)], 1, color="0.5", alpha=0.15, lw=0, label="refused")
below.set(
    xlabel="way from a training pose (0) to a distant pose (1)",
    ylabel="length (µm)",
    title="Leaving the poses that the model knows",
    ylim=(0, None),
)
below.legend(loc="upper left", fontsize="small")
plt.show()
