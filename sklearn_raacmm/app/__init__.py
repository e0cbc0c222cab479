"""For whoever measures with an arm and does not program: tables in, a report out, one command.

The command ``raacmm`` (see ``raacmm --help``) is made of what stands here.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.app._cells import TableError
from sklearn_raacmm.app._main import main
from sklearn_raacmm.app._report import judge_limit, write_report
from sklearn_raacmm.app._tables import Table, read_lengths, read_table

__all__ = [
    "Table",
    "TableError",
    "judge_limit",
    "main",
    "read_lengths",
    "read_table",
    "write_report",
]
