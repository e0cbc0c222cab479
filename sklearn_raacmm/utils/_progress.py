"""Lines that say how far a fit is, by `logging`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import logging
import sys
from contextlib import contextmanager
from time import perf_counter

_LOGGER = logging.getLogger("sklearn_raacmm")


@contextmanager
def stage(verbose, name):
    """Log one line when a stage of a fit has ended: its name and how long it took.

    The line goes to the logger "sklearn_raacmm" at level INFO. Where the program has not set up
    logging, it is printed.

    Parameters
    ----------
    verbose : bool or int
        Nothing is logged if false.
    name : str
        What the stage does.

    Examples
    --------
    >>> from sklearn_raacmm.utils import stage
    >>> with stage(False, "widths"):
    ...     pass
    """
    start = perf_counter()
    yield
    if not verbose:
        return
    line = f"{name}: {perf_counter() - start:.1f} s"
    if _LOGGER.hasHandlers():
        # The user's own set-up decides which levels it shows.
        _LOGGER.info(line)
    else:
        # To where Python prints now, which notebooks and tests exchange.
        print(f"{_LOGGER.name}: {line}", file=sys.stdout)
