"""Functions of blocks of rows: here, or by whatever computes the tasks of dask.

A block that is lost with the process that held it is made again. Results come in the order of the
blocks: what is added up is the same number wherever it was computed.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import warnings
from collections.abc import Callable, Iterable, Sequence
from functools import reduce
from typing import Any

from sklearn_raacmm.utils import one_blas_thread


def of_blocks(function: Callable, given: Iterable[tuple], by_dask: bool, hold: bool = False) -> Any:
    """Results of a function of the arguments of each block, in the order of the blocks.

    To `hold` them leaves what dask makes where it is; such a result may be an argument again.
    """
    if not by_dask:
        found = (function(*one) for one in given)
        return [*found] if hold else found
    from dask.base import compute, persist
    from dask.delayed import delayed

    task = delayed(_with_one_thread, pure=False)
    tasks = (task(function, *one) for one in given)
    with warnings.catch_warnings():
        # Arguments are sent with the tasks, so that a block that is lost can be made again.
        warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
        return persist(*tasks) if hold else compute(*tasks)


def sums_of_blocks(function: Callable, blocks: Sequence[Any], by_dask: bool) -> list[Any]:
    """Sums of the arrays that a function makes of each of the blocks, added in their order."""

    def added(one, other):
        return [a + b for a, b in zip(one, other, strict=True)]

    return list(reduce(added, of_blocks(function, ((block,) for block in blocks), by_dask)))


@one_blas_thread
def _with_one_thread(function, *given):
    return function(*given)
