"""Functions of blocks of rows: here, or by whatever computes the tasks of dask.

A block that is lost with the process that held it is made again. Results come in the order of the
blocks: what is added up is the same number wherever it was computed.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import warnings
from collections.abc import Callable, Iterable, Sequence
from contextlib import contextmanager
from functools import reduce
from typing import Any

from sklearn_raacmm.utils import one_blas_thread


def results(function: Callable, given: Iterable[tuple], by_dask: bool = False) -> Any:
    """Results of a function of the arguments of each block, in the order of the blocks."""
    if not by_dask:
        return (function(*one) for one in given)
    from dask import compute

    with _large_graphs():
        return compute(*(_task(function, *one) for one in given))


def held_blocks(function: Callable, given: Iterable[tuple], by_dask: bool = False) -> Any:
    """The same, each of which stays where it is made."""
    if not by_dask:
        return [*results(function, given)]
    from dask import persist

    with _large_graphs():
        return persist(*(_task(function, *one) for one in given))


def each(function: Callable, blocks: Sequence[Any]) -> Any:
    """Results of a function of each of the `held_blocks`, in their order."""
    by_dask = any(type(block).__module__.startswith("dask.") for block in blocks)
    return results(function, ((block,) for block in blocks), by_dask)


def total_of(function: Callable, blocks: Sequence[Any]) -> list[Any]:
    """Sums of the arrays that a function makes of each of the blocks, added in their order."""

    def added(one, other):
        return [a + b for a, b in zip(one, other, strict=True)]

    return list(reduce(added, each(function, blocks)))


@contextmanager
def _large_graphs():
    """Arguments are sent with the tasks, so that a block that is lost can be made again."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
        yield


def _task(function, *given):
    from dask import delayed

    return delayed(_with_one_thread, pure=False)(function, *given)


@one_blas_thread
def _with_one_thread(function, *given):
    return function(*given)
