"""Lines that say how far a fit is, by `logging`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter

_LOGGER = logging.getLogger("sklearn_raacmm")


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Log one line when a stage of a fit has ended: its name and how long it took.

    As a decorator, of every call of a function. The line goes to the logger "sklearn_raacmm" at
    level INFO: ``logging.basicConfig(level=logging.INFO)`` shows it.
    """
    start = perf_counter()
    yield
    _LOGGER.info("%s: %.1f s", name, perf_counter() - start)
