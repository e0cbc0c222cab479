"""Known lengths of the command line."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.app._cells import TableError


def length_of(text):
    """Known length of ``--length FROM:TO:MM:SD``, as `learn_correction` takes them.

    Raises
    ------
    TableError
        If these are not two labels and two numbers.
    """
    parts = text.split(":")
    try:
        first, second, length, sd = parts
        return first.strip(), second.strip(), float(length), float(sd)
    except ValueError:
        raise TableError(
            "--length needs two positions, their distance and its standard deviation in mm, such "
            f"as A:B:500.012:0.005, got {text!r}."
        ) from None
