"""Rows in chunks: what is computed for many rows is computed for some of them at a time."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

# Upper bound of the rows of every chunk, for the tests only (``pytest --chunk-rows 7``): data of
# a few rows then cross the borders of chunks, too. None: the sizes that the callers ask for.
LIMIT = None


def chunk_size(n_rows: int) -> int:
    """Number of rows of a chunk: `n_rows`, at least 1, and no more than the tests allow."""
    size = max(1, n_rows)
    return size if LIMIT is None else min(size, LIMIT)


def chunks(n_rows: int, size: int) -> list[slice]:
    """Slices of at most `size` rows that cover `n_rows` rows.

    Callers choose a size for which what they compute stays in the processor's cache.
    """
    # Not `sklearn.utils.gen_batches`: its checks take as long as the pose of one row.
    step = chunk_size(size)
    return [slice(start, min(start + step, n_rows)) for start in range(0, n_rows, step)]
