"""The test program that comes with exported C: it compares rows with what predict gave."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.export._c_text import Tables
from sklearn_raacmm.export._proof import TOLERANCE


def make_test(rows, gap, name, stem, dtype, corrects):
    """Text of the test program of ``<stem>.c``.

    `rows` are test rows and their answers, from which the same operations in Python are `gap` away.
    ``corrects`` says whether the function is ``correct``, not ``predict``.
    """
    write, X, expected = Tables(dtype), rows["X"], rows["y"]
    refused = np.isnan(expected).any(axis=1)
    kind = np.select([np.isnan(X), np.inf == X, -np.inf == X], [1, 2, 3], 0)
    tolerance = TOLERANCE[dtype] * np.abs(expected[~refused]).max(initial=1e-3)
    tolerance = max(tolerance, 10 * gap)
    tables = write.table("input", np.where(kind == 0, X, 0.0))
    tables += write.table("input_kind", kind, "0 a number, 1 NaN, 2 infinity, 3 -infinity")
    tables += write.table("expected", np.where(refused[:, None], 0.0, expected))
    tables += write.table("refused", refused, "1 where all outputs have to be NaN")
    tables += f"static const {dtype} tolerance = {write.literal(tolerance)};\n"
    n, q = expected.shape
    return write.c(
        "test", tables=tables, n=n, d=X.shape[1], q=q, total=expected.size,
        verb="correct" if corrects else "predict", name=name, upper=name.upper(), stem=stem,
        command=f"cc -std=c99 -O2 -o {stem}_test {stem}_test.c {stem}.c -lm && ./{stem}_test",
    )  # fmt: skip
