"""Guards of a correction: each stage fades by its own deviation, and their sum is capped."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np


def guarded(parts, fadings, cap_mm, n_rows):
    """Sum of the stages of a correction, whatever models they come from.

    Parameters
    ----------
    parts : list of (ndarray of shape (n_rows, 3), ndarray of shape (n_rows, 3) or None)
        Correction and standard deviation of each stage, mm; the deviation may be None where
        nothing fades.
    fadings : list of Fading
        One for each stage, or more.
    cap_mm : float
        Longest correction; infinite for none.
    n_rows : int

    Returns
    -------
    correction : ndarray of shape (n_rows, 3)
    share : ndarray of shape (n_rows,)
        Its length over that of the unguarded correction, at most 1.
    """
    whole, total = np.zeros((n_rows, 3)), np.zeros((n_rows, 3))
    for (value, std), fading in zip(parts, fadings, strict=False):
        whole = whole + value
        total = total + (value if std is None else value * fading.share(std)[:, None])
    length = np.linalg.norm(total, axis=1)
    capped = np.minimum(1.0, cap_mm / np.maximum(length, 1e-300))
    before = np.linalg.norm(whole, axis=1)
    share = np.where(before > 0, capped * length / np.maximum(before, 1e-300), 1.0)
    return total * capped[:, None], np.minimum(share, 1.0)
