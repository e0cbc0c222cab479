"""Score tests: which causes explain what is left of rows whose covariance is known."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Mapping

import numpy as np
from scipy.linalg import solve_triangular
from scipy.stats import chi2
from scipy.stats import f as fisher

# A direction of which nuisances leave less than this part of the cause itself cannot be told from
# them, and is not tested: a hundredth of it would be called metres. Less than the second part of
# the strongest direction is rounding, as is a nuisance that much smaller than the largest one.
_TAKEN_UP, _UNSEEN, _ROUNDING = 1e-2, 1e-8, 1e-10
# A cause that explains less than this share of what is too much leaves the most of it unexplained.
# Judged by ``benchmarks/bench_check.py``, which counts the causes that are named rightly.
_LEAST_SHARE = 0.3


class Whitened:
    """Rows divided by a root of their covariance, without what nuisances do to them.

    `root` (m, m) is the lower one, `nuisance` (m, k) are columns whose coefficients may be
    anything; `freedom` are the rows less the nuisances that they show.
    """

    def __init__(self, root: np.ndarray, nuisance: np.ndarray) -> None:
        self.root = root
        basis = self.scaled(nuisance)
        if basis.size:
            u, size, _ = np.linalg.svd(basis, full_matrices=False)
            basis = u[:, size > _ROUNDING * size.max()]
        self.basis = basis
        self.freedom: int = len(root) - basis.shape[1]

    def scaled(self, values: np.ndarray) -> np.ndarray:
        """Values divided by the root, the nuisances among them."""
        return solve_triangular(self.root, values, lower=True, check_finite=False)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Values divided by the root, less what the nuisances explain of them."""
        values = self.scaled(values)
        return values - self.basis @ (self.basis.T @ values)


def score_tests(
    causes: Mapping[str, np.ndarray],
    whiten: Whitened,
    residual: np.ndarray,
    known_from: float = np.inf,
) -> np.ndarray:
    """Test the size of all residuals (m,), and for each cause whether it is there.

    What of a cause, columns (m, k), is not taken up by the nuisances spans some directions. If the
    covariance is right, the squares of the residuals along these are a chi-squared variable (C. R.
    Rao, Proc. Camb. Phil. Soc. 44, 1948). Where its size was found from few independent errors,
    `known_from`, their mean is a variable of Fisher's distribution F.

    Returns a structured array of `cause`, `statistic`, `freedom` and `p_value`: of "noise", all
    residuals, first, then of each cause that the rows show.
    """
    left = whiten(residual)
    rows = [("noise", left @ left, whiten.freedom)]
    for name, columns in causes.items():
        alone = np.linalg.norm(whiten.scaled(columns))
        u, size, _ = np.linalg.svd(whiten(columns), full_matrices=False)
        # What the nuisances take up all of is rounding.
        seen = u[:, size > max(_TAKEN_UP * alone, _UNSEEN * size.max(initial=0.0))]
        if seen.shape[1]:
            rows.append((name, np.square(seen.T @ left).sum(), seen.shape[1]))
    dtype = [("cause", "U24"), ("statistic", "f8"), ("freedom", "i4"), ("p_value", "f8")]
    tests = np.array([(*row, 0.0) for row in rows], dtype=dtype)
    statistic, freedom = tests["statistic"], tests["freedom"]
    if np.isinf(known_from):
        tests["p_value"] = chi2.sf(statistic, freedom)
    else:
        tests["p_value"] = fisher.sf(statistic / freedom, freedom, known_from)
    return tests


def explained(columns: np.ndarray, whiten: Whitened, residual: np.ndarray) -> np.ndarray:
    """What a cause does to the rows beside the nuisances, by its most likely coefficients, (m,).

    What a nuisance does as well is no part of it: it may be of any size.
    """
    seen = whiten(columns)
    return whiten.root @ (seen @ np.linalg.lstsq(seen, whiten(residual), rcond=_UNSEEN)[0])


def best_cause(tests: np.ndarray) -> str:
    """The cause that explains most for its numbers (BIC), or "noise" if it leaves too much.

    The tests are those of `score_tests`. Where the best cause leaves residuals no better than
    before it is not the cause.
    """
    whole, causes = tests[0], tests[1:]
    if not len(causes):
        return "noise"
    worth = causes["statistic"] - causes["freedom"] * np.log(whole["freedom"])
    best = int(np.argmax(worth))
    too_much = whole["statistic"] - whole["freedom"]  # what the residuals exceed expectation by
    if worth[best] <= 0 or causes["statistic"][best] < _LEAST_SHARE * too_much:
        return "noise"
    return str(causes["cause"][best])
