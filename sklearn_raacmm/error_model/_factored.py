"""Columns at poses that are not multiplied out, and what makes their standard deviations fast."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

import numpy as np
from scipy.linalg.blas import dtrmm


def waves(theta: np.ndarray, orders: np.ndarray, out: Any = None) -> np.ndarray:
    """exp(i k theta), (n, n_orders) complex; orders 1 to K by doubling, those beyond one by one."""
    n = int(np.count_nonzero(orders == np.arange(1, len(orders) + 1)))
    if out is None:
        out = np.empty((len(theta), len(orders)), dtype=complex)
    if n:
        out.real[:, 0], out.imag[:, 0] = np.cos(theta), np.sin(theta)
    have = 1
    while have < n:
        more = min(have, n - have)
        np.multiply(out[:, :more], out[:, have - 1 : have], out=out[:, have : have + more])
        have += more
    if n < len(orders):
        phase = theta[:, None] * orders[n:]
        np.cos(phase, out=out.real[:, n:])
        np.sin(phase, out=out.imag[:, n:])
    return out


class FactoredColumns:
    """Columns of the model at n poses, those of many waves of one joint as factors.

    The waves of a joint share the vector by which a turn about its axis moves the probe. Products
    with the columns are therefore taken with the waves first: one number for each pose, not three.
    The waves (n, n_waves) come in runs, of which `spans` are the first and last columns and
    `vectors` (n, 3, n_runs) what they share; `rest` (n, 3, m) are the columns after them.
    """

    def __init__(self, spans: list[Any], vectors: Any, waves: Any, rest: np.ndarray) -> None:
        self.spans: list[Any] = spans
        self.vectors: Any = vectors
        self.waves: Any = waves
        self.rest: np.ndarray = rest

    def dot(self, coef: np.ndarray) -> np.ndarray:
        """``columns @ coef``, (n, 3)."""
        n, _, m = self.rest.shape
        out = (self.rest.reshape(3 * n, m) @ coef[len(coef) - m :]).reshape(n, 3)
        for i, (start, end) in enumerate(self.spans):
            out += self.vectors[:, :, i] * (self.waves[:, start:end] @ coef[start:end])[:, None]
        return out

    def squares(self, root: "Root") -> np.ndarray:
        """Squared lengths (n, 3) of ``columns @ half``, of which `root` is made."""
        n, _, m = self.rest.shape
        # One product of all rows takes a quarter of the time of one for each pose.
        dots = root.product(self.rest.reshape(3 * n, m)).reshape(n, 3, -1)
        if not self.spans:
            return np.einsum("ncr,ncr->nc", dots, dots)
        runs = [slice(*span) for span in self.spans]
        shared = np.stack([self.waves[:, run] @ root.shared[run] for run in runs], axis=1)
        dots += self.vectors @ shared
        squares = np.einsum("ncr,ncr->nc", dots, dots)
        for i, (run, covariance) in enumerate(zip(runs, root.beside, strict=True)):
            products = self.waves[:, run] @ covariance
            products *= self.waves[:, run.start :]
            starts = [start - run.start for start, _ in self.spans[i:]]
            of_pairs = np.add.reduceat(products, starts, axis=1)
            both = self.vectors[:, :, i:] @ of_pairs[:, :, None]
            squares += self.vectors[:, :, i] * both[:, :, 0]
        return np.maximum(squares, 0.0, out=squares)


class Root:
    """A root (n_columns, r) of a covariance, arranged for `FactoredColumns.squares`.

    Any root gives the same squares, and a triangle takes half of the products. Where waves come in
    runs, the first columns of the triangle are those that the other columns of the model have:
    `own` and, of the waves, `shared`. What the waves have beside that is taken by its covariance:
    products of two waves are one number for each pose, not three. `beside` has a part for each run,
    its rows and the columns from its first on: what stands behind the run counts twice.
    """

    def __init__(self, half: np.ndarray, spans: list[Any]) -> None:
        m = len(half)
        n_waves = spans[-1][1] if spans else 0
        order = np.roll(np.arange(m), -n_waves)
        root = np.asarray(np.linalg.qr(half[order].T, mode="r")).T
        n_own = m - n_waves
        self.own: np.ndarray = np.ascontiguousarray(root[:n_own, :n_own])
        self.shared: np.ndarray = np.ascontiguousarray(root[n_own:, :n_own])
        alone = root[n_own:, n_own:]
        self.beside: list[np.ndarray] = []
        for start, end in spans:
            part = alone[start:end] @ alone[start:].T
            part[:, end - start :] *= 2.0
            self.beside.append(part)

    def product(self, rows: np.ndarray) -> np.ndarray:
        """``rows @ own``: of a triangle, half of the products are none."""
        if self.own.shape[0] != self.own.shape[1]:
            return rows @ self.own
        return np.asarray(dtrmm(1.0, self.own.T, rows.T)).T
