"""For whoever measures with an arm and does not program: tables in, a report out, one command.

The command ``raacmm`` (see ``raacmm --help``) is made of what stands here.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import importlib
from typing import TYPE_CHECKING

from sklearn_raacmm.app._main import main

if TYPE_CHECKING:
    from sklearn_raacmm.app._report import write_report
    from sklearn_raacmm.app._sources import TableError
    from sklearn_raacmm.app._tables import Table, read_table

__all__ = [
    "Table",
    "TableError",
    "main",
    "read_table",
    "write_report",
]


def __getattr__(name: str) -> object:
    """Import what is asked for, when it is, as the package itself does."""
    if name in __all__:
        for module in ("_sources", "_tables", "_report"):
            if hasattr(found := importlib.import_module(f"{__name__}.{module}"), name):
                return getattr(found, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
