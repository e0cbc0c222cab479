"""A fitted model compiled from its C source and called from Python."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import ctypes
import hashlib
import os
import platform
import shutil
import stat
import subprocess
import tempfile
import threading
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.export._c_files import sources
from sklearn_raacmm.export._models import program_of
from sklearn_raacmm.export._program import fingerprint_of
from sklearn_raacmm.export._steps import check_std
from sklearn_raacmm.utils import check_path, show, write_whole

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

    n_features_in_ : int
        Number of joint angles, or features, of a row.

    n_outputs_ : int
        Number of outputs.
    """

    fingerprint: str
    n_features_in_: int
    n_outputs_: int

    def __init__(self, text: Any, facts: Any, compiler: Any, folder: Any) -> None:
        self._state = text, facts, compiler, folder
        self.fingerprint, self.n_features_in_, self.n_outputs_ = facts[:3]
        self._verb, self._flat, self._has_point, self._has_std = facts[3:]
        library = _library(text, compiler, folder)
        names = [self._verb, *(["point"] if self._has_point else [])]
        names += [f"{self._verb}_std"] if self._has_std else []
        self._functions = {name: getattr(library, f"{NAME}_{name}") for name in names}
        for function in self._functions.values():
            function.restype = ctypes.c_int
        self._many = getattr(library, f"{NAME}_{self._verb}_n")
        self._many.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t]
        self._many.restype = ctypes.c_int
        self._local = threading.local()

    def __reduce__(self) -> Any:
        return CompiledModel, self._state

    def __repr__(self) -> str:
        return (
            f"<CompiledModel {self.fingerprint[:12]}: {self.n_features_in_} inputs, "
            f"{self.n_outputs_} outputs>"
        )

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
        out = self._rows(X) if X.ndim == 2 else self._row(X, self._verb)[1]
        return out[..., 0] if self._flat else out

    def correct(self, angles: ArrayLike) -> np.ndarray:
        """Correction in mm, to be subtracted from the measured point; as :meth:`predict`.

        Parameters
        ----------
        angles : array-like of shape (n_samples, n_joints) or (n_joints,)
            Joint angles in the unit of the model.

        Returns
        -------
        ndarray of shape (n_samples, 3) or (3,)
        """
        if not self._has_point:
            raise ValueError("The model has no arm and three outputs, so predict is all it has.")
        return self.predict(angles)

    def point(self, angles: ArrayLike) -> np.ndarray:
        """Corrected centre of the probe in the base frame, mm.

        Parameters
        ----------
        angles : array-like of shape (n_joints,)
            Joint angles in the unit of the model.

        Returns
        -------
        ndarray of shape (3,)
        """
        if not self._has_point:
            raise ValueError("The model has no arm and three outputs, so it has no point.")
        return self._row(angles, "point")[1]

    def status(self, angles: ArrayLike) -> int:
        """What the C function returns for one row: 0 fine, 1 faded, 2 not finite.

        Parameters
        ----------
        angles : array-like of shape (n_features,)

        Returns
        -------
        int
        """
        return self._row(angles, self._verb)[0]

    def predict_std(self, X: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Prediction and standard deviation of one row.

        Parameters
        ----------
        X : array-like of shape (n_features,)

        Returns
        -------
        mean, std : ndarray of shape (n_outputs,)
        """
        if not self._has_std:
            raise ValueError("The model was compiled without standard deviation: std=True.")
        found: Any = self._row(X, f"{self._verb}_std", results=2)
        return found[1], found[2]

    def _row(self, row, name, results=1):
        """Status and results of one row, through buffers that each thread has for itself."""
        try:
            given, out, spread, calls = self._local.buffers
        except AttributeError:
            given, out, spread, calls = self._buffers()
        row = row if isinstance(row, np.ndarray) else np.asarray(row)
        if row.shape != given.shape:
            self._refuse(row)
        given[:] = row
        status = calls[name]()
        if results == 1:
            return status, out.copy()
        return status, out.copy(), spread.copy()

    def _buffers(self):
        """Arrays of this thread, and the functions bound to them."""
        given, out, spread = (
            np.empty(n) for n in (self.n_features_in_, self.n_outputs_, self.n_outputs_)
        )
        places = [ctypes.c_void_p(array.ctypes.data) for array in (given, out, spread)]

        calls = {
            name: partial(function, *(places if name.endswith("_std") else places[:2]))
            for name, function in self._functions.items()
        }
        self._local.buffers = given, out, spread, calls
        return self._local.buffers

    def _rows(self, X):
        X = np.ascontiguousarray(X, dtype=np.float64)
        if X.shape[1] != self.n_features_in_:
            self._refuse(X)
        out = np.empty((len(X), self.n_outputs_))
        self._many(X.ctypes.data, out.ctypes.data, len(X))
        return out

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
    compiler: str | None = None,
    cache_dir: str | PathLike[str] | None = None,
) -> CompiledModel:
    """Compile a fitted model and load it into this Python, for answers at 10 kHz and more.

    The source is what :func:`export_c` writes. It is compiled once, and kept for the next time.

    Parameters
    ----------
    model : estimator
        Fitted, of a kind that :func:`export_c` writes.

    std : bool, default=False
        Whether ``predict_std`` is there.

    compiler : str, default=None
        C compiler, called as gcc is; None: the environment variable CC, or cc, gcc or clang.

    cache_dir : str or path-like, default=None
        Folder to keep the library in, which must be the user's own. None: the environment variable
        SKLEARN_RAACMM_CACHE, or ``sklearn_raacmm`` in the user's cache folder; where that cannot be
        written, nothing is kept.

    Returns
    -------
    CompiledModel
        Has ``predict(X)``, ``correct(angles)``, ``point(angles)``, ``status(angles)`` and
        ``predict_std(X)``: on one row, the first two on many rows, too. Threads may share it; a
        pickle holds the source and compiles it where it is loaded.

    Raises
    ------
    ValueError
        If the model cannot be exported, or others may write to the folder.
    RuntimeError
        If there is no compiler, or it fails: the first lines of what it says are shown.
    sklearn.exceptions.NotFittedError
        If the model is not fitted.

    Notes
    -----
    Inputs are not checked but for their number. Where ``predict`` raises, the result is NaN.

    Examples
    --------
    ::

        compiled = load_c(model)
        compiled.correct(joint_angles)  # one row: 1 to 2 microseconds, 10 where it fades
    """
    check_std(std)
    program = program_of(model, std)
    text = sources(program, NAME, NAME, "double")
    facts = (
        fingerprint_of(program),
        program.n_inputs,
        program.n_outputs,
        "correct" if program.about["corrects"] else "predict",
        program.about["flat"],
        program.about["corrects"],
        std,
    )
    return CompiledModel(text, facts, compiler, cache_dir)


def answers_in_c(program, text, dtype, X):
    """What the C source of a program gives at some rows; None without a compiler.

    Parameters
    ----------
    program : Program
    text : tuple of str
        Source and header, of the name `NAME`.
    dtype : {"double", "float"}
    X : ndarray of shape (n, n_inputs)

    Returns
    -------
    dict of ndarray
        y, point and std, as far as the program has them.
    """
    try:
        compiler = _find_compiler(None)
    except RuntimeError:
        return None
    real = np.float64 if dtype == "double" else np.float32
    X = np.ascontiguousarray(X, dtype=real)
    verb = "correct" if program.about["corrects"] else "predict"
    calls = {"y": verb, "point": "point", "std": f"{verb}_std"}
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as build:
        library = ctypes.CDLL(str(_compile(text, compiler, Path(build), _FAST)))
        found = {
            name: np.empty((len(X), program.n_outputs), dtype=real)
            for name in calls
            if name in program.outputs
        }
        for name, out in found.items():
            function = getattr(library, f"{NAME}_{calls[name]}")
            for i, row in enumerate(X):
                results = (found["y"][i], out[i]) if name == "std" else (out[i],)
                function(*(ctypes.c_void_p(array.ctypes.data) for array in (row, *results)))
    return {name: out.astype(float) for name, out in found.items()}


def _find_compiler(compiler):
    names = [compiler] if compiler else [os.environ.get("CC", ""), *_COMPILERS]
    found = next(filter(None, map(shutil.which, filter(None, names))), None)
    if found is None:
        raise RuntimeError(
            f"No C compiler found: none of {', '.join(filter(None, names))} is on the PATH. "
            "Install gcc or clang, or name one in the environment variable CC."
        )
    return found


def _library(text, compiler, folder):
    """The loaded library: from the folder of libraries, or compiled now."""
    compiler = _find_compiler(compiler)
    parts = [*text, compiler, *_FLAGS, platform.platform(), platform.machine()]
    place = f"{hashlib.sha256(chr(0).join(parts).encode()).hexdigest()}.so"
    given = folder is not None
    folder = check_path("cache_dir", folder) if given else _own_folder()
    try:
        _make_own(folder)
    except OSError:
        if given:
            raise
        folder = None  # nowhere to keep it, as in a container: compile it each time
    if folder is not None and (folder / place).exists():
        return ctypes.CDLL(str(folder / place))
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as build:
        library = _compile(text, compiler, Path(build))
        if folder is not None:
            write_whole({folder / place: library.read_bytes()})
            library = folder / place
        return ctypes.CDLL(str(library))


def _compile(text, compiler, build, flags=_FLAGS):
    """Path of the library that a compiler makes of source and header."""
    source, header, library = (build / f"{NAME}.{end}" for end in ("c", "h", "so"))
    write_whole(dict(zip((source, header), text, strict=True)))
    command = [compiler, *flags, "-o", str(library), str(source), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_PATIENCE)
    if done.returncode != 0 or not library.exists():
        said = [line for line in (done.stderr + done.stdout).splitlines() if line.strip()]
        raise RuntimeError(
            f"{compiler} could not compile the model (exit status {done.returncode}): "
            + " | ".join(said[:_SHOWN_LINES])
        )
    return library


def _own_folder():
    """Where libraries are kept: SKLEARN_RAACMM_CACHE, or in the user's cache folder."""
    named = os.environ.get("SKLEARN_RAACMM_CACHE")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "sklearn_raacmm"


def _make_own(folder):
    """Make the folder, and refuse one in which others could put a library of theirs."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if os.name != "posix":
        return
    facts = folder.stat()
    if facts.st_uid != os.getuid() or facts.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise ValueError(
            f"Compiled models are loaded from {show(str(folder))}, which others may write to: "
            "choose a folder of your own, or take the others' right to write (chmod 700)."
        )
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(f"The folder of compiled models cannot be written: {folder}.")
