"""Warnings that name the line of the user who called, however deep in the package they arise."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import os
import sys
import warnings

_PACKAGE = os.path.dirname(os.path.dirname(__file__)) + os.sep
# Modules that stand between a caller and the package: wrappers of methods, and parallel loops.
_BETWEEN = ("sklearn.", "joblib.", "contextlib", "functools", "threadpoolctl")


def warn_user(message, category=UserWarning):
    """Warn on the line outside of the package that has led here.

    Parameters
    ----------
    message : str
    category : type, default=UserWarning
    """
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and _is_ours(frame):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)


def _is_ours(frame):
    name = frame.f_globals.get("__name__", "")
    return frame.f_code.co_filename.startswith(_PACKAGE) or name.startswith(_BETWEEN)
