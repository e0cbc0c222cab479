r"""Features that span powers of ten, seen through a power of them where the data say so.

A feature x of positive numbers, most of which are small beside the largest, is seen as

.. math:: m\, \Bigl(1 + \frac{(x / m)^\lambda - 1}{\lambda}\Bigr)

with m the median of its values, so that no unit of the user's matters (Box and Cox [1]_); where
some values are 0, by :math:`1 + x / m` in place of :math:`x / m`, and less the m in front (Yeo and
Johnson [2]_). The exponent is the one that makes it most like a normal variable; 0 stands for the
logarithm, and 1 is the feature itself. Whether the network sees its features so, or as they are, is
decided by the likelihood, and by what is left of rows that are left out.

References
----------
.. [1] G. E. P. Box, D. R. Cox, "An analysis of transformations", Journal of the Royal Statistical
   Society B 26(2), 1964, 211-252.
.. [2] I.-K. Yeo, R. A. Johnson, "A new family of power transformations to improve normality or
   symmetry", Biometrika 87(4), 2000, 954-959.
"""

import warnings
from dataclasses import dataclass, fields

import numpy as np
from scipy.linalg import LinAlgError
from scipy.optimize import minimize_scalar
from scipy.special import boxcox, boxcox1p, inv_boxcox, inv_boxcox1p

from sklearn_raacmm.network._kernels import KERNELS, squared_distances
from sklearn_raacmm.network._likelihood import Data, leave_one_out, left_out, weigh
from sklearn_raacmm.network._polynomial_tail import (
    linear_columns,
    linear_left_out,
    linear_process,
)
from sklearn_raacmm.network._width_search import EXACT_ROWS
from sklearn_raacmm.utils import LARGEST, check_shapes

# Quantiles of a feature, and the least ratio of their distances for it to be looked at: 1 of a
# uniform feature, 1.7 of a normal one's exponential with a deviation of 0.33, 3.6 of an exponential
# one.
QUANTILES, LOPSIDED = (0.05, 0.5, 0.95), np.sqrt(3.0)
# Exponents that are looked for, and the digits that they are rounded to.
EXPONENTS, DIGITS = (0.0, 1.0), 2
# Squared correlation of a feature with its power above which they are the same.
STRAIGHT = 0.98
# So far below the smallest value, as a share of it, a power goes on as it is; from there on along
# its tangent, which 0 and negative numbers are on, too.
BELOW = 0.5
# Nats by which powers have to be more probable, as much as another kernel has to; besides, they
# have to predict rows that are left out better. On 460 folds of 115 tables this choice left 0.90 of
# the error (geometric mean of tables); with a margin of 5 one table more lost a fifth. Of eight
# folds in which the likelihood alone would have chosen powers and the rows left out said no, four
# would have lost, 5 to 276 % of the error, and three gained.
POWER_MARGIN = 10.0


@dataclass(frozen=True, eq=False)
class FeaturePowers:
    """How a network sees its features.

    Attributes
    ----------
    lambdas : ndarray of shape (d,)
        Exponents; 1 for a feature that is seen as it is.

    unit : ndarray of shape (d,)
        Unit in which it has the exponent.

    start : ndarray of shape (d,)
        What is added to it in this unit, 0 or 1.

    low : ndarray of shape (d,)
        Value below which the power goes on along its tangent.
    """

    lambdas: np.ndarray
    unit: np.ndarray
    start: np.ndarray
    low: np.ndarray

    @classmethod
    def none(cls, n_features):
        """Of features that are seen as they are."""
        return cls(*(np.full(n_features, value) for value in (1.0, 1.0, 0.0, -np.inf)))

    def __setstate__(self, state):
        vars(self).update(state)
        shapes = {field.name: ("d",) for field in fields(self)}
        check_shapes(type(self).__name__, state, shapes, {}, ("low",))

    @property
    def changed(self):
        """Features that are not seen as they are."""
        return np.flatnonzero(self.lambdas != 1.0)

    def transform(self, X):
        """Rows as the network sees them, (n, d)."""
        return self._with_slopes(X)[0] if len(self.changed) else X

    def slopes(self, X):
        """Derivative of every feature that is seen by the feature itself, (n, d)."""
        return self._with_slopes(X)[1]

    def _with_slopes(self, X):
        Z, slopes = X.copy(), np.ones_like(X)
        for j in self.changed:
            x = X[:, j]
            at = np.maximum(x, self.low[j])
            value, slope = power(at, self.lambdas[j], self.unit[j], self.start[j])
            Z[:, j], slopes[:, j] = value + slope * (x - at), slope
        return Z, slopes

    def inverse(self, Z):
        """Training rows that the network sees so, (n, d)."""
        X = Z.copy()
        for j in self.changed:
            u, exponent = Z[:, j] / self.unit[j], self.lambdas[j]
            u = inv_boxcox1p(u, exponent) if self.start[j] else inv_boxcox(u - 1, exponent)
            X[:, j] = self.unit[j] * u
        return X


def power(x, exponent, unit, start):
    """Power of one feature, and its derivative.

    Parameters
    ----------
    x : ndarray of shape (n,)
        With ``x / unit + start`` positive.
    exponent, unit : float
    start : {0, 1}

    Returns
    -------
    value, slope : ndarray of shape (n,)
    """
    u = x / unit
    value = boxcox1p(u, exponent) if start else boxcox(u, exponent) + 1
    return unit * value, (u + start) ** (exponent - 1)


def likely_powers(estimator, problem):
    """Powers that make features that span much most like normal variables.

    Likelihoods can be compared where the targets are the same, so not if the polynomial has a
    linear part.

    Parameters
    ----------
    estimator : RBFNetRegressor
    problem : Problem or ChunkedProblem

    Returns
    -------
    FeaturePowers or None
        None where there is no such feature, or the estimator is not to look for it.
    """
    searched = isinstance(estimator.length_scale, str) and estimator.selection == "ols"
    wanted = estimator.power_transform is not None and searched and estimator.degree != 1
    if not wanted or problem.sample is not problem or not len(problem.X):
        return None
    weights = np.square(problem.root[:, 0])
    found = FeaturePowers.none(problem.X.shape[1])
    for j, x in enumerate(problem.X.T):
        if x.min() < 0 or not is_lopsided(x, weights):
            continue
        some, start = x > 0, float(x.min() == 0)
        unit = np.quantile(x[some], 0.5, weights=weights[some], method="inverted_cdf")
        exponent = likely_exponent(x / unit, weights, start)
        low = 0.0 if start else BELOW * x.min()
        value, slope = power(np.append(x, low), exponent, unit, start)
        bent = exponent < 1 and _squared_correlation(x, value[:-1], weights) < STRAIGHT
        if bent and np.abs(value).max() < LARGEST and slope.max() < LARGEST:
            found.lambdas[j], found.unit[j] = exponent, unit
            found.start[j], found.low[j] = start, low
    return found if len(found.changed) else None


def is_lopsided(x, weights):
    """Whether a feature's values reach much farther above the middle one than below."""
    low, middle, high = _quantiles(x, weights)
    # Of a value that many rows share, such as a count of 0, the others say how they are spread.
    while low == middle < high:
        kept = x > low
        x, weights = x[kept], weights[kept]
        low, middle, high = _quantiles(x, weights)
    return low < middle and high - middle > LOPSIDED * (middle - low)


def _quantiles(x, weights):
    return np.quantile(x, QUANTILES, weights=weights, method="inverted_cdf")


def likely_exponent(u, weights, start):
    """The exponent of the largest likelihood, were the power a normal variable."""
    weights = weights / weights.sum()
    stretch = weights @ np.log(u + start)

    def cost(exponent):
        with np.errstate(over="ignore", invalid="ignore"):
            value = power(u, exponent, 1.0, start)[0]
            variance = weights @ np.square(value - weights @ value)
        return 0.5 * np.log(variance) - (exponent - 1) * stretch if variance > 0 else np.inf

    found = minimize_scalar(cost, bounds=EXPONENTS, method="bounded", options={"xatol": 1e-4})
    return round(float(found.x), DIGITS)


def _squared_correlation(x, z, weights):
    x, z = ((v - np.average(v, weights=weights)) / np.ptp(v) for v in (x, z))
    return (weights @ (x * z)) ** 2 / ((weights @ (x * x)) * (weights @ (z * z)))


def tune_powers(estimator, problem, find, rng, last=None, refit=False):
    """Kernel, widths and ridges of features as they are, or through powers if that is better.

    Parameters
    ----------
    estimator : RBFNetRegressor
        Maybe with powers of its last fit.
    problem : Problem or ChunkedProblem
    find : callable
        ``find(problem, last=last)`` gives groups of outputs, as `tuned_groups` does.
    rng : numpy.random.RandomState
        Of `find`, which is to draw the same rows twice.
    last : Posterior or GroupedPosterior, optional
        Of the last fit, for a warm start.
    refit : bool
        Whether it is a fit to the same rows with other weights, so that powers that were found are
        kept. Where none were, outliers may have hidden them.

    Returns
    -------
    groups : list of Group
        Their problems are as the network sees them.
    powers : FeaturePowers
    """
    as_is = before = FeaturePowers.none(problem.X.shape[1])
    if refit or last is not None:
        before = estimator.powers_
    likely = likely_powers(estimator, problem) if problem.codes is None else None
    if len(before.changed):
        if refit or likely is not None:
            groups = find(problem._replace(X=before.transform(problem.X)), last=last)
            if refit or _are_kept(groups):
                return groups, before
        last = None  # it has seen the features otherwise
    if likely is None:
        return find(problem, last=last), as_is
    state = rng.get_state()
    plain, said = _noting(find, problem, last)
    found, after = (plain, as_is), rng.get_state()
    if not _are_kept(plain):
        rng.set_state(state)
        try:
            seen = problem._replace(X=likely.transform(problem.X))
            groups, warned = _noting(find, seen, None)
            lead = log_likelihood_of(groups) - log_likelihood_of(plain)
            if lead > POWER_MARGIN and _left_out(groups) < _left_out(plain):
                found, after, said = (groups, likely), rng.get_state(), warned
        except LinAlgError:  # features of which no kernel can be made are no candidate
            pass
    rng.set_state(after)
    for warning in said:
        warnings.warn(warning.message, stacklevel=7)  # through the decorators, to the line of `fit`
    return found


def log_likelihood_of(groups):
    """Logarithm of the likelihood of all groups of outputs; None where nothing was searched for."""
    values = [group.tuned.log_likelihood for group in groups]
    return None if None in values else sum(values)


def _left_out(groups):
    """Sum of squares of rows left out one at a time, in the targets' variances."""
    return sum(left_out_error(group.problem, group.tuned) for group in groups)


def left_out_error(problem, tuned):
    """The same of outputs that share kernel and widths.

    Of all rows, or of as many as kernels are compared on.
    """
    view, block = problem.view(), problem.block(slice(None))
    weights = np.square(problem.root[:, 0])
    X = problem.X - np.average(problem.X, axis=0, weights=weights)
    data = Data(X, view.of(block)[1] / problem.root, weights, view.within)
    data = data.rows(data.draw(EXACT_ROWS, np.random.RandomState(0)))
    if tuned.linear and not tuned.tail_ridge:
        return linear_left_out(data, linear_process(data).ridge).squared_error
    kernel, _, width = tuned.functions
    alpha = tuned.alpha[view.outputs]
    if not tuned.linear:
        return leave_one_out(data, kernel, np.log(width), np.log(alpha)).squared_error
    # An average of models: radial functions beside a linear part, in units of the noise.
    Z, columns = data.X / width, linear_columns(data)
    K = KERNELS[kernel].function(squared_distances(Z, Z)) / alpha
    weigh(K, np.sqrt(data.weights))
    K += columns @ columns.T / tuned.tail_ridge
    return left_out(data, K, np.ones(1)).squared_error


def _are_kept(groups):
    """Whether all is from the last fit."""
    return all(group.tuned.kept for group in groups)


def _noting(find, problem, last):
    """What is found, and its warnings: those of the search that loses are not passed on."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        return find(problem, last=last), said
