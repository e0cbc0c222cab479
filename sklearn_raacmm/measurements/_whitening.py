r"""Rows of three coordinates, whitened: their noise is independent and of one size.

A row says :math:`y = A w + B u + e` along some directions. The unknowns u of the feature that the
row belongs to are of no interest: the constant of a position, the plane that was touched. With W
the root of the row (:math:`W'W` is the inverse covariance of e, times the weight of the row),
:math:`T = \sum (W B)' W B` over the rows of a feature and :math:`E E' = T^{-1}`, the columns
:math:`W B E` are a basis of all that the unknowns explain. What is left of whitened columns beside
it takes the unknowns out exactly (Frisch-Waugh theorem). What is known of the unknowns beforehand
is added to T, and draws them to 0.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

import numpy as np

from sklearn_raacmm.utils import Groups

# Share of what is known best of a feature's unknowns that is rounding: a ball touched on one side.
_ROUNDING = 1e-12


class Whitening:
    """What whitens rows, and the basis of what the unknowns of their features explain.

    Rows of some weights (n,), whose noise has the `root` (n, 3, 3) or is I. `unknowns` (n, 3, q)
    are what one of each unknown of the `feature` (n,) does to a row: None is a shift, of which
    `known` is the precision beforehand. `rank` says how many numbers a row shows.
    """

    def __init__(
        self,
        weights: np.ndarray,
        root: np.ndarray | None = None,
        feature: np.ndarray | None = None,
        unknowns: np.ndarray | None = None,
        known: float = 0.0,
        rank: np.ndarray | float = 3.0,
    ) -> None:
        # With the root of the weight, 0 along what a row does not show.
        self.root: np.ndarray = np.sqrt(weights)[:, None, None] * (
            np.eye(3) if root is None else root
        )
        self.feature: Any = feature  # (n,) from 0; None: no row has unknowns
        self.unit: Any = None  # (n_features, q, q) E: unknowns by what makes their precision 1
        self.moves: Any = None  # (n, 3, q) B E
        self.basis: Any = None  # (n, 3, q) W B E
        self.precision: Any = None  # (n_features, q) of the unknowns, along those of E
        self.n_observations: float = float(
            np.sum(rank * weights)
        )  # less what the unknowns have taken
        if feature is None:
            return
        side = self.root if unknowns is None else self.root @ unknowns
        value, axes = np.linalg.eigh(Groups(feature).sums(side.swapaxes(1, 2) @ side))
        shown = value > _ROUNDING * np.maximum(value[:, -1:], 1e-300)
        taken = 0 if known else np.count_nonzero(shown)
        self.n_observations = max(self.n_observations - taken, 0.0)
        self.precision = value = np.where(shown, value, 0.0) + known
        size = np.where(value > 0, 1 / np.sqrt(np.where(value > 0, value, 1.0)), 0.0)
        self.unit = axes * size[:, None]
        of_row = self.unit[feature]
        self.moves = of_row if unknowns is None else unknowns @ of_row
        self.basis = side @ of_row

    def explained(self, whitened: np.ndarray) -> np.ndarray:
        """Sums over each feature of products of the basis with columns, (n_features, q, m)."""
        return Groups(self.feature).sums(self.basis.swapaxes(1, 2) @ whitened)

    def deviations(self, columns: np.ndarray) -> np.ndarray:
        """Columns (n, 3, m), whitened, less what unknowns explain of them."""
        whitened = self.root @ columns
        if self.basis is None:
            return whitened
        return whitened - self.basis @ self.explained(whitened)[self.feature]

    def centred(self, columns: np.ndarray) -> np.ndarray:
        """Columns (n, 3) or (n, 3, m) in their own unit, less what unknowns explain of them."""
        if self.moves is None or self.feature is None:
            return columns
        flat = columns.reshape(len(columns), 3, -1)
        found = self.explained(self.root @ flat)[self.feature]
        return columns - (self.moves @ found).reshape(columns.shape)

    def unknowns(self, columns: np.ndarray) -> np.ndarray:
        """The unknowns (n_features, q, m) that explain columns (n, 3, m)."""
        return self.unit @ self.explained(self.root @ columns)
