"""Time a row in C and in ONNX against `predict`, and how far they are from it.

    python benchmarks/bench_export.py

C is timed in a loop in C, one row a call; ONNX and `predict` one row a call and in one batch. CPU
time, best of five.
"""

import ctypes
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import CylindricalResidualTarget, PoseFeatures, RBFNetRegressor
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.export import export_c, to_onnx

LOOP = """
#include "arm.h"
void correct_rows(const double *q, double *out, long n)
{ for (long i = 0; i < n; ++i) arm_correct(q + 6 * i, out + 3 * i); }
void point_rows(const double *q, double *out, long n)
{ for (long i = 0; i < n; ++i) arm_point(q + 6 * i, out + 3 * i); }
"""


def best(function, repeats=5):
    """Return the least CPU time of a call in s."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return min(times)


def compiled(model, compiler, folder, flags, std=False):
    """Return the library of a model with loops over rows."""
    source, _ = export_c(model, folder / "arm.c", std=std)
    (folder / "loop.c").write_text(LOOP)
    library = folder / f"{compiler}{len(list(folder.iterdir()))}.so"
    command = [compiler, "-std=c99", *flags, "-shared", "-fPIC", "-o", library, source]
    subprocess.run([*command, folder / "loop.c", "-lm"], check=True)
    return ctypes.CDLL(library)


def one_by_one(call, X, n_rows=300):
    """Return the CPU time of a call of one row in s."""
    return best(lambda: [call(X[i : i + 1]) for i in range(n_rows)]) / n_rows


def main(n_rows=100_000, n_centers=60):
    data = make_single_point(n_positions=12, n_poses=40, random_state=0)
    X = np.random.default_rng(0).uniform(-np.pi, np.pi, (n_rows, 6))
    print(f"{n_centers} centres, {n_rows} rows, CPU microseconds a row, largest gap to predict\n")
    print(f"{'features':<24}{'':<28}{'us / row':>10}{'gap mm':>10}")
    for joints, encoding in (("pose", "angle"), ("all", "periodic")):
        model = make_pipeline(
            PoseFeatures(data.arm, joints=joints, encoding=encoding, append_azimuth=True),
            CylindricalResidualTarget(
                make_pipeline(StandardScaler(), RBFNetRegressor(n_centers, random_state=0))
            ),
        ).fit(data.data, data.target)
        expected = model.predict(X)
        inputs = f"{joints}, {encoding}"

        def row(name, seconds, result=None, inputs=inputs, expected=expected):
            gap = "" if result is None else f"{np.abs(result - expected).max():.0e}"
            print(f"{inputs:<24}{name:<28}{1e6 * seconds:>10.2f}{gap:>10}")

        for compiler in filter(shutil.which, ("gcc", "clang")):
            with tempfile.TemporaryDirectory() as folder:
                for flags in (["-O2"], ["-O3", "-march=native"]):
                    library = compiled(model, compiler, Path(folder), flags)
                    out = np.empty((n_rows, 3))
                    for name in ("correct", "point"):
                        function = getattr(library, f"{name}_rows")
                        arguments = (X.ctypes.data_as(ctypes.c_void_p),)
                        arguments += (out.ctypes.data_as(ctypes.c_void_p), ctypes.c_long(n_rows))
                        seconds = best(lambda f=function, a=arguments: f(*a)) / n_rows
                        result = out if name == "correct" else data.arm.forward(X) - out
                        row(f"{compiler} {' '.join(flags)} {name}", seconds, result)
        row("predict, one batch", best(lambda m=model: m.predict(X)) / n_rows)
        row("predict, one row a call", one_by_one(model.predict, X))
        try:
            import onnxruntime
        except ImportError:
            print("onnxruntime is not installed: left out")
            continue
        for dtype, kind in (("double", np.float64), ("float", np.float32)):
            options = onnxruntime.SessionOptions()
            options.intra_op_num_threads = 1
            session = onnxruntime.InferenceSession(
                to_onnx(model, dtype=dtype).SerializeToString(),
                options,
                providers=["CPUExecutionProvider"],
            )
            given = X.astype(kind)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                exact = model.predict(given.astype(float))
            result = session.run(None, {"X": given})[0]
            seconds = best(lambda s=session, g=given: s.run(None, {"X": g})) / n_rows
            row(f"ONNX {dtype}, one batch", seconds, result - exact + expected)
            seconds = one_by_one(lambda rows, s=session: s.run(None, {"X": rows}), given)
            row(f"ONNX {dtype}, one row a call", seconds)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
