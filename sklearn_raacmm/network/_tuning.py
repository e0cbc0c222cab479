"""Kernel, widths and ridge of some outputs, found where they are not given; and their network."""

import numpy as np
from sklearn.exceptions import ConvergenceWarning

from sklearn_raacmm.network._candidates import RadialFunctions
from sklearn_raacmm.network._fit import fit_network
from sklearn_raacmm.network._likelihood import Data
from sklearn_raacmm.network._objective import ALPHA_BOUNDS, WIDTH_BOUNDS
from sklearn_raacmm.network._read import refuse_far
from sklearn_raacmm.network._search import AUTO_KERNELS, robust_spread, search
from sklearn_raacmm.utils import warn_user


def leading_bits(values):
    """Values to the 14 leading bits, four digits.

    An optimum that is flat is found to a few digits, the others are rounding of this or that BLAS;
    of two centres worth the same they would choose one here, the other there.
    """
    mantissa, exponent = np.frexp(values)
    return np.ldexp(np.round(mantissa * 2**14) / 2**14, exponent)


def fit_outputs(estimator, problem, outputs, kernel, width, alpha, group_std, rng):
    """The network of some outputs (m,) of a problem, which share kernel, widths and centres.

    `width` (d,), `alpha` and `group_std` (m,) are given, in units of X, sample weights and y, or
    None; the kernel may be "auto". Returns the fit, the squared slope (d,) of the function along
    every feature per spread, and the log likelihood where structures were compared.
    """
    problem = problem.of_outputs(outputs)
    shift, n_centers = problem.X.mean(axis=0), estimator.n_centers
    found, value = None, None
    if width is None or alpha is None or problem.codes is not None:
        found, value = _searched(estimator, problem, kernel, width, alpha, group_std, rng)
        kernel, width = found.kernel, found.length_scale
        degree = 1 if found.linear else 0 if estimator.degree == "auto" else estimator.degree
        ridged = isinstance(estimator.alpha, str)
        if found.linear or found.ratio:
            problem = problem.with_tail(degree, ridged, found.ratio)
        alpha = found.alpha
    else:
        kernel, alpha = AUTO_KERNELS[0] if kernel == "auto" else kernel, alpha / problem.unit
    functions = RadialFunctions(kernel, shift, width)
    n_centers = None if n_centers == "auto" else n_centers
    n_found, limit = found.n_found if found else 0.0, estimator.max_centers
    fitted = fit_network(problem, outputs, functions, alpha, n_found, n_centers, limit, rng)
    return fitted, _slopes(problem, fitted.network), value


def _searched(estimator, problem, kernel, width, alpha, group_std, rng):
    """Structure of a problem, in units of its features and observations; and its likelihood."""
    sample = problem.sample
    view, rows = sample.view(), sample.block(slice(None))
    weights, m = np.square(sample.root[:, 0]), len(sample.spread)
    data = Data(sample.X, view.of(rows)[1] / sample.root, weights, view.within, sample.codes)
    if width is None:
        refuse_far(data.X, robust_spread(data.X, weights))
    kernels = (kernel,) if kernel != "auto" else AUTO_KERNELS
    open_all = estimator.degree == "auto" and width is None and alpha is None
    found = search(
        data,
        kernels[:1] if width is not None else kernels,  # given widths are those of one kernel
        length_scale=width,
        isotropic=isinstance(estimator.length_scale, str) and estimator.length_scale == "isotropic",
        alpha=None if alpha is None else alpha[view.outputs] / sample.unit,
        constant_std=None if group_std is None else group_std[view.outputs] / view.scale,
        may_be_linear=open_all,
        random_state=rng,
    )
    ridges = np.ones(m) if alpha is None else alpha / problem.unit
    if alpha is None:
        ridges[view.outputs] = leading_bits(found.alpha * sample.unit / problem.unit)
    if width is None:
        _warn_of_bound(found.at_bound)
        unit = sample.X.std(axis=0)
        unit[unit == 0] = 1.0
        width = unit * leading_bits(found.length_scale / unit)
    value = found.log_likelihood - found.n_observations * np.log(view.scale).sum()
    ratio = float(leading_bits(found.ratio))
    return found._replace(length_scale=width, alpha=ridges, ratio=ratio), float(value)


def _warn_of_bound(features):
    """Warn of widths that were found at their lower bound."""
    if len(features):
        warn_user(
            f"The width of feature {', '.join(map(str, features))} ended at its lower bound, "
            f"{WIDTH_BOUNDS[0]:g} of the feature's spread: the function may vary faster than the "
            "rows can show, or a few values lie far from all others.",
            ConvergenceWarning,
        )


def _slopes(problem, network):
    unit = problem.X.std(axis=0)
    linear = np.square(network.polynomial[1:] * unit[:, None])
    # Outputs count alike, whatever their units.
    scale = problem.spread**2 + linear.sum(axis=0)
    radial = np.where(network.alpha < ALPHA_BOUNDS[1], network.signal_variance, 0.0)
    shares = (np.divide(a, scale, out=np.zeros_like(a), where=scale > 0) for a in (radial, linear))
    radial, linear = (share.sum(axis=-1) for share in shares)
    return radial * np.square(unit / network.length_scale) + linear
