"""Time of one row of a fitted model in C, in ONNX and in Python, and the files' sizes.

    python benchmarks/bench_speed.py              # prints the table
    python benchmarks/bench_speed.py --write      # and puts it into doc/log.md

C is timed in a loop in C; `load_c`, ONNX and `predict` one row per call from Python. All on one
thread. Flash is text and data of gcc -O2. With ``--data FOLDER``, what the real data are in, a UR10
with a tracker is there, too: 2000 poses, the default model.
"""

import argparse
import ctypes
import os
import platform
import shutil
import subprocess
import tempfile
import time
import warnings

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

from datetime import date
from functools import partial
from pathlib import Path

import numpy as np
from _arm_folds import read_ur10
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    calibrate,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.export import export_c, load_c, to_onnx

PAGE = Path(__file__).parents[1] / "doc" / "log.md"
START, END = "<!-- bench_speed row -->", "<!-- end of bench_speed row -->"
LOOP = """
#include "arm.h"
void correct_rows(const double *q, double *out, long n)
{ for (long i = 0; i < n; ++i) arm_correct(q + 6 * i, out + 3 * i); }
void std_rows(const double *q, double *out, long n)
{ double s[3]; for (long i = 0; i < n; ++i) arm_correct_std(q + 6 * i, out + 3 * i, s); }
"""
FLAGS = {"-O2": ["-O2"], "-O3 -march=native": ["-O3", "-march=native"]}


def best(function, repeats=5):
    """Return the least CPU time of a call in s."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return min(times)


def models(data):
    """Fitted models by name: networks that all outputs share, and models of the arm."""
    arm = data.arm

    def chain(n_centers):
        return make_pipeline(
            PoseFeatures(arm, joints="all", append_azimuth=True),
            CylindricalResidualTarget(
                make_pipeline(
                    StandardScaler(), RBFNetRegressor(n_centers, shared=True, random_state=0)
                )
            ),
        )

    found = {"network, 60 centres": chain(60), "network, 266 centres": chain(266)}
    for model in found.values():
        model.fit(data.data, data.target)
    found["model of the arm"] = ArmResidualRegressor(arm)
    found["model of the arm"].fit(data.data, data.target, groups=data.groups)
    return found


def of_ur10(data_home):
    """The default model of 2000 poses of a real robot, and the other poses."""
    angles, points, _ = read_ur10("A", data_home)
    rows, rest = np.split(np.random.default_rng(0).permutation(len(angles)), [2000])
    first = calibrate(Arm.from_name("ur10", probe=(0, 0, 93)), angles[rows], points=points[rows])
    model = ArmResidualRegressor(first.arm).fit(angles[rows], first.residuals_mm)
    return model, np.concatenate([angles[rows], angles[rest]])


def one_by_one(call, X, n_rows=200):
    """Return the CPU time of a call of one row in s."""
    return best(lambda: [call(row) for row in X[:n_rows]], 3) / n_rows


def in_c(model, folder, X, expected, fade):
    """Rows of the table for one model in C: name, microseconds, gap."""
    source, _ = export_c(model, folder / "arm.c", std=True, fade=fade)
    (folder / "loop.c").write_text(LOOP)
    out = np.empty((len(X), 3))
    place = ctypes.c_void_p
    for name, flags in FLAGS.items() if shutil.which("gcc") else ():
        library = folder / f"gcc{len(flags)}.so"
        command = ["gcc", "-std=c99", *flags, "-shared", "-fPIC", "-o", library]
        subprocess.run([*command, source, folder / "loop.c", "-lm"], check=True)
        loaded = ctypes.CDLL(str(library))
        for what in ("correct", "std"):
            rows = X if what == "correct" else X[: len(X) // 10]
            arguments = (place(rows.ctypes.data), place(out.ctypes.data))
            function = getattr(loaded, f"{what}_rows")
            seconds = best(partial(function, *arguments, ctypes.c_long(len(rows))))
            gap = np.abs(out - expected).max()
            label = f"C, gcc {name}" + (", with std" if what == "std" else "")
            yield label, 1e6 * seconds / len(rows), gap


def in_python(model, _, X, expected, fade):
    """The same for ways that are called from Python, one row per call."""
    compiled = load_c(model, fade=fade)
    gap = np.abs(compiled.predict(X) - expected).max()
    yield "`load_c`, one row per call", 1e6 * one_by_one(compiled.predict, X), gap
    yield "`load_c`, one batch", 1e6 * best(lambda: compiled.predict(X)) / len(X), gap
    try:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        converted = to_onnx(model, fade=fade).SerializeToString()
        session = onnxruntime.InferenceSession(
            converted, options, providers=["CPUExecutionProvider"]
        )
    except ImportError:
        pass
    else:
        gap = np.abs(session.run(None, {"X": X})[0] - expected).max()
        seconds = one_by_one(lambda row: session.run(None, {"X": row[None]}), X)
        yield "ONNX, one row per call", 1e6 * seconds, gap
    yield (
        "`predict`, one row per call",
        1e6 * one_by_one(lambda row: model.predict(row[None]), X),
        0,
    )
    yield "`predict`, one batch", 1e6 * best(lambda: model.predict(X), 3) / len(X), 0


def _digits(microseconds):
    """Two digits, without an exponent."""
    return f"{microseconds:.{0 if microseconds >= 10 else 1}f}"


def flash_kb(source):
    """Text and data of the compiled file, kB: what a controller keeps of it."""
    if not all(map(shutil.which, ("gcc", "size"))):
        return "-"
    compiled = source.with_suffix(".o")
    command = ["gcc", "-std=c99", "-O2", "-c", source, "-o", compiled]
    subprocess.run(command, check=True)
    printed = subprocess.run(["size", compiled], check=True, capture_output=True, text=True).stdout
    return f"{sum(map(int, printed.splitlines()[1].split()[:2])) / 1e3:.0f}"


def table(n_rows, data_home):
    """Lines of Markdown."""
    data = make_single_point(n_positions=12, n_poses=40, random_state=0)
    columns = {
        f"{name}{', fade exact' if fade == 'exact' else ''}": (model, data.data, fade)
        for name, model in models(data).items()
        for fade in (["small", "exact"] if isinstance(model, ArmResidualRegressor) else ["small"])
    }
    if data_home:
        model, poses = of_ur10(data_home)
        for fade in ("small", "exact"):
            columns[f"UR10, fade {fade}"] = model, poses, fade
    found, sizes, gaps = {}, {}, {}
    for name, (model, poses, fade) in columns.items():
        # Poses that the models know: C takes longer where corrections fade.
        X = poses[np.random.default_rng(0).integers(len(poses), size=n_rows)]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            expected = model.predict(X)
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            for way in (in_c, in_python):
                for label, microseconds, gap in way(model, folder, X, expected, fade):
                    found.setdefault(label, {})[name] = _digits(microseconds)
                    gaps[name] = max(gaps.get(name, 0.0), gap)
            for label, std in (("", False), (" with std", True)):
                source, _ = export_c(model, folder / "arm.c", std=std, fade=fade)
                kb = f"{source.stat().st_size / 1e3:.0f}"
                sizes.setdefault(f"C source{label}, kB", {})[name] = kb
                sizes.setdefault(f"flash{label}, kB", {})[name] = flash_kb(source)
        label = "largest distance to `predict`, mm"
        sizes.setdefault(label, {})[name] = f"{gaps[name]:.0e}"
    head = [f"| µs per row | {' | '.join(columns)} |", f"|---{'|---' * len(columns)}|"]
    body = [
        f"| {label} | {' | '.join(cells.get(name, '-') for name in columns)} |"
        for label, cells in {**found, **sizes}.items()
    ]
    bare = Ridge().fit(data.data, data.target)
    ridge = _digits(1e6 * one_by_one(lambda row: bare.predict(row[None]), data.data))
    note = f"{platform.machine()}, one core, {n_rows} rows, {date.today().isoformat()}; `predict`"
    note += f" of one row by a bare `Ridge`: {ridge} µs."
    return [*head, *body, "", note]


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=20_000, help="of a model")
    parser.add_argument("--data", help="folder of the real data")
    parser.add_argument("--write", action="store_true", help="the table of rows into doc/log.md")
    args = parser.parse_args(argv)
    lines = table(args.rows, args.data)
    print("\n".join(lines))
    if args.write:
        text = PAGE.read_text(encoding="utf-8")
        before, rest = text.split(START)
        after = rest.split(END)[1]
        PAGE.write_text(f"{before}{START}\n\n" + "\n".join(lines) + f"\n\n{END}{after}", "utf-8")


if __name__ == "__main__":
    main()
