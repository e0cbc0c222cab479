"""For whoever measures with an arm and does not program: tables in, a report out, one command."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.app._cells import TableError
from sklearn_raacmm.app._tables import Table, read_lengths, read_table

__all__ = [
    "Table",
    "TableError",
    "read_lengths",
    "read_table",
]
