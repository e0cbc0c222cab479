"""A fitted model on its way: as C99, as ONNX, what to trust in its file, and what to say of it."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re

from sklearn_raacmm._version import __version__
from sklearn_raacmm.arm import Arm
from sklearn_raacmm.correction import ArmResidualRegressor
from sklearn_raacmm.error_model import Fading, JointHarmonicRegressor, LinearModel, Terms
from sklearn_raacmm.export._c_files import sources
from sklearn_raacmm.export._c_project import check_rows, project_files
from sklearn_raacmm.export._c_source import body_of, fingerprint_of
from sklearn_raacmm.export._c_text import check_name
from sklearn_raacmm.export._json import model_of, text_of
from sklearn_raacmm.export._load_c import compiled, single_precision
from sklearn_raacmm.export._model_card import card_of
from sklearn_raacmm.export._steps import check_fitted
from sklearn_raacmm.network import Network, RBFNetRegressor
from sklearn_raacmm.residuals import CylindricalResidualTarget, PoseFeatures
from sklearn_raacmm.utils import check_path, show, write_whole

#: What a skops file of any model made of this package's and scikit-learn's estimators needs trust
#: in: ``skops.io.load(path, trusted=TRUSTED_TYPES)``. Names of this package's own, nothing else.
TRUSTED_TYPES = [
    f"{kind.__module__}.{kind.__qualname__}"
    for kind in (
        Arm,
        Arm.azimuth,
        ArmResidualRegressor,
        Fading,
        JointHarmonicRegressor,
        LinearModel,
        PoseFeatures,
        Network,
        RBFNetRegressor,
        Terms,
        CylindricalResidualTarget,
    )
]


def _check_card(card):
    """Refuse what `describe` does not give, and is no text either."""
    if not (card is None or isinstance(card, str | dict)):
        raise TypeError(f"card must be what describe gives, or text, got {show(card)}.")


def export_c(model, path, *, name=None, dtype="double", std=False, card=None, poses=None):
    r"""Write a fitted model as one C99 file and its header.

    The file needs nothing but the mathematical library: no memory is allocated, nothing static
    changes, and it compiles as C++, too. The same model gives the same bytes.

    Parameters
    ----------
    model : estimator
        Fitted. A pipeline, in either of the two forms of :class:`CylindricalResidualTarget`, of
        :class:`PoseFeatures`, scikit-learn's StandardScaler, MinMaxScaler, MaxAbsScaler or
        RobustScaler, and :class:`RBFNetRegressor`, LinearRegression or Ridge; one of these
        regressors, :class:`JointHarmonicRegressor` or :class:`ArmResidualRegressor` by itself; or a
        search that has found one of all these.

    path : str or path-like
        The C file, ending in ".c"; the header beside it ends in ".h". Both are written beside
        their places and renamed when complete, so that a full disk leaves old files whole.

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
          the correction that is left, of its stages the smallest;
        - ``const char *<name>_fingerprint(void)``.

        The first four return 0; 1 where less than half of a stage is left; 2 where the result is
        NaN. The header defines names for these numbers, and
        ``<NAME>_VERSION``, ``_FINGERPRINT``, ``_N_INPUTS``, ``_N_OUTPUTS``, ``_TABLE_BYTES``,
        ``_INPUT_UNIT``, ``_OUTPUT_UNIT``; with a card that has them ``_SERIAL_NUMBER``, ``_DATE``
        and ``_DATA_FINGERPRINT``.

        Joint angles are in the unit that `model` takes; extra columns, such as a temperature, come
        after them, and a tool that was not in the fit gives NaN. A model without an arm, or without
        three outputs, has ``<name>_predict`` and ``<name>_predict_n`` instead of the first three.

    dtype : {"double", "float"}, default="double"
        Precision of everything, the functions' arguments included. In single precision a
        correction is good to about 1e-5 of its size, but a point 1 m away to 0.1 micrometre only.

    std : bool, default=False
        Also write the standard deviation, by which the caller can tell poses that the model knows
        from those it does not. Its tables grow with the square of the number of centres (or terms);
        those of a correction that fades are there in any case. That of a network is good to 1e-3
        of itself, in a third of the text that all digits take; where the correction depends on it,
        as in an :class:`ArmResidualRegressor` that fades, and of data almost without noise, all
        digits are written. That of a linear model of more than some 450 terms is good to 3e-5 of
        itself, and a correction that fades to 1e-5 of the largest; of smaller ones to rounding.

    card : ModelCard or str, default=None
        Facts to repeat in the comment at the top, see :func:`describe`. Characters other than
        plain ones become underscores.

    poses : array-like of shape (n, N), default=None
        Rows that the model was fitted on, or others that it will see. With them come, beside the C
        file, ``<stem>_test.c``, which compares 32 rows with what ``predict`` gives (20 of these, 8
        corners of their ranges, 4 with NaN or infinity); ``CMakeLists.txt``, which builds and runs
        it; and ``<stem>.hpp``, for C++17. In single precision the header then says how far
        the functions are from ``predict`` at these rows, where a compiler is at hand.

    Returns
    -------
    source, header : pathlib.Path
        The two files.

    Raises
    ------
    ValueError
        If a step cannot be exported (the sentence names it), `name` is not a C identifier or a
        word of C or C++, `path` does not end in ".c" or holds unusual characters, or a number of
        the model is not finite in this precision; if a CMakeLists.txt of somebody else is there.
    sklearn.exceptions.NotFittedError
        If the model is not fitted.

    Notes
    -----
    Where ``predict`` raises, on angles that are NaN or infinite or a pose without an azimuth, the
    functions give NaN. Angles more than two turns away only warn in Python, and pass here.

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
    path = check_path("path", path)
    if path.suffix != ".c" or not re.fullmatch(r"[A-Za-z0-9_.+-]+", path.name, re.ASCII):
        raise ValueError(
            "path must name a file of letters, digits, '_', '.', '+' and '-' that ends in .c, got "
            f"{show(str(path))}."
        )
    name = check_name(path.stem if name is None else name)
    if not (isinstance(dtype, str) and dtype in ("double", "float")):
        raise ValueError(f"dtype must be 'double' or 'float', got {show(dtype)}.")
    if not isinstance(std, bool):
        raise ValueError(f"std must be True or False, got {show(std)}.")
    _check_card(card)
    header_path, extra, notes = path.with_suffix(".h"), {}, []
    if poses is not None:
        body = body_of(model, dtype, std)
        rows = check_rows(poses, body.n_inputs)
        extra = project_files(model, name, path, dtype, rows, body.corrects)
        notes = single_precision(model, rows) if dtype == "float" else []
    source, header = sources(model, name, path.stem, dtype, std, card, notes)
    write_whole({path: source, header_path: header, **extra})
    return path, header_path


def load_c(model, *, std=False, compiler=None, cache_dir=None):
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
    if not isinstance(std, bool):
        raise ValueError(f"std must be True or False, got {show(std)}.")
    return compiled(model, std, compiler, cache_dir)


def to_json(model, path=None):
    """Write a fitted model as JSON: for other languages, and for an archive of twenty years.

    Parameters
    ----------
    model : estimator
        Fitted: of this package, scikit-learn's StandardScaler, MinMaxScaler, MaxAbsScaler,
        RobustScaler, LinearRegression or Ridge, a pipeline of these, or a search that has found
        one.

    path : str or path-like, default=None
        File to write, beside its place and renamed when complete. None only returns the text.

    Returns
    -------
    str
        JSON. All numbers are the shortest decimals that read back as the same float64. The page
        "Deployment" describes the fields.

    Raises
    ------
    ValueError
        If something in the model cannot be written: the sentence says where it is.
    sklearn.exceptions.NotFittedError
        If the model is not fitted.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_raacmm import RBFNetRegressor
    >>> from sklearn_raacmm.export import from_json, to_json
    >>> X = np.linspace(0, 6, 50)[:, None]
    >>> model = RBFNetRegressor(5).fit(X, np.sin(X[:, 0]))
    >>> again = from_json(to_json(model))
    >>> bool((again.predict(X) == model.predict(X)).all())
    True
    """
    path = None if path is None else check_path("path", path)
    text = text_of(model)
    if path is not None:
        write_whole({path: text})
    return text


def from_json(source):
    """Read a model that :func:`to_json` wrote. Nothing in it is run.

    Parameters
    ----------
    source : str or path-like
        File, or the text itself.

    Returns
    -------
    estimator
        With the predictions of the model that was written.

    Raises
    ------
    ValueError
        If the text is not such a model, of another version of the format, or damaged: the checksum
        is wrong, arrays do not fit together, or a number is missing or not finite.
    OSError
        If the file cannot be read.
    """
    if isinstance(source, str) and source.lstrip().startswith("{"):
        return model_of(source)
    content = check_path("source", source).read_bytes()
    try:
        return model_of(content.decode("utf-8-sig"), str(source))
    except UnicodeDecodeError as error:
        raise ValueError(f"{source} is not valid JSON: {error}.") from None


def fingerprint(model):
    """Fingerprint of what a fitted model computes.

    Parameters
    ----------
    model : estimator
        Fitted, of a kind that :func:`export_c` writes.

    Returns
    -------
    str
        SHA-256 as 64 hexadecimal digits, of every constant and operation in double precision. The
        same one is in what :func:`export_c` writes.

    Raises
    ------
    ValueError
        If the model cannot be exported.
    """
    return fingerprint_of(model)


def register_onnx():
    """Register the package's converters with skl2onnx.

    After that ``skl2onnx.to_onnx`` converts :class:`PoseFeatures`, :class:`RBFNetRegressor`,
    :class:`CylindricalResidualTarget`, :class:`JointHarmonicRegressor` and
    :class:`ArmResidualRegressor` wherever they stand: in pipelines, searches, column transformers.
    To call it again does no harm.

    Raises
    ------
    ImportError
        Without skl2onnx: ``pip install -e ".[onnx]"`` in the project's folder installs it.
    """
    # Late: skl2onnx takes a second to import.
    from sklearn_raacmm.export import _onnx

    _onnx.register()


def to_onnx(model, path=None, *, dtype="double", target_opset=None, card=None):
    """Convert a fitted model to ONNX.

    Parameters
    ----------
    model : estimator
        Fitted: any that skl2onnx converts, with this package's estimators in it, see
        :func:`register_onnx`.

    path : str or path-like, default=None
        File to write, beside its place and renamed when complete. None only returns the model.

    dtype : {"double", "float"}, default="double"
        Type of the input X of shape (n_samples, n_features) and of the output. This package's
        steps compute in float64 in either case.

    target_opset : int, default=None
        Version of the ONNX operators, 13 or newer; None leaves it to skl2onnx.

    card : ModelCard or str, default=None
        Facts to keep in the file's metadata, see :func:`describe`.

    Returns
    -------
    onnx.ModelProto
        The model. Rows that ``predict`` refuses come out as NaN.

    Raises
    ------
    ImportError
        Without skl2onnx: ``pip install -e ".[onnx]"`` in the project's folder installs it.
    ValueError
        If an estimator has no converter, or skl2onnx fails on it.
    sklearn.exceptions.NotFittedError
        If the model is not fitted.

    Examples
    --------
    With ``onnxruntime``, in any language that has it::

        to_onnx(model, "arm.onnx")
        session = onnxruntime.InferenceSession("arm.onnx")
        (correction_mm,) = session.run(None, {"X": joint_angles})
    """
    if not (isinstance(dtype, str) and dtype in ("double", "float")):
        raise ValueError(f"dtype must be 'double' or 'float', got {show(dtype)}.")
    if target_opset is not None and not isinstance(target_opset, int | dict):
        raise ValueError(f"target_opset must be a whole number, got {show(target_opset)}.")
    _check_card(card)
    path = None if path is None else check_path("path", path)
    check_fitted(model)
    # Late: skl2onnx takes a second to import.
    from sklearn_raacmm.export import _onnx

    converted = _onnx.convert(model, dtype, target_opset)
    facts = {"sklearn_raacmm_version": __version__}
    if card is not None:
        facts["model_card"] = str(card)
    for key, value in facts.items():
        entry = converted.metadata_props.add()
        entry.key, entry.value = key, value
    if path is not None:
        write_whole({path: converted.SerializeToString()})
    return converted


def describe(model, X=None, y=None, groups=None, *, n_folds=5, serial_number=None, date=None):
    """Say what a fitted model is, so that whoever receives its file knows.

    A fitted model does not keep the poses that it was fitted on: give them here, and pass the card
    on with the file.

    Parameters
    ----------
    model : estimator
        Fitted.

    X : array-like of shape (n_samples, n_features), default=None
        What the model was fitted on, usually joint angles in the unit it takes: for the number of
        rows, the range of every joint and the hull of the probe's positions.

    y : array-like of shape (n_samples, 3) or (n_samples,), default=None
        Residuals in mm that it was fitted on: for the error before and after.

    groups : array-like of shape (n_samples,), default=None
        Label of the position of each row.

    n_folds : int, default=5
        Where `groups` are given, the error after the correction is that at positions left out, a
        copy of the model having been fitted on the others, in so many folds. 0, or without
        `groups`, or of a model that :func:`update_correction` has changed: that at the rows given,
        and the card says so.

    serial_number : str, default=None
        Of the arm. Like `date` it becomes a macro of the header that :func:`export_c` writes.

    date : str or datetime.date, default=None
        Of the measurement, or of the model.

    Returns
    -------
    ModelCard
        A dict of plain values, fit for JSON. ``str`` of it is Markdown. Deviations are in mm; 2S is
        the single-point repeatability, the mean over positions. Where `y` are deviations from the
        means of their positions, the means are taken off what is left, too: neither data nor
        model say where they are. ``data_fingerprint`` is the SHA-256 of the rows given.
        ``updates`` lists what :func:`update_correction` has recorded.

    Raises
    ------
    ValueError
        If the arrays do not fit together or the model, or hold NaN or infinity.
    sklearn.exceptions.NotFittedError
        If the model is not fitted.

    Examples
    --------
    >>> from sklearn_raacmm import CylindricalResidualTarget, PoseFeatures, RBFNetRegressor
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> from sklearn_raacmm.export import describe
    >>> from sklearn.pipeline import make_pipeline
    >>> test = make_single_point(n_positions=6, n_poses=20, random_state=0)  # simulated
    >>> model = make_pipeline(
    ...     PoseFeatures(test.arm, append_azimuth=True),
    ...     CylindricalResidualTarget(RBFNetRegressor(20)),
    ... ).fit(test.data, test.target)
    >>> card = describe(model, test.data, test.target, test.groups, n_folds=3)
    >>> card["training"]["positions"], card["input"]
    (6, '6 joint angles in rad')
    >>> print(str(card)[:32])
    # Residual correction of an arm
    """
    return card_of(model, X, y, groups, n_folds=n_folds, serial_number=serial_number, date=date)
