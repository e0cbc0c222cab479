"""Kernel, widths and ridge of some outputs, found where they are not given; and their network."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from sklearn.exceptions import ConvergenceWarning

from sklearn_raacmm.network._blocks import extend
from sklearn_raacmm.network._fit import fit_network
from sklearn_raacmm.network._likelihood import Data
from sklearn_raacmm.network._objective import ALPHA_BOUNDS, WIDTH_BOUNDS
from sklearn_raacmm.network._read import refuse_far
from sklearn_raacmm.network._rows import prepare
from sklearn_raacmm.network._search import AUTO_KERNELS, Structure, robust_spread, search
from sklearn_raacmm.utils import warn_user


def fit_outputs(estimator, rows, elsewhere, outputs, kernel, width, alpha, group_std, rng):
    """The network of some outputs (m,), which share kernel, widths and centres.

    `rows` are distinct rows with all targets, `elsewhere` the chunks, the number and the weight of
    all rows, of which these are a sample, or None. `width` (d,), `alpha` and `group_std` (m,) are
    given, in units of X, sample weights and y, or None; the kernel may be "auto". Returns what
    `fit_network` does, the squared slope (d,) of the function along every feature per spread, and
    the log likelihood where structures were compared, or None.
    """
    ridged, value = isinstance(estimator.alpha, str), None

    def set_up(degree, ratio=0.0):
        sample = prepare(rows.of_outputs(outputs), degree, ridged, ratio)
        if elsewhere is None:
            return sample, sample
        chunks, n_rows, weight = elsewhere
        return sample, extend(sample, chunks, n_rows, weight, outputs)

    # A linear part that the data have to ask for is added once they have.
    degree = 0 if estimator.degree == "auto" else estimator.degree
    sample, problem = set_up(degree)
    if width is None or alpha is None or rows.codes is not None:
        found = _search(estimator, sample, kernel, width, alpha, group_std, rng)
        if alpha is None:
            of = problem.varying
            alpha = np.ones(len(outputs))
            alpha[of] = found.alpha[np.isin(sample.varying, of)] * sample.unit / problem.unit
        else:
            alpha = alpha / problem.unit
        width = found.length_scale if width is None else width
        scale = np.log(sample.spread[sample.varying]).sum()
        value = float(found.log_likelihood - found.n_observations * scale)
        found = found._replace(length_scale=width, alpha=alpha)
        if found.linear or found.ratio:
            sample, problem = set_up(1 if found.linear else degree, found.ratio)
    else:
        kernel = AUTO_KERNELS[0] if kernel == "auto" else kernel
        found = Structure(kernel, width, alpha / problem.unit)
    limits = estimator.n_centers, estimator.max_centers
    fitted = fit_network(problem, outputs, found, *limits, rng)
    return fitted, _slopes(problem, fitted[0]), value


def _search(estimator, sample, kernel, width, alpha, group_std, rng):
    """Structure by a problem in memory, in units of its observations."""
    weights, spread = np.square(sample.root[:, 0]), sample.spread[sample.varying]
    Y = sample.about_tail / sample.root
    data = Data(sample.rows.X, Y, weights, sample.left_within, sample.rows.codes)
    if width is None:
        refuse_far(data.X, robust_spread(data.X, weights))
    kernels = (kernel,) if kernel != "auto" else AUTO_KERNELS
    found = search(
        data,
        kernels[:1] if width is not None else kernels,  # given widths are those of one kernel
        length_scale=width,
        isotropic=isinstance(estimator.length_scale, str) and estimator.length_scale == "isotropic",
        alpha=None if alpha is None else alpha[sample.varying] / sample.unit,
        constant_std=None if group_std is None else group_std[sample.varying] / spread,
        may_be_linear=estimator.degree == "auto" and width is None and alpha is None,
        random_state=rng,
    )
    if width is None and len(found.at_bound):
        warn_user(
            f"The width of feature {', '.join(map(str, found.at_bound))} ended at its lower bound, "
            f"{WIDTH_BOUNDS[0]:g} of the feature's spread: the function may vary faster than the "
            "rows can show, or a few values lie far from all others.",
            ConvergenceWarning,
        )
    return found


def _slopes(problem, network):
    unit = problem.rows.X.std(axis=0)
    linear = np.square(network.polynomial[1:] * unit[:, None])
    # Outputs count alike, whatever their units.
    scale = problem.spread**2 + linear.sum(axis=0)
    radial = np.where(network.alpha < ALPHA_BOUNDS[1], network.signal_variance, 0.0)
    shares = (np.divide(a, scale, out=np.zeros_like(a), where=scale > 0) for a in (radial, linear))
    radial, linear = (share.sum(axis=-1) for share in shares)
    return radial * np.square(unit / network.length_scale) + linear
