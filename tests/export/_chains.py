"""Chains of estimators that the tests of all formats export, and poses to compare them at."""

import ctypes
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pytest
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
)
from sklearn_raacmm.export import export_c, to_onnx
from sklearn_raacmm.export._models import build_program

STRICT = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wshadow"]
STRICT += ["-Wdouble-promotion", "-Wstrict-overflow=1", "-Wfloat-conversion"]
COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
needs_compiler = pytest.mark.skipif(not COMPILERS, reason="neither gcc nor clang is on PATH")


def network(**params):
    # Given widths: what is searched for in a fit is not the question here.
    given = {"n_centers": 20, "length_scale": 1.5, "alpha": 0.03}
    return RBFNetRegressor(**{**given, **params})


def form_a(arm, scaler=None, net=None, **pose):
    steps = [PoseFeatures(arm, **pose), scaler or StandardScaler(), net or network()]
    return CylindricalResidualTarget(make_pipeline(*steps), azimuth=arm.azimuth)


def form_b(arm, scaler=None, net=None, **pose):
    inner = make_pipeline(scaler or StandardScaler(), net or network())
    pose = PoseFeatures(arm, append_azimuth=True, **pose)
    return make_pipeline(pose, CylindricalResidualTarget(inner))


def of_arm(arm, *causes, **params):
    return ArmResidualRegressor(arm, **{"orders": 5, "causes": list(causes), **params})


def angles_everywhere(n_joints, n=300):
    """Training-like, wrapped, far and special angles."""
    rng = np.random.default_rng(0)
    turns = 2 * np.pi * rng.integers(-1, 2, (n, n_joints))
    near = rng.uniform(-np.pi, np.pi, (n, n_joints))
    edges = np.array([0.0, -np.pi, np.pi, np.pi / 2, 1e-9, -1e-300])
    corners = rng.choice(edges, (n, n_joints))
    return np.concatenate([near, near + turns, rng.uniform(-12, 12, (n, n_joints)), corners])


def no_azimuth(X):
    return np.zeros(len(X))


def library(folder, compiler, source, *flags):
    """The loaded library, or None where the compiler refuses it."""
    out = Path(tempfile.mkdtemp(dir=folder), "arm.so")  # of a path that is loaded nothing is read
    command = [compiler, "-std=c99", *flags, "-shared", "-fPIC", "-o", out, source, "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return ctypes.CDLL(str(out)) if done.returncode == 0 else None


def in_c(folder, compiler, model, X, std):
    """Mean, and deviation or None, of the compiled file, with every warning an error."""
    source, header = export_c(model, folder / "arm.c", std=std, fade="exact")
    loaded, place = library(folder, compiler, source, "-O1", *STRICT), ctypes.c_void_p
    declared = header.read_text()
    verb = "correct" if "arm_correct(" in declared else "predict"
    q = int(re.search(r"N_OUTPUTS (\d+)", declared)[1])
    X, mean, spread = np.ascontiguousarray(X), np.empty((len(X), q)), np.empty((len(X), q))
    many = getattr(loaded, f"arm_{verb}_n")
    many(place(X.ctypes.data), place(mean.ctypes.data), ctypes.c_size_t(len(X)))
    if std:
        again, one = np.empty(q), getattr(loaded, f"arm_{verb}_std")
        for row, own in zip(X, spread, strict=True):
            one(*(place(array.ctypes.data) for array in (row, again, own)))
        np.testing.assert_array_equal(again, mean[-1])
    return mean, spread if std else None


def ways_out(folder, model, X, std=False):
    """Name, mean and deviation or None of every way out of Python."""
    for compiler in COMPILERS:
        yield compiler, *in_c(folder, compiler, model, X, std)
    found = build_program(model, std).run(X)
    yield "program", found["y"], found.get("std")
    try:
        import onnxruntime
    except ImportError:
        return
    session = onnxruntime.InferenceSession(
        to_onnx(model, std=std, fade="exact").SerializeToString()
    )
    yield "ONNX", *session.run(None, {"X": X}), *([] if std else [None])
