"""What the user gives, checked: parameters, and the data as a problem in memory or in blocks."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.network._blocks import ArrayChunks, dask_chunks, draw_rows, is_dask
from sklearn_raacmm.network._kernels import KERNELS
from sklearn_raacmm.network._rows import merge
from sklearn_raacmm.utils import (
    LARGEST,
    are_deviations,
    check_data,
    check_weights,
    encode_groups,
    floats,
)

# Data of more rows are read in blocks, and repeated rows not merged. Distinct rows held of these.
IN_MEMORY_ROWS, HELD_ROWS = 100_000, 10_000
# Squared distances are off by rounding of the largest: beyond 1e6 widths, by more than 1e-4.
_MAX_RANGE = 1e6
# Beyond so many ranges a Gaussian differs from 1 by less than 1e-14.
_MAX_WIDTH = 1e7


def read_rows(estimator, X, y, sample_weight, groups, labelled, rng):
    """The data, checked, as distinct rows, and None; or a sample of them, and what all rows are.

    Of a sample the chunks of all rows, their number and weight. `labelled` says whether groups have
    constants; None: where their mean targets are small.
    """

    def in_blocks(chunks, n_features):
        if groups is not None:
            raise ValueError(
                f"groups are for at most {IN_MEMORY_ROWS} rows, which are held in memory; there "
                f"are {len(chunks)}."
            )
        n, weight, sample, complete = draw_rows(chunks, n_features, HELD_ROWS, rng.randint(2**31))
        return sample, None if complete else (chunks, n, weight)

    if is_dask(X):
        chunks = dask_chunks(X, y, sample_weight)
        if len(chunks) > IN_MEMORY_ROWS:
            estimator.n_features_in_ = X.shape[1]
            estimator._flat = y.ndim == 1
            return in_blocks(chunks, X.shape[1])
        X, y = X.compute(), np.asarray(y)
        sample_weight = None if sample_weight is None else np.asarray(sample_weight)
    X, y = check_data(estimator, X, y)
    _refuse_tiny("X", X)
    _refuse_tiny("y", y)
    weights = check_weights(sample_weight, X)
    estimator._flat = y.ndim == 1
    Y = y.reshape(len(y), -1).astype(np.float64, copy=False)
    if len(X) > IN_MEMORY_ROWS:
        return in_blocks(ArrayChunks(X, Y, weights), X.shape[1])
    codes = None if groups is None else encode_groups(groups, len(X))[1]
    if labelled is None and codes is not None:
        labelled = are_deviations(Y, codes, weights)
    return merge(X, Y, weights, codes=codes if labelled else None), None


def _refuse_tiny(name, array):
    """Refuse columns of numbers so small that their squares underflow."""
    if not array.size:
        return
    size = np.maximum(array.max(axis=0), -array.min(axis=0))
    tiny = (size > 0) & (size < 1 / LARGEST**2)
    if np.any(tiny):
        raise ValueError(
            f"{name} holds a column of numbers no larger than {np.min(size[tiny]):g}: numbers "
            f"below {1 / LARGEST**2:g} are refused, as their squares underflow. Use a smaller unit."
        )


def check_kernel(kernel, length_scale, n_outputs):
    """Kernel of every output as a list, which given widths have to go with."""
    if isinstance(kernel, str):
        return [kernel] * n_outputs
    names = np.asarray(kernel)
    if names.shape != (n_outputs,) or not all(name in KERNELS for name in names.tolist()):
        raise ValueError(
            f"kernel must be a name, or one of {', '.join(KERNELS)} for each of the {n_outputs} "
            f"outputs; got {kernel!r:.60}."
        )
    if np.ndim(length_scale) != 2:
        raise ValueError(
            "A kernel for each output needs length_scale of shape (n_outputs, n_features), too."
        )
    return names.tolist()


def check_length_scale(length_scale, X, n_outputs, alpha, shared):
    """Widths of every feature, (d,), or of every output (q, d); None where they are to be found."""
    if isinstance(length_scale, str):
        return None
    width, d = floats("length_scale", length_scale), X.shape[1]
    if width.shape not in ((), (d,), (n_outputs, d)):
        raise ValueError(
            f"length_scale has shape {width.shape}; it must be a number or have one entry for each "
            f"of the {d} features, or such a row for each of the {n_outputs} outputs."
        )
    if shared and width.ndim == 2:
        raise ValueError("length_scale has a row for each output, which shared=True rules out.")
    if not np.all(width >= 1 / LARGEST):
        raise ValueError(
            f"length_scale must be positive, at least {1 / LARGEST:g}; got {length_scale!r:.60}."
        )
    width = width if width.ndim == 2 else np.broadcast_to(width, d).copy()
    ranges = np.ptp(X, axis=0)
    for row in np.atleast_2d(width) if len(X) else ():
        i = int(np.argmax(ranges / row))
        if ranges[i] > _MAX_RANGE * row[i]:
            raise ValueError(
                f"length_scale is {row[i]:g} for feature {i}, whose range is {ranges[i]:g}: more "
                f"than {_MAX_RANGE:g} times as wide, which double precision does not resolve."
            )
        if alpha is not None and alpha.min() == 0 and 0 < ranges[i] * _MAX_WIDTH < row[i]:
            raise ValueError(
                f"length_scale is more than {_MAX_WIDTH:g} times the range of every feature: with "
                "alpha=0 double precision does not tell the radial functions from a constant."
            )
    return width


def check_alpha(alpha, n_outputs):
    """Ridge of every output (q,); None where it is to be found."""
    if isinstance(alpha, str):
        return None
    values = floats("alpha", alpha)
    if values.ndim > 1 or (values.ndim == 1 and len(values) != n_outputs):
        raise ValueError(
            f"alpha has shape {values.shape}; it must be a number or have one entry for each of "
            f"the {n_outputs} outputs."
        )
    if not np.all((values >= 0) & np.isfinite(values)):
        raise ValueError(f"alpha must be finite and not negative; got {alpha!r:.60}.")
    return np.broadcast_to(values, n_outputs).copy()
