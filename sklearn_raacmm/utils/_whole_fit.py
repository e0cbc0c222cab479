"""Fits that are whole or have not happened, and lines that say how far they are."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from time import perf_counter
from typing import Any, TypeVar, cast

from sklearn.base import _fit_context

from sklearn_raacmm.utils._findings import call_collecting

Fit = TypeVar("Fit", bound=Callable[..., Any])
_LOGGER = logging.getLogger("sklearn_raacmm")


def whole_fit(*, prefer_skip_nested_validation: bool) -> Callable[[Fit], Fit]:
    """Make a `fit` that leaves the estimator as it was until it is complete, and returns it.

    The parameters are checked before, by scikit-learn; those of inner estimators again unless
    `prefer_skip_nested_validation`.
    The fit works on a shallow copy, and the estimator takes over all attributes of the copy in one
    assignment. Whatever interrupts a refit, an exception or Ctrl-C, leaves the old model whole.
    What is found in the data meanwhile is kept in `findings_`, and reported at the end.
    """

    def decorate(fit: Fit) -> Fit:
        @_fit_context(prefer_skip_nested_validation=prefer_skip_nested_validation)
        @wraps(fit)
        def wrapper(self, *args, **kwargs):
            aside = object.__new__(type(self))
            aside.__dict__ = dict(vars(self))
            _, findings = call_collecting(fit, aside, *args, **kwargs)
            aside.findings_ = tuple(findings)
            self.__dict__ = aside.__dict__
            return self

        return cast(Fit, wrapper)

    return decorate


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Log one line when a stage of a fit has ended: its name and how long it took.

    As a decorator, of every call of a function. The line goes to the logger "sklearn_raacmm" at
    level INFO: ``logging.basicConfig(level=logging.INFO)`` shows it.
    """
    start = perf_counter()
    yield
    _LOGGER.info("%s: %.1f s", name, perf_counter() - start)
