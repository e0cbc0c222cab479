"""The latency table of doc/log.md: a row in C, in ONNX and in Python, and the files' sizes.

    python benchmarks/bench_export.py            # prints the table
    python benchmarks/bench_export.py --write    # and puts it into doc/log.md

C is timed in a loop in C, one row per call; `load_c`, ONNX and `predict` one row
per call from Python. CPU time of one thread, best of five. `gap` is the largest distance to
`predict`, mm.
"""

import argparse
import ctypes
import platform
import shutil
import subprocess
import tempfile
import time
import warnings
from datetime import date
from functools import partial
from pathlib import Path

import numpy as np
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.export import export_c, load_c, to_onnx

PAGE = Path(__file__).parents[1] / "doc" / "log.md"
START, END = "<!-- bench_export -->", "<!-- end of bench_export -->"
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

    found = {
        "network, 60 centres": chain(60),
        "network, 266 centres": chain(266),
        "linear model of the arm": ArmResidualRegressor(arm, orders=3),
        "the same without fading": ArmResidualRegressor(arm, orders=3, fade=0),
    }
    for model in found.values():
        groups = {"groups": data.groups} if isinstance(model, ArmResidualRegressor) else {}
        model.fit(data.data, data.target, **groups)
    return found


def one_by_one(call, X, n_rows=200):
    """Return the CPU time of a call of one row in s."""
    return best(lambda: [call(row) for row in X[:n_rows]], 3) / n_rows


def in_c(model, folder, X, expected):
    """Rows of the table for one model in C: name, microseconds, gap."""
    source, _ = export_c(model, folder / "arm.c", std=True)
    (folder / "loop.c").write_text(LOOP)
    out = np.empty((len(X), 3))
    place = ctypes.c_void_p
    for compiler in filter(shutil.which, ("gcc", "clang")):
        for name, flags in FLAGS.items():
            library = folder / f"{compiler}{len(flags)}.so"
            command = [compiler, "-std=c99", *flags, "-shared", "-fPIC", "-o", library]
            subprocess.run([*command, source, folder / "loop.c", "-lm"], check=True)
            loaded = ctypes.CDLL(str(library))
            for what in ("correct", "std"):
                rows = X if what == "correct" else X[: len(X) // 10]
                arguments = (place(rows.ctypes.data), place(out.ctypes.data))
                function = getattr(loaded, f"{what}_rows")
                seconds = best(partial(function, *arguments, ctypes.c_long(len(rows))))
                gap = np.abs(out - expected).max()
                label = f"C, {compiler} {name}" + (", with std" if what == "std" else "")
                yield label, 1e6 * seconds / len(rows), gap


def in_python(model, X, expected):
    """The same for ways that are called from Python, one row per call."""
    compiled = load_c(model)
    gap = np.abs(compiled.predict(X) - expected).max()
    yield "`load_c`, one row per call", 1e6 * one_by_one(compiled.predict, X), gap
    yield "`load_c`, one batch", 1e6 * best(lambda: compiled.predict(X)) / len(X), gap
    try:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        converted = to_onnx(model).SerializeToString()
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


def table(n_rows):
    """Lines of Markdown."""
    data = make_single_point(n_positions=12, n_poses=40, random_state=0)
    # Poses that the models know: C takes longer where corrections fade.
    X = data.data[np.random.default_rng(0).integers(len(data.data), size=n_rows)]
    found, sizes, gaps, names = {}, {}, [], []
    for name, model in models(data).items():
        names.append(name)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            expected = model.predict(X)
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            for way in (in_c(model, folder, X, expected), in_python(model, X, expected)):
                for label, microseconds, gap in way:
                    found.setdefault(label, {})[name] = _digits(microseconds)
                    gaps.append(gap)
            for label, std in (("C source, kB", False), ("C source with std, kB", True)):
                source, _ = export_c(model, folder / "arm.c", std=std)
                sizes.setdefault(label, {})[name] = f"{source.stat().st_size / 1e3:.0f}"
    head = [f"| µs per row | {' | '.join(names)} |", f"|---{'|---' * len(names)}|"]
    body = [
        f"| {label} | {' | '.join(cells.get(name, '-') for name in names)} |"
        for label, cells in {**found, **sizes}.items()
    ]
    note = (
        f"{platform.machine()}, one core, {n_rows} rows, {date.today().isoformat()}; "
        f"all answers within {max(gaps):.0e} mm of `predict`."
    )
    return [*head, *body, "", note]


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=20_000)
    parser.add_argument("--write", action="store_true", help="into doc/log.md")
    args = parser.parse_args(argv)
    lines = table(args.rows)
    print("\n".join(lines))
    if args.write:
        text = PAGE.read_text(encoding="utf-8")
        before, rest = text.split(START)
        after = rest.split(END)[1]
        PAGE.write_text(f"{before}{START}\n\n" + "\n".join(lines) + f"\n\n{END}{after}", "utf-8")


if __name__ == "__main__":
    main()
