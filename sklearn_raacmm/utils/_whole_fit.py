"""Fits that are whole or have not happened."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar, cast

from sklearn_raacmm.utils._findings import hear

Fit = TypeVar("Fit", bound=Callable[..., Any])


def whole_fit(fit: Fit) -> Fit:
    """Make a `fit` that leaves the estimator as it was until it is complete, and returns it.

    The fit works on a shallow copy, and the estimator takes over all attributes of the copy in one
    assignment. Whatever interrupts a refit, an exception or Ctrl-C, leaves the old model whole.
    What is found in the data meanwhile is kept in `findings_`, and said at the end.
    """

    @wraps(fit)
    def wrapper(self, *args, **kwargs):
        aside = object.__new__(type(self))
        aside.__dict__ = dict(vars(self))
        _, heard = hear(fit, aside, *args, **kwargs)
        aside.findings_ = tuple(heard)
        self.__dict__ = aside.__dict__
        return self

    return cast(Fit, wrapper)
