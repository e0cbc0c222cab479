"""Warnings that point to the line of the user's program which called the package."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import contextlib
import os
import sys
import warnings

import joblib
import sklearn

# Of a warning's way to the user: the package, what calls it in a pipeline or in several processes,
# and what its decorators are made of.
_FOLDERS = (
    os.path.dirname(os.path.dirname(os.path.abspath(__file__))),
    *sklearn.__path__,
    *joblib.__path__,
)
_SKIPPED = (*(folder + os.sep for folder in _FOLDERS), contextlib.__file__)


def warn_user(message: str | Warning, category: type[Warning] = UserWarning) -> None:
    """Warn at the line that calls the package, however many of its functions are in between.

    As ``warnings.warn(..., skip_file_prefixes=...)``, which Python 3.11 does not have. `category`
    is that of a message that is text.
    """
    frame = sys._getframe(1)
    while frame.f_code.co_filename.startswith(_SKIPPED) and frame.f_back is not None:
        frame = frame.f_back
    warnings.warn_explicit(
        message,
        category,
        frame.f_code.co_filename,
        frame.f_lineno,
        frame.f_globals.get("__name__", "<unknown>"),
        frame.f_globals.setdefault("__warningregistry__", {}),
    )
