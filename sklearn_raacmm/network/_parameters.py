"""Checks of the network's parameters and data, and what its widths say of the features."""

import warnings

import numpy as np
from sklearn.exceptions import ConvergenceWarning

from sklearn_raacmm.network._width_objective import ALPHA_BOUNDS, WIDTH_BOUNDS
from sklearn_raacmm.utils import LARGEST, floats, show

# Squared distances are off by rounding of the largest: beyond 1e6 widths, by more than 1e-4.
_MAX_RANGE = 1e6
# The same in units of a feature's spread, where the width is to be found: off by 2e-3. From 1e7 on
# there were kernel matrices of simulated tables without a Cholesky factor.
_MAX_SPREADS = 3e6
# Beyond so many ranges a Gaussian differs from 1 by less than 1e-14.
_MAX_WIDTH = 1e7


def leading_bits(values):
    """Values to the 14 leading bits, four digits.

    An optimum that is flat is found to a few digits, the others are rounding of this or that BLAS;
    of two centres worth the same they would choose one here, the other there.
    """
    mantissa, exponent = np.frexp(values)
    return np.ldexp(np.round(mantissa * 2**14) / 2**14, exponent)


def check_length_scale(length_scale, n_features, n_outputs):
    """Widths of every feature, (d,) or of every output (q, d); None where they are to be found."""
    if isinstance(length_scale, str):
        return None
    width = floats("length_scale", length_scale)
    if width.shape not in ((), (n_features,), (n_outputs, n_features)):
        raise ValueError(
            f"length_scale has shape {width.shape}; it must be a number or have one entry for each "
            f"of the {n_features} features, or such a row for each of the {n_outputs} outputs."
        )
    if not np.all(width >= 1 / LARGEST):
        raise ValueError(
            f"length_scale must be positive, at least {1 / LARGEST:g}; got {show(length_scale)}."
        )
    return width if width.ndim == 2 else np.broadcast_to(width, n_features).copy()


def refuse_far(X, spread):
    """Refuse numbers so far from the others that the distances of these are lost in rounding."""
    low, high = X.min(axis=0), X.max(axis=0)
    found = np.flatnonzero((spread > 0) & (high - low > _MAX_SPREADS * spread))
    if len(found):
        i = found[0]
        raise ValueError(
            f"Feature {i} has numbers from {low[i]:g} to {high[i]:g}, but most lie within a "
            f"spread of {spread[i]:g}: beyond {_MAX_SPREADS:g} spreads distances between the "
            "other rows are lost in rounding. If these are codes of missing values, leave their "
            "rows out; else clip the feature or give its logarithm."
        )


def warn_of_bound(features):
    """Warn of widths that were found at their lower bound."""
    if len(features):
        warnings.warn(
            f"The width of feature {', '.join(map(str, features))} ended at its lower bound, "
            f"{WIDTH_BOUNDS[0]:g} of the feature's spread: the function may vary faster than the "
            "rows can show, or a few values lie far from all others.",
            ConvergenceWarning,
            stacklevel=11,  # through the decorators of `fit`, to the line of the call
        )


def warn_of_unlike(outputs):
    """Warn of outputs that need widths of their own, but have to share them."""
    if len(outputs):
        warnings.warn(
            f"Output {', '.join(map(str, outputs))} is taken for noise, because it varies at "
            "another length than the others, with which it shares the widths where n_centers is "
            'given, for "newrb" and for rows that are read in blocks. Fit one network for each '
            "output: MultiOutputRegressor(RBFNetRegressor()).",
            ConvergenceWarning,
            stacklevel=11,  # through the decorators of `fit`, to the line of the call
        )


def slopes(problem, posterior):
    """Squared slope of the modelled function along every feature, per spread."""
    unit = problem.X.std(axis=0)
    linear = np.square(posterior.polynomial[1:] * unit[:, None])
    # Outputs count alike, whatever their units.
    scale = problem.spread**2 + linear.sum(axis=0)
    radial = np.where(posterior.alpha < ALPHA_BOUNDS[1], posterior.signal_variance, 0.0)
    shares = (np.divide(a, scale, out=np.zeros_like(a), where=scale > 0) for a in (radial, linear))
    radial, linear = (share.sum(axis=-1) for share in shares)
    return radial * np.square(unit / posterior.length_scale) + linear


def relevance(squares):
    """Slopes, of which the squares are given, as a share of their sum."""
    slope = np.sqrt(squares)
    total = slope.sum()
    return slope / total if 0 < total < np.inf else np.zeros(len(slope))


def check_alpha(alpha, n_outputs):
    """Ridge of every output as an array; None where it is to be found."""
    if isinstance(alpha, str):
        return None
    ridge = floats("alpha", alpha)
    if ridge.ndim > 1 or (ridge.ndim == 1 and len(ridge) != n_outputs):
        raise ValueError(
            f"alpha has shape {ridge.shape}; it must be a number or have one entry for each of the "
            f"{n_outputs} outputs."
        )
    if not np.all((ridge >= 0) & np.isfinite(ridge)):
        raise ValueError(f"alpha must be finite and not negative; got {show(alpha)}.")
    return np.broadcast_to(ridge, n_outputs).copy()


def check_resolved(width, X, alpha):
    """Refuse given widths for which rounding of the distances changes the kernel."""
    if width is None or not len(X):
        return
    if width.ndim == 2:
        for row in width:
            check_resolved(row, X, alpha)
        return
    ranges = np.ptp(X, axis=0)
    i = int(np.argmax(ranges / width))
    if ranges[i] > _MAX_RANGE * width[i]:
        raise ValueError(
            f"length_scale is {width[i]:g} for feature {i}, whose range is {ranges[i]:g}: more "
            f"than {_MAX_RANGE:g} times as wide, which double precision does not resolve."
        )
    if not isinstance(alpha, str) and np.min(alpha) == 0 and 0 < ranges[i] * _MAX_WIDTH < width[i]:
        raise ValueError(
            f"length_scale is more than {_MAX_WIDTH:g} times the range of every feature: with "
            "alpha=0 double precision does not tell the radial functions from a constant."
        )
