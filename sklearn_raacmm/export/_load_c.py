"""A fitted model compiled from its C source and called from Python."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import ctypes
import os
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.export._c_files import sources
from sklearn_raacmm.export._models import build_program
from sklearn_raacmm.utils import check_flags, write_whole

# Same results on all machines of a kind: no option that depends on the processor.
_FLAGS = ("-std=c99", "-O3", "-shared", "-fPIC")
# Of a library that is only asked for a few rows.
_FAST = ("-std=c99", "-O0", "-shared", "-fPIC")
_COMPILERS = ("cc", "gcc", "clang")
# Seconds that a compiler may take: a model of 1000 centres with its standard deviation takes 20.
_PATIENCE = 600
# Lines of the compiler's message that are shown.
_SHOWN_LINES = 5
# What the files and functions are called inside; two libraries do not see each other's names.
NAME = "model"


class CompiledModel:
    """A model in machine code, see :func:`load_c`.

    Attributes
    ----------
    fingerprint : str
        As :func:`fingerprint` gives it.

    n_features_in_, n_outputs_ : int
        Numbers of a row of X, and of a prediction.
    """

    def __init__(
        self, program: Any, dtype: str = "double", flags: Sequence[str] = _FLAGS, flat: bool = False
    ) -> None:
        self.fingerprint: str = program.fingerprint
        self.n_features_in_: int = program.n_inputs
        self.n_outputs_: int = program.n_outputs
        self._verb = "correct" if "point" in program.outputs else "predict"
        self._real = np.float64 if dtype == "double" else np.float32
        library = _library(sources(program, NAME, NAME, dtype), flags)
        self._functions = {
            name: getattr(library, f"{NAME}_{name}")
            for name in (self._verb, "point", f"{self._verb}_std")
            if hasattr(library, f"{NAME}_{name}")
        }
        self._many = getattr(library, f"{NAME}_{self._verb}_n")
        self._many.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t]
        self._local, self._flat = threading.local(), flat

    def predict(self, X: ArrayLike) -> np.ndarray:
        """What ``predict`` of the model gives, without its checks.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features) or (n_features,)
            Rows, or one row.

        Returns
        -------
        ndarray of shape (n_samples, n_outputs) or (n_outputs,)
            NaN in rows where ``predict`` raises. Where y was 1-D: (n_samples,), or a scalar.

        Raises
        ------
        ValueError
            If X has another number of columns.
        """
        X = X if isinstance(X, np.ndarray) else np.asarray(X)
        if X.ndim == 2:
            X = np.ascontiguousarray(X, dtype=self._real)
            if X.shape[1] != self.n_features_in_:
                self._refuse(X)
            out = np.empty((len(X), self.n_outputs_), dtype=self._real)
            self._many(X.ctypes.data, out.ctypes.data, len(X))
        else:
            out = self._row(X, self._verb)[1].copy()
        return out[..., 0] if self._flat else out

    def correct(self, angles: ArrayLike) -> np.ndarray:
        """Correction in mm of one pose or many, to be subtracted; as :meth:`predict`."""
        self._needs("point", "The model has no arm and three outputs, so predict is all it has.")
        return self.predict(angles)

    def point(self, angles: ArrayLike) -> np.ndarray:
        """Corrected centre of the probe at one pose, base frame, mm, (3,)."""
        self._needs("point", "The model has no arm and three outputs, so it has no point.")
        return self._row(angles, "point")[1].copy()

    def status(self, angles: ArrayLike) -> int:
        """What the C function returns for one row: 0 fine, 1 faded, 2 not finite."""
        return self._row(angles, self._verb)[0]

    def predict_std(self, X: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Prediction and standard deviation of one row, (n_outputs,) each."""
        self._needs(f"{self._verb}_std", "The model was compiled without its deviation: std=True.")
        _, mean, std = self._row(X, f"{self._verb}_std")
        return mean.copy(), std.copy()

    def _needs(self, name, otherwise):
        if name not in self._functions:
            raise ValueError(otherwise)

    def _row(self, row, name):
        """Status of one row, and the thread's own buffers with prediction and deviation."""
        if not hasattr(self._local, "buffers"):
            sizes = self.n_features_in_, self.n_outputs_, self.n_outputs_
            buffers = [np.empty(n, dtype=self._real) for n in sizes]
            places = [ctypes.c_void_p(array.ctypes.data) for array in buffers]
            calls = {
                name: partial(function, *(places if name.endswith("_std") else places[:2]))
                for name, function in self._functions.items()
            }
            self._local.buffers = *buffers, calls
        given, out, spread, calls = self._local.buffers
        row = row if isinstance(row, np.ndarray) else np.asarray(row)
        if row.shape != given.shape:
            self._refuse(row)
        given[:] = row
        return calls[name](), out, spread

    def _refuse(self, X):
        n = self.n_features_in_
        raise ValueError(
            f"The compiled model takes rows of {n} numbers, (n_samples, {n}) or ({n},); got shape "
            f"{X.shape}."
        )


def load_c(
    model: Any,
    *,
    std: bool = False,
    fade: Any = "small",
) -> CompiledModel:
    """Compile a fitted model and load it into this Python, for answers at 10 kHz and more.

    The source is what :func:`export_c` writes; it is compiled at each call.

    Parameters
    ----------
    model : estimator
        Fitted, of a kind that :func:`export_c` writes.

    std : bool, default=False
        Whether ``predict_std`` is there.

    fade : {"small", "exact", False}, default="small"
        How a correction fades, see :func:`export_c`.

    Returns
    -------
    CompiledModel
        For one row; its ``predict`` and ``correct`` take many rows, too. Threads may share it.

    Raises
    ------
    ValueError
        If the model cannot be exported.
    RuntimeError
        If there is no compiler, or it fails: the first lines of what it says are shown.
    sklearn.exceptions.NotFittedError
        If the model is not fitted.

    Notes
    -----
    The environment variable CC names the compiler; else cc, gcc or clang is taken. The number of
    inputs is checked, their values are not. Where ``predict`` raises, the result is NaN.

    Examples
    --------
    ::

        compiled = load_c(model)
        compiled.correct(joint_angles)  # one row: 1 to 2 microseconds, 10 where it fades
    """
    check_options(std, fade)
    program = build_program(model, std, fade)
    flat = np.ndim(model.predict(program.chain.typical_rows(1))) == 1
    return CompiledModel(program, flat=flat)


def check_options(std, fade, card=None):
    """Refuse what is no answer to whether deviations are asked, how it fades, and what it is."""
    check_flags(std=std)
    if not (fade is False or (isinstance(fade, str) and fade in ("small", "exact"))):
        raise ValueError(f"fade must be 'small', 'exact' or False, got {fade!r:.60}.")
    if not (card is None or isinstance(card, str | dict)):
        raise TypeError(f"card must be what describe gives, or text, got {card!r:.60}.")


def answers_in_c(program, dtype, X):
    """What the C source of a program gives at rows X, as `run`; None without a compiler."""
    try:
        _find_compiler()
    except RuntimeError:
        return None
    model = CompiledModel(program, dtype, _FAST)
    calls = {"y": model.predict, "point": model.point, "std": lambda row: model.predict_std(row)[1]}
    return {
        name: np.array([call(row) for row in X], dtype=float)
        for name, call in calls.items()
        if name in program.outputs
    }


def _find_compiler():
    names = [*filter(None, [os.environ.get("CC")]), *_COMPILERS]
    found = next(filter(None, map(shutil.which, names)), None)
    if found is None:
        raise RuntimeError(
            f"No C compiler found: none of {', '.join(names)} is on the PATH. "
            "Install gcc or clang, or name one in the environment variable CC."
        )
    return found


def _library(text, flags):
    """The loaded library of a source and its header, compiled in a folder that goes again."""
    compiler = _find_compiler()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as build:
        source, header, library = (Path(build, f"{NAME}.{end}") for end in ("c", "h", "so"))
        write_whole(dict(zip((source, header), text, strict=True)))
        command = [compiler, *flags, "-o", str(library), str(source), "-lm"]
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, timeout=_PATIENCE
        )
        if done.returncode != 0 or not library.exists():
            output = [line for line in (done.stderr + done.stdout).splitlines() if line.strip()]
            raise RuntimeError(
                f"{compiler} could not compile the model (exit status {done.returncode}): "
                + " | ".join(output[:_SHOWN_LINES])
            )
        return ctypes.CDLL(str(library))
