"""A fitted model as C99 and as ONNX: the public functions that write files."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm._version import __version__
from sklearn_raacmm.export._c_files import check_name, make_test, sources
from sklearn_raacmm.export._load_c import answers_in_c, check_options
from sklearn_raacmm.export._model_card import ModelCard
from sklearn_raacmm.export._models import build_program, compare_shares, nearly
from sklearn_raacmm.export._onnx import convert, run_onnx
from sklearn_raacmm.export._proof import SINGLE_SUMS, check_answers, make_test_rows, rows_as_json
from sklearn_raacmm.utils import write_whole


def export_c(
    model: object,
    path: str | PathLike[str],
    *,
    name: str | None = None,
    dtype: str = "double",
    std: bool = False,
    card: ModelCard | str | None = None,
    poses: ArrayLike | None = None,
    fade: str | bool = "small",
) -> tuple[Path, Path]:
    r"""Write a fitted model as one C99 file and its header.

    The file needs nothing but the mathematical library: no memory is allocated, nothing static
    changes, and it compiles as C++, too. The same model gives the same bytes.

    Parameters
    ----------
    model : estimator
        Fitted: :class:`ArmResidualRegressor`, :class:`RBFNetRegressor`, LinearRegression or Ridge;
        a pipeline of these, :class:`PoseFeatures` and scikit-learn's StandardScaler, in either form
        of :class:`CylindricalResidualTarget`. Of a search give the ``best_estimator_``.

    path : str or path-like
        The C file, ending in ".c"; the header beside it ends in ".h". Both are renamed when
        complete, so that a full disk leaves old files whole.

    name : str, default=None
        A C identifier that the functions' names begin with; None: the stem of `path`. With N
        joints (or features) and M outputs the functions are

        - ``int <name>_correct(const double joint_angles[N], double correction_mm[3])``: what
          ``predict`` gives, to be subtracted from the measured point;
        - ``int <name>_correct_n(const double *joint_angles, double *correction_mm, size_t n)``: the
          same for n rows;
        - ``int <name>_point(const double joint_angles[N], double point_mm[3])``: the corrected
          centre of the probe, through the arm's kinematics;
        - ``int <name>_correct_std(const double joint_angles[N], double correction_mm[3], double
          std_mm[3])``, if `std`;
        - ``double <name>_trust(const double joint_angles[N])``, of a model that fades: the share of
          the correction that is left;
        - ``const char *<name>_fingerprint(void)``.

        The first four return 0; 1 where less than half of the correction is left; 2 where the
        result is NaN. Joint angles are in the unit that `model` takes; extra columns come after
        them. A model without an arm, or without three outputs, has ``<name>_predict`` and
        ``<name>_predict_n`` instead of the first three. The header explains each of them, and
        defines macros: version, fingerprint, sizes, units, and what the card has.

    dtype : {"double", "float"}, default="double"
        Precision of everything, the functions' arguments included. In single precision a
        correction is good to about 1e-5 of its size, but a point 1 m away to 0.1 micrometre only.

    std : bool, default=False
        Also write the standard deviation. Its tables grow with the square of the number of centres
        (or terms).

    card : ModelCard or str, default=None
        Facts to repeat in the comment at the top, see :func:`describe`. Characters other than
        plain ones become underscores.

    poses : array-like of shape (n, N) or "random", default=None
        Rows that the model was fitted on, or others that it will see; "random" takes random ones.
        With them comes, beside the C file, ``<stem>_test.c``, which compares 32 rows with what
        ``predict`` gives.

    fade : {"small", "exact", False}, default="small"
        How a correction of :class:`ArmResidualRegressor` fades where the model knows little:

        - "small": nearly as in ``predict``, from tables of a tenth of the size. The header says by
          how much the share that is left differs at 1000 poses: usually by less than 0.01, at some
          poses by 0.04. Far away it may differ as much.
        - "exact": as in ``predict``; the tables grow with the square of the number of terms.
        - False: not at all. Where the model knows nothing, the correction is then arbitrary: for
          arms that never leave the poses of the test.

    Returns
    -------
    source, header : pathlib.Path
        The two files.

    Raises
    ------
    ValueError
        If a step cannot be exported, a parameter is none that C can have, a number of the model is
        not finite in this precision; if the file, compiled, does not give what ``predict`` gives.
    sklearn.exceptions.NotFittedError
        If the model is not fitted.

    Notes
    -----
    Where ``predict`` raises, as for numbers above 1e50, the functions give NaN. Angles more than
    two turns away only warn in Python, and pass here.

    Where a compiler is at hand (the environment variable CC, or cc, gcc or clang), the file is
    compiled and compared with ``predict`` at 32 rows before it is written: 1e-9 of the largest
    correction and 1e-3 of a standard deviation are promised, 2e-2 in single precision. The header
    says so where it is worse, and how good single precision is.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from sklearn_raacmm import RBFNetRegressor
    >>> from sklearn_raacmm.export import export_c
    >>> X = np.linspace(0, 6, 50)[:, None]
    >>> model = RBFNetRegressor(5).fit(X, np.sin(X[:, 0]))
    >>> with TemporaryDirectory() as folder:
    ...     source, header = export_c(model, Path(folder) / "sine.c")
    ...     text = header.read_text()
    >>> print(*[line for line in text.splitlines() if line.endswith(";")], sep="\n")
    int sine_predict(const double features[1], double prediction[1]);
    int sine_predict_n(const double *features, double *prediction, size_t n);
    const char *sine_fingerprint(void);
    """
    path = Path(path)
    if path.suffix != ".c" or not re.fullmatch(r"[A-Za-z0-9_.+-]+", path.name, re.ASCII):
        raise ValueError(
            "path must name a file of letters, digits, '_', '.', '+' and '-' that ends in .c, got "
            f"{str(path)!r:.60}."
        )
    name = check_name(path.stem if name is None else name)
    check_options(std, fade, card)
    if not (isinstance(dtype, str) and dtype in ("double", "float")):
        raise ValueError(f"dtype must be 'double' or 'float', got {dtype!r:.60}.")
    given = None if isinstance(poses, str) and poses == "random" else poses
    program, rows, notes = _faded(model, given, fade, std, dtype)
    sums = fade == "small" and "trust" in program.outputs  # of single precision, from small tables
    small = {"limit": SINGLE_SUMS, "of": "the same tables summed in double precision"}
    notes += _check_in_c(program, rows, dtype, **(small if sums else {}))
    source, header = sources(program, name, path.stem, dtype, card, notes)
    header_path = path.with_suffix(".h")
    files = {path: source, header_path: header}
    if poses is not None:
        gap = np.nanmax(np.abs(program.run(rows["X"])["y"] - rows["y"]))
        if sums:
            gap += 0.1 * SINGLE_SUMS * np.nanmax(np.abs(rows["y"]))
        text = make_test(rows, gap, name, path.stem, dtype, "point" in program.outputs)
        files[path.with_name(f"{path.stem}_test.c")] = text
    write_whole(files)
    return path, header_path


def _faded(model, poses, fade, std, dtype="double"):
    """The program of a model that fades in this way, test rows, and what a file has to say of it.

    Where this is not as in ``predict``, the exact program is compared with that, and the rows have
    what the other one gives.
    """
    exact = build_program(model, std)
    rows = make_test_rows(exact.chain, poses, std, dtype)
    program = nearly(exact, fade, poses)
    if program is exact:
        return exact, rows, []
    check_answers("the exact program", rows, exact.run(rows["X"]))
    rows["y"] = program.run(rows["X"])["y"]
    nothing = "nothing fades: a correction is whole where the model knows nothing, too"
    return program, rows, [compare_shares(program) if fade else nothing]


def _check_in_c(program, rows, dtype, **limits):
    """What the header has to say of how far the C file is from ``predict``."""
    found = answers_in_c(program, dtype, rows["X"])
    if found is None:
        return []
    notes = check_answers("the C source", rows, found, dtype, **limits)
    if dtype == "float":
        known = np.isfinite(rows["y"]).all(axis=1)
        size = np.abs(rows["y"][known]).max(initial=1e-300)
        gap = np.abs(found["y"] - rows["y"])[known].max(initial=0.0)
        unit = " mm" if "point" in found else ""
        of = limits.get("of", "predict")
        text = f"single precision, at {known.sum()} rows: within {gap:.1e}{unit} of {of}"
        notes.append(f"{text}, {gap / size:.1e} of the largest")
        if "point" in found:
            exact = program.run(rows["X"])["point"]
            gap = np.abs(found["point"] - exact)[known].max(initial=0.0)
            notes[-1] += f"; the point within {gap:.1e} mm"
    return notes


def fingerprint(model: object) -> str:
    """Fingerprint of what a fitted model computes.

    Parameters
    ----------
    model : estimator
        Fitted, of a kind that :func:`export_c` writes.

    Returns
    -------
    str
        SHA-256 as 64 hexadecimal digits, of every constant and operation of the prediction in
        double precision. The same one is in the files of C and ONNX.

    Raises
    ------
    ValueError
        If the model cannot be exported.
    """
    return build_program(model).fingerprint


def to_onnx(
    model: object,
    path: str | PathLike[str] | None = None,
    *,
    std: bool = False,
    card: ModelCard | str | None = None,
    fade: str | bool = "small",
) -> Any:
    """Convert a fitted model to ONNX, for every language that has a runtime for it.

    Parameters
    ----------
    model : estimator
        Fitted, of a kind that :func:`export_c` writes.

    path : str or path-like, default=None
        File to write, renamed when complete.

    std : bool, default=False
        Whether there is a second output, the standard deviation.

    card : ModelCard or str, default=None
        Facts to keep in the file's metadata, see :func:`describe`.

    fade : {"small", "exact", False}, default="small"
        How a correction fades, see :func:`export_c`.

    Returns
    -------
    onnx.ModelProto
        The model: input X, outputs y and std. Rows that ``predict`` refuses come out as NaN. The
        metadata have the version, the fingerprint, the card and, as JSON in ``test_rows``, 32 rows
        with what ``predict`` gives but for `fade`.

    Raises
    ------
    ImportError
        Without onnx: ``pip install -e ".[onnx]"`` in the project's folder installs it.
    ValueError
        If a step cannot be exported; if ONNX Runtime is installed and does not give what
        ``predict`` gives.
    sklearn.exceptions.NotFittedError
        If the model is not fitted.

    Examples
    --------
    With ``onnxruntime``, in any language that has it::

        to_onnx(model, "arm.onnx")
        session = onnxruntime.InferenceSession("arm.onnx")
        (correction_mm,) = session.run(None, {"X": joint_angles})
    """
    check_options(std, fade, card)
    program, rows, notes = _faded(model, None, fade, std)
    made = convert(program)
    facts = {"sklearn_raacmm_version": __version__, "fingerprint": program.fingerprint}
    found = run_onnx(made, rows["X"])
    if found is not None:
        notes += check_answers("the ONNX file", rows, found)
    if notes:
        facts["accuracy"] = "; ".join(notes)
    facts["test_rows"] = rows_as_json(rows)
    if card is not None:
        facts["model_card"] = str(card)
    for key, value in facts.items():
        made.metadata_props.add(key=key, value=value)
    if path is not None:
        write_whole({Path(path): made.SerializeToString()})
    return made
