"""What chosen columns leave of the harmonics that may join them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular
from scipy.linalg.blas import dtrsm

from sklearn_raacmm.error_model._order_scan import columns_of

# Shares of its diagonal that are added to a matrix, one after another, until it has a factor.
_RIDGES = (1e-14, 1e-13, 1e-12, 1e-11, 1e-10, 1e-9, 1e-8)


def root_of(matrix, lower=False):
    """Cholesky factor; where rounding has eaten what the priors add, of slightly more."""
    diagonal = np.diag_indices(len(matrix))
    for more in _RIDGES:
        try:
            return cholesky(matrix, lower=lower, check_finite=False)
        except LinAlgError:
            matrix = matrix.copy()
            matrix[diagonal] *= 1 + more
    return cholesky(matrix, lower=lower, check_finite=False)


def _root_of_parts(S, m):
    """Upper Cholesky factor of S, whose first m columns may hold rounding, but not the others."""
    root = np.zeros(S.shape, order="F")
    root[:m, :m] = first = root_of(S[:m, :m]) if m else S[:m, :m]
    beside = solve_triangular(first, S[:m, m:], trans="T", check_finite=False) if m else S[:m, m:]
    left = S[m:, m:] - beside.T @ beside
    root[:m, m:] = beside
    if len(left):
        root[m:, m:] = cholesky(0.5 * (left + left.T), check_finite=False)
    return root


class Leftover:
    """What the chosen columns leave of the candidates, at given variances.

    Arrays over candidates hold those that are not chosen at the beginning, `free`: of others
    nothing is left, and nothing is asked.
    """

    def __init__(self, problem, pairs, smooth, share, variance, noise):
        sums, lengths = problem.sums, problem.lengths
        self.problem, self.noise = problem, noise
        self.prior = variance[problem.harmonic]
        self.free = np.setdiff1d(np.arange(sums.own.shape[1]), pairs)
        self.columns, chosen = columns_of(self.free), columns_of(pairs)
        self.r = sums.candidate_moment[self.columns] / noise
        self.own = sums.own[:, self.free] / noise + np.array([[1.0], [1.0], [0.0]]) / self.prior
        self.lengths = None
        m = len(sums.gram)
        self.size = m + len(chosen)
        self.factor = np.empty((self.size + 64, len(self.columns)))
        self.factor[:m] = sums.cross[:, self.columns]
        self.factor[m : self.size] = sums.rows(pairs, beside=self.free)
        S = np.zeros((self.size, self.size))  # of which one triangle is used
        S[:m, :m], S[:m, m:] = sums.gram, sums.cross[:, chosen]
        S[m:, m:] = sums.rows(pairs, beside=pairs)
        S /= noise
        r = np.concatenate([sums.moment, sums.candidate_moment[chosen]]) / noise
        if lengths is not None:
            r += self._add_lengths(lengths, sums.cross.shape[1], chosen, S)
        prior = share * np.where(smooth, variance[-1], self.prior)
        S[np.diag_indices(self.size)] += 1 / np.r_[variance[problem.family], np.repeat(prior, 2)]
        if self.size and len(self.columns):
            root = _root_of_parts(S, m)
            # The transpose is in Fortran order: the factor is solved for in place.
            dtrsm(1 / noise, root, self.factor[: self.size].T, side=1, overwrite_b=1)
            self._explain(self.factor[: self.size], solve_triangular(root, r, trans="T"))

    def _add_lengths(self, lengths, n_waves, chosen, S):
        """Add what the known lengths say of all columns; of the chosen ones, their products."""
        scale = 1 / np.sqrt(lengths.variance + self.noise * lengths.share)
        rows, errors = lengths.rows * scale[:, None], lengths.errors * scale
        known = rows[:, np.r_[n_waves : rows.shape[1], chosen]]
        self.lengths = rows[:, self.columns]
        S += known.T @ known
        self.factor[: self.size] += self.noise * (known.T @ self.lengths)
        cos, sin = self.lengths[:, ::2], self.lengths[:, 1::2]
        self.own += [(a * b).sum(axis=0) for a, b in ((cos, cos), (sin, sin), (cos, sin))]
        self.r += self.lengths.T @ errors
        return known.T @ errors

    def _explain(self, rows, solved):
        """Take off what rows of the factor explain; `solved` are their products with y."""
        cos, sin = rows[:, ::2], rows[:, 1::2]
        squares = np.einsum("kc,kc->c", rows, rows)
        self.own -= [squares[::2], squares[1::2], np.einsum("kc,kc->c", cos, sin)]
        self.r -= solved @ rows

    def take(self, candidate, likely):
        """Choose a candidate; LinAlgError if only rounding is left of it."""
        columns = columns_of([candidate])
        pairs, others = self.free[[candidate]], self.free[np.asarray(likely, dtype=int)]
        rows = self.problem.sums.rows(pairs, others.tolist(), self.free) / self.noise
        if self.lengths is not None:
            rows += self.lengths[:, columns].T @ self.lengths
        known = self.factor[: self.size]
        rows -= known[:, columns].T @ known
        block = rows[:, columns]
        root = cholesky(0.5 * (block + block.T) + np.eye(2) / self.prior, check_finite=False)
        solved = solve_triangular(root, self.r[columns], trans="T", check_finite=False)
        rows = solve_triangular(root, rows, trans="T", check_finite=False)
        if self.size + 2 > len(self.factor):
            self.factor = np.concatenate([self.factor, np.empty_like(self.factor)])
        self.factor[self.size : self.size + 2] = rows
        self.size += 2
        self._explain(rows, solved)

    def gains(self):
        """Rise of the log evidence by each free candidate, and whether it can be trusted."""
        (a, d, o), x, z = self.own, self.r[::2], self.r[1::2]
        determinant = a * d - o * o
        volume = determinant * self.prior**2
        # A posterior wider than the prior is rounding.
        sound = volume >= 1 - 1e-6
        safe = np.where(sound, determinant, 1.0)
        gain = 0.5 * (x * x * d - 2 * x * z * o + z * z * a) / safe
        return gain - 0.5 * np.log(np.where(sound, np.maximum(volume, 1.0), 1.0)), sound
