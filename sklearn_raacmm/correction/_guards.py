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
        Smallest share of a stage that its fading leaves.
    """
    total, least = np.zeros((n_rows, 3)), np.ones(n_rows)
    for (value, std), fading in zip(parts, fadings, strict=False):
        share = np.ones(n_rows) if std is None else fading.share(std)
        total, least = total + value * share[:, None], np.minimum(least, share)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return total * np.minimum(1.0, cap_mm / np.maximum(length, 1e-300)), least
