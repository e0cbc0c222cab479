"""Guards of a correction: it fades where little is known, and is never longer than a cap."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Guard:
    """Limits of a correction, whatever model it comes from.

    Attributes
    ----------
    size_mm : float
        Root mean square length of the training residuals.

    fade : float
        Factor of the standard deviation in the fading; 0 for none.

    cap_mm : float
        Longest correction; infinite for none.
    """

    size_mm: float
    fade: float
    cap_mm: float

    def factor(self, std):
        """Share of a correction that is left where its standard deviation is `std`.

        Wiener's factor for errors of the size of the residuals, known to this uncertainty. With the
        length of the correction for their size it would not vanish far away, where both grow.

        Parameters
        ----------
        std : ndarray of shape (n, 3)
            In mm.

        Returns
        -------
        ndarray of shape (n, 1)
        """
        doubt = np.square(self.fade * std).sum(axis=1, keepdims=True)
        size = self.size_mm**2
        return size / np.maximum(size + doubt, 1e-300)

    def apply(self, parts, n_rows):
        """Sum of the parts of a correction, each faded by its own deviation, and capped.

        Parameters
        ----------
        parts : list of (ndarray of shape (n_rows, 3), ndarray of shape (n_rows, 3) or None)
            Correction and standard deviation of each stage, mm; the deviation may be None where
            nothing fades.
        n_rows : int

        Returns
        -------
        ndarray of shape (n_rows, 3)
        """
        total = np.zeros((n_rows, 3))
        for value, std in parts:
            total = total + (value * self.factor(std) if self.fade > 0 else value)
        length = np.linalg.norm(total, axis=1, keepdims=True)
        return total * np.minimum(1.0, self.cap_mm / np.maximum(length, 1e-300))
