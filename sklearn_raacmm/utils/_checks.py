"""Shared input checks: masked arrays, dates, mappings, overflowing numbers, options, files."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterable, Mapping, Sequence
from numbers import Integral, Real
from types import NoneType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import issparse
from sklearn import get_config
from sklearn.utils.validation import _check_sample_weight, check_is_fitted, validate_data

from sklearn_raacmm.utils._findings import Finding

# Smaller numbers can be squared, summed and squared again without overflow.
LARGEST = 1e50
# What has no method that makes an array may still be numbers; None and dicts get sentences of their
# own.
_MAY_BE_ARRAYS = (Sequence, Real, NoneType, dict)


def refuse_disguised(name: str, value: object) -> None:
    """Refuse masked values, dates, mappings, and arrays that are to stay another library's.

    NumPy would use the values under a mask and convert dates to numbers of days; scikit-learn would
    take the keys of a mapping for data.
    """
    if type(value) is np.ndarray and value.dtype.kind == "f":
        return
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise ValueError(
            f"{name} has {np.ma.count_masked(value)} of {value.size} values masked: leave their "
            "rows out, or fill them."
        )
    own = getattr(value, "__array_namespace__", None)
    if (
        own is not None
        and not isinstance(value, np.ndarray | np.generic)
        and get_config()["array_api_dispatch"]
    ):
        raise TypeError(
            f"{name} is an array of {own().__name__}, and array_api_dispatch is on, but this "
            "package computes with NumPy: convert the array, or switch array_api_dispatch off."
        )
    if isinstance(value, dict) and not issparse(value):  # SciPy has a sparse one
        raise TypeError(
            f"{name} must be an array, got {type(value).__name__}: of a data set, give its arrays, "
            "such as data and target."
        )
    if isinstance(value, str | bytes):
        raise ValueError(f"{name} must hold numbers, got {value!r:.60}.")
    if not (hasattr(value, "__array__") or isinstance(value, _MAY_BE_ARRAYS) or issparse(value)):
        raise TypeError(f"{name} must be an array, got {value!r:.60}.")
    if isinstance(value, Integral) and abs(int(value)) > LARGEST:  # too long for a float, perhaps
        raise ValueError(f"{name} holds a number above {LARGEST:g}, got {value!r:.60}.")
    dtypes = getattr(value, "dtypes", getattr(value, "dtype", None))  # of a frame, or of an array
    kinds = {getattr(t, "kind", "") for t in (dtypes if np.iterable(dtypes) else [dtypes])}
    if kinds & {"m", "M"}:
        raise ValueError(f"{name} must hold numbers, got dates or times.")


def _refuse_huge(name, array):
    """Refuse numbers whose squares overflow, and what is not a number at all."""
    largest = _largest(array)
    if largest <= LARGEST:  # false for NaN
        return
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        where = f"; the first is in row {Finding.row_numbers(bad[0, :1])[0]}" if array.ndim else ""
        said = "values that are missing, NaN or infinity"
        raise ValueError(f"{name} holds {len(bad)} {said}{where}.")
    raise ValueError(f"{name} holds {largest:g}: numbers above {LARGEST:g} are refused.")


def _largest(array):
    """Largest absolute value; NaN where there is one. In two passes, and no mask of that size."""
    return max(float(array.max(initial=0.0)), -float(array.min(initial=0.0)))


def is_dask(X: Any) -> bool:
    """Whether X is a dask array, which is not imported for the question."""
    return type(X).__module__.startswith("dask.array") and hasattr(X, "to_delayed")


def floats(
    name: str, value: object, shape: int | tuple[int, ...] | None = None, *, finite: bool = False
) -> np.ndarray:
    """Numbers as float64.

    With a number of columns as `shape` they are finite and have one row at least and so many
    columns. -1 is any number of columns, and makes one column of one dimension. A tuple is the
    whole shape. `finite` refuses NaN, infinity, and numbers whose squares overflow.
    """
    refuse_disguised(name, value)
    array = _converted(name, value)
    if isinstance(shape, tuple) and array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}.")
    if isinstance(shape, int):
        array = array[:, None] if shape == -1 and array.ndim == 1 else array
        if not (array.ndim == 2 and shape in (-1, array.shape[1])):
            needed = "(n_rows, n_columns)" if shape == -1 else f"(n_rows, {shape})"
            raise ValueError(f"{name} has shape {array.shape}; {needed} is needed.")
        if not array.size:
            raise ValueError(f"{name} is empty, of shape {array.shape}.")
    if finite or isinstance(shape, int):
        _refuse_huge(name, array)
    return array


def _converted(name, value):
    try:
        array = np.asarray(value)
        # Text and booleans would be converted silently, and complex numbers would lose a part.
        if array.dtype.kind in "iuf":
            return array.astype(np.float64, copy=False)
        if array.dtype.kind == "O" and not any(
            x is None or isinstance(x, str | bool) for x in array.flat
        ):
            return array.astype(np.float64)
    except (TypeError, ValueError, OverflowError):  # the last of whole numbers above 1e308
        array = None
    if array is not None and array.dtype.kind == "c":
        raise ValueError(f"{name} holds complex numbers. Complex data not supported.")
    raise ValueError(f"{name} must hold numbers, got {value!r:.60}.")


def check_features(estimator: object, X: object, **options: object) -> np.ndarray:
    """scikit-learn's check of X, and ours; with ``reset=False`` of a fitted estimator."""
    if options.get("reset") is False:
        # scikit-learn's `check_is_fitted` collects the tags of all steps first, which takes longer
        # than the prediction of one row.
        if "n_features_in_" not in vars(estimator):
            check_is_fitted(estimator)
        if isinstance(X, np.ndarray) and is_plain(estimator, X) and _largest(X) <= LARGEST:
            return X
    refuse_disguised("X", X)
    checked = validate_data(estimator, X, **options)
    _refuse_huge("X", checked)
    return checked


def is_plain(estimator: object, X: object) -> bool:
    """Whether X is an array as in `fit`, of which only the values remain to be checked.

    scikit-learn's own checks take several times as long as the prediction of one row.
    """
    return (
        type(X) is np.ndarray
        and X.dtype == np.float64
        and "feature_names_in_" not in vars(estimator)
        and X.ndim == 2
        and len(X) > 0
        and X.shape[1] == getattr(estimator, "n_features_in_", None)
    )


def check_data(estimator: object, X: object, y: object) -> tuple[np.ndarray, np.ndarray]:
    """X and y as float64, checked by scikit-learn and by us; y of any number of columns."""
    for name, value in (("X", X), ("y", y)):
        refuse_disguised(name, value)
    if issparse(y):
        raise TypeError("y is sparse, but dense targets are needed.")
    both = validate_data(estimator, X, y, dtype=np.float64, multi_output=True, y_numeric=True)
    inputs, targets = both[0], both[1].astype(np.float64, copy=False)
    # Of y, too: scikit-learn looks for NaN before it turns None into it.
    _refuse_huge("X", inputs)
    _refuse_huge("y", targets)
    return inputs, targets


def check_weights(
    sample_weight: ArrayLike | None, X: object, name: str = "sample_weight"
) -> np.ndarray:
    """Weights (n,) as float64, not negative and not all zero."""
    refuse_disguised(name, sample_weight)
    weights = _check_sample_weight(sample_weight, X, dtype=np.float64)
    _refuse_huge(name, weights)
    if np.any(weights < 0):
        raise ValueError(
            f"{name} must not be negative, but {np.sum(weights < 0)} of {weights.size} are (the "
            f"least is {weights.min():g})."
        )
    if not weights.any():  # scikit-learn asks since 1.9, in these words
        raise ValueError("Sample weights must contain at least one non-zero number.")
    return weights


def check_option(name: str, value: object, options: Iterable[str | None]) -> None:
    """Refuse what is not one of the options."""
    if not (value is None or isinstance(value, str)) or value not in options:
        raise ValueError(f"{name}={value!r:.60} is not one of {', '.join(map(repr, options))}.")


def check_flags(**flags: object) -> None:
    """Refuse what is neither True nor False, such as labels in the second place of `predict`."""
    for name, value in flags.items():
        if value is True or value is False:
            continue
        if not isinstance(value, np.bool_ | Integral) or value not in (0, 1):
            raise TypeError(f"{name} must be True or False, got {value!r:.60}.")


def listed(name: str, value: str | Iterable[Any]) -> list[Any]:
    """Several, as a list; one text is not several letters, and an array is its rows."""
    try:
        return [value] if isinstance(value, str) else list(value)
    except TypeError:
        raise ValueError(f"{name} must be a list, got {value!r:.60}.") from None


def check_shapes(
    owner: str,
    values: Mapping[str, ArrayLike | None],
    shapes: Mapping[str, tuple[int | str, ...]],
    sizes: Mapping[str, int],
    may_be_infinite: tuple[str, ...] = (),
) -> None:
    """Refuse arrays that are missing, do not fit together, or hold NaN or infinity.

    A file that lost a row would load, and fail in the first product of matrices. Shapes are whole
    numbers or names of `sizes`; a size that is not given is that of the first array that has it.
    """
    sizes = dict(sizes)
    for name, shape in shapes.items():
        value = values.get(name)
        if value is None:
            raise ValueError(f"The file is damaged: {name} of {owner} is missing.")
        found = np.shape(value)
        if len(found) != len(shape):
            raise ValueError(f"The file is damaged: {name} of {owner} has shape {found}.")
        for have, size in zip(found, shape, strict=True):
            if isinstance(size, str):
                size = sizes.setdefault(size, have)
            if have != size:
                raise ValueError(
                    f"The file is damaged: {name} of {owner} has shape {found}, where {size} in "
                    f"place of {have} would fit the other arrays."
                )
        bad = np.isnan(value) if name in may_be_infinite else ~np.isfinite(value)
        if np.any(bad):
            raise ValueError(f"The file is damaged: {name} of {owner} holds NaN or infinity.")
