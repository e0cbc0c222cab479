"""What new rows show: coefficients that have changed, and causes that explain what is left.

Coefficients are conditioned on the rows, by as much as the evidence says they have changed. Score
tests say which causes explain what is left of rows whose covariance is known.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, cho_solve, cholesky, lapack, solve_triangular
from scipy.optimize import minimize
from scipy.stats import f as fisher

from sklearn_raacmm.correction._rows import TAKEN_UP
from sklearn_raacmm.utils import tukey_weights

# Prior of tau: its median, and the standard deviation of its logarithm. A tenth is what wears; a
# factor of 4.5 either way leaves room for nothing at all and for an exchanged joint. Chosen on two
# regions of series A of the UR10 with planted changes and on robots as those of
# ``benchmarks/bench_after_the_lab.py months``; its part series judges them on series B.
TAU, TAU_LOG_SD = 0.1, 1.5
# Bounds of log tau: a part changes by as much as its size at most. The standard deviation of the
# logarithm of the noise about that of the prior. Chosen as tau.
_LOG_TAU, NOISE_LOG_SD = (-7.0, 0.0), 1.0
# Where the search starts: the logarithm of the noise in units of the prior's. It needs 20 to 40 of
# its steps.
_FIRST_LOG_NOISE, _MOST_STEPS = 0.1, 100
# A gain of a thousandth of a nat, beside some thousands, ends the search: the taus of nine updates
# of a UR10 were within 5 % of those of SciPy's own limit, after a fifth fewer steps.
_SMALL_GAIN = 1e-6
# Weights are found anew until none moves by more than this. Most sets settle in the first round.
_ROUNDS, _SETTLED_WEIGHT = 4, 0.05
# A row that the fit follows freely says nothing when it is left out.
_LEAST_FREE = 1e-6
# A direction of a cause that is less than this part of the strongest one is rounding, as is a
# nuisance that much smaller than the largest one. That nuisances leave too little of is not tested.
UNSEEN, _ROUNDING = 1e-8, 1e-10


class Posterior:
    """Coefficients conditioned on new rows, which may show that some have changed.

    With A the `columns` (n, c, p) and B the `free` ones (n, c, q), each row of c coordinates,
    ``y - A coef = A d + B b + e``, ``d ~ N(0, half half' + tau^2 size^2)`` with one tau for each
    part, ``b ~ N(0, 1)`` and e of one variance over the weights. The `prior`, a linear model, has
    `coef`, `half` and `noise_variance`; the `changes` are the names (p,) of the parts and the sizes
    (p,). The taus and the variance, whose logarithm in units of the prior's has the bounds
    `log_noise`, have the highest marginal likelihood times log-normal priors (MacKay, Neural
    Comput. 4, 1992). Rows that stay far from this posterior are weighed down (Tukey's biweight),
    and it is found again: rows far from the prior alone show the change.

    What the rows are `shown` to say has `y` (n, c), `weights` (n,) and `rank` (n,), how many
    coordinates a row shows, the others being 0; `n_unknown` of all of them were used up before. The
    search begins at `start`, the `logs` of nearly the same rows, where there are some.

    Has `mean` (p + q,), of the columns, then of the free ones; `tau` by the name of the part;
    `noise_sd`; `row_weight` (n,), what the loss left of the weight of each row; and `logs` of the
    taus and the noise, where the search ended.
    """

    def __init__(self, prior, changes, shown, columns, free, log_noise, start=None):
        part, size = changes
        self.prior, self.weights, p = prior, shown.weights, len(prior.coef)
        self.every = np.concatenate([columns, free], axis=2)
        y, factor, self.logs = shown.y - columns @ prior.coef, np.ones(len(shown.y)), start
        for _ in range(_ROUNDS):
            known = self.weights * factor
            self.A, summed = weighted_rows(self.every, y, known)
            seen = self.A[:, :p] @ prior.half
            n_data = int(np.sum(shown.rank * (known > 0))) - shown.n_unknown
            fixed, variance = np.hstack([seen, self.A[:, p:]]), prior.noise_variance
            evidence = Evidence(changes, self.A, fixed, summed, variance, n_data, log_noise)
            self.logs = evidence.lowest(self.logs)
            self.tau = dict(zip(evidence.names, np.exp(self.logs[:-1]).tolist(), strict=True))
            self.noise_sd = float(np.exp(self.logs[-1]) * np.sqrt(variance))
            # Standard deviations of the changes and of the free coefficients.
            sd = np.array([self.tau.get(name, 0.0) for name in part.tolist()]) * size
            self.sd = np.r_[sd, np.ones(free.shape[2])]
            dual = evidence.solved(self.logs)[1]
            self.mean = np.square(self.sd) * (self.A.T @ dual)
            self.mean[:p] += prior.half @ (seen.T @ dual)
            # Few rows are followed closely: what is left of them is less than the noise.
            self.left = y - self.every @ self.mean
            self.row_weight = factor
            given = {"least_scale": self.noise_sd, "n_coordinates": shown.rank}
            factor = tukey_weights(self.left, self.weights, **given)
            if np.abs(factor - self.row_weight).max() < _SETTLED_WEIGHT:
                break
        self.mean[:p] += prior.coef

    @cached_property
    def half(self) -> np.ndarray:
        """Root (p + q, k) of the covariance of the coefficients."""
        p = len(self.prior.coef)
        before = thin(np.hstack([self.prior.half, np.diag(self.sd[:p])]))
        root = block_diag(before, np.diag(self.sd[p:]))
        return narrowed(root, self.A @ root / self.noise_sd)

    def left_out(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What each row of some weight would show if it had been left out, without another fit.

        Its errors, and the standard deviations of measurement and prediction, (n_used, c) each.

        Coordinates in which a row shows nothing have deviations of 0.

        With C the columns at one row times a root of the posterior's covariance, ``H = C C' / s^2``
        is the part of its own noise that the fit follows. Without this row it would be off by
        ``(I - H)^-1`` times what the fit leaves, of the covariance ``s^2 (I - H)^-1`` (Cook and
        Weisberg, Residuals and Influence in Regression, 1982).
        """
        weights = self.weights * self.row_weight
        kept = weights > 0
        left, spread = self.left[kept], self.every[kept] @ self.half
        variance = self.noise_sd**2 / weights[kept]
        own = spread @ spread.swapaxes(1, 2) / variance[:, None, None]
        free, axes = np.linalg.eigh(np.eye(left.shape[1]) - own)
        inverse = axes / np.maximum(free, _LEAST_FREE)[:, None] @ axes.swapaxes(1, 2)
        errors = np.einsum("nij,nj->ni", inverse, left)
        total = variance[:, None] * np.einsum("nii->ni", inverse)
        noise = np.where(np.any(spread != 0, axis=2), np.sqrt(variance)[:, None], 0.0)
        total = np.where(noise > 0, total, 0.0)
        return errors, noise, np.sqrt(np.maximum(total - noise**2, 0.0))


def narrowed(root: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Root (p, k) of a covariance after measurements that show `seen` (m, k) of it, over the noise.

    What is measured does not enter, only where. With the root F before, the rows S and ``I + S' S =
    L L'`` it is ``F L^-T``.
    """
    factor = cholesky(np.eye(seen.shape[1]) + seen.T @ seen, lower=True, check_finite=False)
    return solve_triangular(factor, root.T, lower=True, check_finite=False).T


def weighted_rows(
    columns: np.ndarray, y: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted rows of coordinates, no more than columns: of (n, c, p) and (n, c), (m, p) and (m,).

    What they have left is that of the rows that they sum up.
    """
    kept = weights > 0
    root = np.sqrt(weights[kept])[:, None]
    y = (y[kept] * root).ravel()
    A = (columns[kept] * root[:, :, None]).reshape(len(y), columns.shape[2])
    if len(y) > A.shape[1] + 1:
        R = np.asarray(np.linalg.qr(np.column_stack([A, y]), mode="r"))
        return R[:, :-1], R[:, -1]
    return A, y


class Evidence:
    """Negative log posterior of the logarithms t of the taus and, last, of the noise: no constants.

    The covariance C of the rows is a sum of matrices K, each times ``exp(2 t)``: one for each part
    of the `changes` of the columns A, the noise, and what does not change, whose root is `fixed`.
    With ``a = C^-1 y`` the slope along t is ``exp(2 t) (tr(C^-1 K) - a' K a)``, so that one inverse
    gives all (Rasmussen and Williams, 2006, eq. 5.9).
    """

    def __init__(self, changes, A, fixed, y, noise_variance, n_data, log_noise):
        part, size = changes
        self.y, self.names = y, sorted(set(part[size > 0].tolist()))
        m, n, A = len(y), len(self.names), A[:, : len(part)] * size
        roots = [A[:, part == name] for name in self.names]
        roots += [np.sqrt(noise_variance) * np.eye(m), fixed]
        self.sums = np.stack([H @ H.T for H in roots])
        # Coordinates that hold noise alone, which y has summed up, and its logarithm.
        self.n_rest, self.log_noise = n_data - m, 0.5 * np.log(noise_variance)
        self.middle = np.r_[np.full(n, np.log(TAU)), 0.0]
        self.sd = np.r_[np.full(n, TAU_LOG_SD), NOISE_LOG_SD]
        self.bounds = np.array([_LOG_TAU] * n + [log_noise])

    def __call__(self, logs):
        """Value and slopes."""
        factor, dual = self.solved(logs)
        z = (logs - self.middle) / self.sd
        value = np.log(np.diag(factor)).sum() + self.n_rest * (logs[-1] + self.log_noise)
        value += 0.5 * (self.y @ dual + z @ z)
        inverse = lapack.dpotri(factor, lower=1, overwrite_c=1)[0]
        inverse += np.tril(inverse, -1).T
        inverse -= np.outer(dual, dual)
        slopes = np.exp(2 * logs) * np.tensordot(self.sums[:-1], inverse, 2) + z / self.sd
        slopes[-1] += self.n_rest
        return value, slopes

    def solved(self, logs):
        """Lower root of the covariance, and its inverse times y."""
        covariance = np.tensordot(np.append(np.exp(2 * logs), 1.0), self.sums, 1)
        # The transpose is the same matrix in the order that LAPACK has.
        factor = cholesky(covariance.T, lower=True, overwrite_a=True, check_finite=False)
        return factor, cho_solve((factor, True), self.y, check_finite=False)

    def lowest(self, start=None):
        """Where it is lowest, from a start or from the middle of the priors.

        The search goes in units of the curvature at its start: the mean of what is observed and
        expected, ``2 exp(4 t) (K a)' C^-1 (K a)`` (Gilmour, Thompson and Cullis, Biometrics 51,
        1995).
        """
        if start is None:
            start = self.middle + np.eye(len(self.middle))[-1] * _FIRST_LOG_NOISE
        factor, dual = self.solved(start)
        pulls = np.exp(2 * start) * (self.sums[:-1] @ dual).T
        seen = solve_triangular(factor, pulls, lower=True, check_finite=False)
        unit = 1 / np.sqrt(2 * np.square(seen).sum(axis=0) + 1 / self.sd**2)

        def in_units(x):
            value, slopes = self(x * unit)
            return value, slopes * unit

        found = minimize(
            in_units, start / unit, jac=True, method="L-BFGS-B",
            bounds=self.bounds / unit[:, None],
            options={"maxiter": _MOST_STEPS, "ftol": _SMALL_GAIN},
        )  # fmt: skip
        return found.x * unit


def thin(root: np.ndarray) -> np.ndarray:
    """Root of the same covariance with no more columns than rows."""
    return np.asarray(np.linalg.qr(root.T, mode="r")).T if root.shape[1] > len(root) else root


class ModelWhitening:
    """Rows over a root of their covariance, without what nuisances do to them.

    The covariance is ``I + G G'`` of the columns G, `known` (m, r), in a space of `n_rows`
    dimensions, m or those that unknowns have left of m; `nuisance` (m, k) are columns whose
    coefficients may be anything; `freedom` are the dimensions less the nuisances that they show.
    """

    def __init__(self, known: np.ndarray, nuisance: np.ndarray, n_rows: int) -> None:
        self.axes, size, _ = np.linalg.svd(thin(known), full_matrices=False)
        self.less = 1 - 1 / np.sqrt(1 + np.square(size))
        self.log_root: float = 0.5 * float(np.log1p(np.square(size)).sum())
        basis = self.scaled(nuisance)
        if basis.size:
            u, size, _ = np.linalg.svd(basis, full_matrices=False)
            basis = u[:, size > _ROUNDING * size.max()]
        self.basis = basis
        self.freedom: int = n_rows - basis.shape[1]

    def scaled(self, values: np.ndarray) -> np.ndarray:
        """Values over the root of the covariance, the nuisances among them."""
        along = self.axes.T @ values
        return values - self.axes @ (self.less * along.T).T

    def as_known(self, values: np.ndarray) -> np.ndarray:
        """Independent normal values (m, k) with the covariance G G', the same by any such G."""
        size = np.sqrt((1 - self.less) ** -2 - 1)
        return self.axes @ (size * (self.axes.T @ values).T).T

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Values over the root, less what the nuisances explain of them."""
        values = self.scaled(values)
        return values - self.basis @ (self.basis.T @ values)


def score_tests(
    causes: Mapping[str, np.ndarray],
    whiten: ModelWhitening,
    residual: np.ndarray,
    known_from: Sequence[tuple[float, float]],
) -> np.ndarray:
    """Test the size of all residuals (m,), and for each cause whether it is there.

    What of a cause, columns (m, k), is not taken up by the nuisances spans some directions. If the
    covariance is right, the squares of the residuals along these are a chi-squared variable (C. R.
    Rao, Proc. Camb. Phil. Soc. 44, 1948). As its size was found from few independent errors,
    their mean is a variable of Fisher's distribution F. `known_from` holds how many these
    were and a factor of the variance: for the size of all, then for the causes.

    Returns a structured array of `cause`, `statistic`, `freedom` and `p_value`: of "noise", all
    residuals, first, then of each cause that the rows show.
    """
    left = whiten(residual)
    rows = [("noise", left @ left, whiten.freedom)]
    for name, columns in causes.items():
        alone = np.linalg.norm(whiten.scaled(columns))
        u, size, _ = np.linalg.svd(whiten(columns), full_matrices=False)
        # What the nuisances take up all of is rounding.
        seen = u[:, size > max(TAKEN_UP * alone, UNSEEN * size.max(initial=0.0))]
        if seen.shape[1]:
            rows.append((name, np.square(seen.T @ left).sum(), seen.shape[1]))
    dtype = [("cause", "U24"), ("statistic", "f8"), ("freedom", "i4"), ("p_value", "f8")]
    tests = np.array([(*row, 0.0) for row in rows], dtype=dtype)
    freedom = tests["freedom"]
    known, factor = np.repeat(known_from, [1, len(rows) - 1], axis=0).T
    tests["p_value"] = fisher.sf(tests["statistic"] / freedom / factor, freedom, known)
    return tests
