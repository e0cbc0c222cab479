"""What the user gives, checked: parameters, and the data as rows in memory or in blocks."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

import numpy as np

from sklearn_raacmm.network import _rows
from sklearn_raacmm.network._kernels import KERNELS, kernel_matrix
from sklearn_raacmm.utils import LARGEST, Groups, check_data, check_weights, floats, is_dask

# Squared distances are off by rounding of the largest: beyond 1e6 widths, by more than 1e-4.
_MAX_RANGE = 1e6
# Beyond so many ranges a Gaussian differs from 1 by less than 1e-14.
_MAX_WIDTH = 1e7


def read_data(estimator, X, y, sample_weight, groups):
    """The data, checked, as rows in memory or of dask arrays.

    They have codes of groups where these have constants: where their mean targets are small.
    """
    source: Any = _rows.DaskRows(X, y, sample_weight) if is_dask(X) else None
    # Robust weights need the residuals of all rows.
    if source is None or source.n_rows <= _rows.IN_MEMORY_ROWS or estimator.loss == "tukey":
        if source is not None:
            X, y = X.compute(), np.asarray(y)
            sample_weight = None if sample_weight is None else np.asarray(sample_weight)
        X, y = check_data(estimator, X, y)
        _refuse_tiny("X", X)
        _refuse_tiny("y", y)
        source = _rows.Rows(X, y.reshape(len(y), -1), check_weights(sample_weight, X))
    estimator.n_features_in_, estimator._flat = X.shape[1], np.ndim(y) == 1
    if groups is None:
        return source
    if source.n_rows > _rows.IN_MEMORY_ROWS:
        raise ValueError(
            f"groups are for at most {_rows.IN_MEMORY_ROWS} rows, which are held in memory; there "
            f"are {source.n_rows}."
        )
    codes = Groups.encoded(groups, source.n_rows)[1]
    constants = Groups(codes).are_deviations(source.Y, source.weights)
    return source._replace(codes=codes) if constants else source


def _refuse_tiny(name, array):
    """Refuse columns of numbers so small that their squares underflow."""
    size = np.maximum(array.max(axis=0), -array.min(axis=0))
    tiny = (size > 0) & (size < 1 / LARGEST**2)
    if np.any(tiny):
        raise ValueError(
            f"{name} holds a column of numbers no larger than {np.min(size[tiny]):g}: numbers "
            f"below {1 / LARGEST**2:g} are refused, as their squares underflow. Use a smaller unit."
        )


def check_parameters(estimator, X, n_outputs):
    """Kernels, widths (d,) and ridges (q,); of the last two None where they are to be found."""
    kernels = tuple(KERNELS) if estimator.kernel == "auto" else estimator.kernel
    kernels = tuple(kernels) if isinstance(kernels, list | tuple) else (kernels,)
    unknown = [kernel for kernel in kernels if not (callable(kernel) or kernel in KERNELS)]
    if unknown or not kernels:
        raise ValueError(
            f"kernel must be 'auto', functions, or of {', '.join(KERNELS)}; got {estimator.kernel}."
        )
    for kernel in filter(callable, kernels):
        _check_kernel(kernel, X.shape[1])
    alpha = _of_each("alpha", estimator.alpha, n_outputs, "outputs")
    if alpha is not None and not np.all((alpha >= 0) & np.isfinite(alpha)):
        raise ValueError(f"alpha must be finite and not negative; got {estimator.alpha!r:.60}.")
    width = _of_each("length_scale", estimator.length_scale, X.shape[1], "features")
    if width is not None:
        if estimator.inputs == "ranks":
            X = X[:2] * 0 + [[0.0], [1.0]][: len(X)]  # from the least rank to the largest
        _check_widths(estimator.length_scale, width, X, alpha)
    if estimator.n_centers == "auto" and alpha is not None and not np.all(alpha > 0):
        raise ValueError(
            'n_centers="auto" needs alpha > 0, by which the noise is known: give their number, '
            f"or the share of variance they may leave; got a least alpha of {alpha.min():g}."
        )
    return kernels, width, alpha


def _check_kernel(kernel, d):
    """Refuse a user's function that is no kernel of d features, or whose slope is another's."""
    name, step = getattr(kernel, "__name__", kernel), 1e-4
    s = np.linspace(0.0, 30.0, 61)
    K, slope = kernel(s.copy(), True)
    if np.shape(K) != s.shape or np.shape(slope) != s.shape or not abs(K[0] - 1) < 1e-9:
        raise ValueError(
            f"kernel {name} must return an array of the shape of what it is given, 1 at distance "
            f"0, and with slope=True two; for {s.shape} it returns {np.shape(K)}, from "
            f"{np.ravel(K)[0]:g}, and {np.shape(slope)}."
        )
    numeric = (kernel(s[1:] + step) - kernel(s[1:] - step)) / (2 * step)
    i = 1 + np.argmax(np.abs(numeric - slope[1:]))
    if not abs(numeric[i - 1] - slope[i]) < 1e-4 * max(1.0, abs(slope[i])):
        raise ValueError(
            f"kernel {name} says that its slope at the squared distance {s[i]:g} is {slope[i]:g}, "
            f"but by differences of its values it is {numeric[i - 1]:g}."
        )
    rows = np.random.RandomState(0).standard_normal((60, d))
    for width in (0.3, 1.0, 3.0):
        least = np.linalg.eigvalsh(kernel_matrix(rows / width, rows / width, kernel))[0]
        if least < -1e-8:
            raise ValueError(
                f"kernel {name} is not positive definite for {d} features: its matrix of 60 rows "
                f"has the eigenvalue {least:.3g}."
            )


def _of_each(name, value, n, what):
    """A number, or one for each of n, as an array (n,); None where it is to be found."""
    if isinstance(value, str):
        return None
    value = floats(name, value)
    if value.shape not in ((), (n,)):
        raise ValueError(
            f"{name} has shape {value.shape}; it must be a number or have one entry for each of "
            f"the {n} {what}."
        )
    return np.broadcast_to(value, n).copy()


def _check_widths(length_scale, width, X, alpha):
    """Refuse widths (d,), given as `length_scale`, that double precision does not resolve."""
    if not np.all(width >= 1 / LARGEST):
        raise ValueError(
            f"length_scale must be positive, at least {1 / LARGEST:g}; got {length_scale!r:.60}."
        )
    ranges = np.ptp(X, axis=0)
    i = np.argmax(ranges / width)
    most = ranges[i] / width[i]
    if most > _MAX_RANGE:
        raise ValueError(
            f"length_scale is {width[i]:g} for feature {i}, whose range is {ranges[i]:g}: more "
            f"than {_MAX_RANGE:g} times as wide, which double precision does not resolve."
        )
    if alpha is not None and alpha.min() == 0 and 0 < most * _MAX_WIDTH < 1:
        raise ValueError(
            f"length_scale is more than {_MAX_WIDTH:g} times the range of every feature: with "
            "alpha=0 double precision does not tell the radial functions from a constant."
        )
