"""What the user gives, checked and made a problem: in memory, or in blocks."""

import numpy as np

from sklearn_raacmm.network._center_choice import MAX_CANDIDATES
from sklearn_raacmm.network._large_data import ArrayChunks, chunked_problem, dask_chunks, is_dask
from sklearn_raacmm.network._training_data import merge, prepare
from sklearn_raacmm.network._width_search import SAMPLE_ROWS
from sklearn_raacmm.utils import (
    CENTRED,
    LARGEST,
    check_data,
    check_weights,
    encode_groups,
    share_of_means,
)

# Data of more rows are read in blocks, and repeated rows not merged.
IN_MEMORY_ROWS = 100_000


def read_problem(estimator, X, y, sample_weight, groups, offsets, rng):
    """The data, checked: in memory, or in blocks where they are many or elsewhere.

    Notes on the estimator the number of features, whether groups have offsets, and as `_flat`
    whether y has one dimension.

    Parameters
    ----------
    estimator : RBFNetRegressor
    X, y, sample_weight, groups
        As given to its `fit`.
    offsets : bool or None
        Whether groups have offsets. None: where their mean targets are zero.
    rng : numpy.random.RandomState
        Draws the rows that may become centres where there are more.

    Returns
    -------
    Problem or ChunkedProblem
    """
    held = max(estimator.max_candidates or MAX_CANDIDATES, SAMPLE_ROWS)
    # A linear part that the data have to ask for is added once they have.
    degree = 0 if estimator.degree == "auto" else estimator.degree
    ridged = isinstance(estimator.alpha, str)

    def in_blocks(chunks, n_features):
        return chunked_problem(chunks, n_features, degree, held, rng.randint(2**31), ridged)

    estimator.offsets_ = False
    if is_dask(X):
        chunks = dask_chunks(X, y, sample_weight)
        if len(chunks) > IN_MEMORY_ROWS:
            refuse_many(groups, len(chunks))
            estimator.n_features_in_ = X.shape[1]
            estimator._flat = y.ndim == 1
            return in_blocks(chunks, X.shape[1])
        X, y = X.compute(), np.asarray(y)
        sample_weight = None if sample_weight is None else np.asarray(sample_weight)
    X, y = check_data(estimator, X, y)
    refuse_tiny("X", X)
    refuse_tiny("y", y)
    weights = check_weights(sample_weight, X)
    estimator._flat = y.ndim == 1
    Y = y.reshape(len(y), -1).astype(np.float64, copy=False)
    codes = None if groups is None else encode_groups(groups, len(X))[1]
    if len(X) <= IN_MEMORY_ROWS:
        if offsets is None:
            offsets = codes is not None and share_of_means(Y, codes, weights)[0] < CENTRED
        estimator.offsets_ = bool(offsets)
        codes = codes if offsets else None
        return prepare(merge(X, Y, weights, codes=codes), degree, ridged)
    refuse_many(groups, len(X))
    return in_blocks(ArrayChunks(X, Y, weights), X.shape[1])


def refuse_many(groups, n_rows):
    """Refuse groups of rows that are read in blocks."""
    if groups is not None:
        raise ValueError(
            f"groups are for at most {IN_MEMORY_ROWS} rows, which are held in memory; there are "
            f"{n_rows}."
        )


def refuse_tiny(name, array):
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
