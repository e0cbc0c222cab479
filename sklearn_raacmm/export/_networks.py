"""Networks of radial functions as operations of a program: prediction and variance."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.network import by_feature, radial

# Centres of a network up to which its standard deviation is written: a table of 4 million numbers.
MOST_CENTERS = 2000
# Variance of the noise over that of the signal from which on one matrix does for two: at 1e-6 it
# was good to 1e-6 of a standard deviation, at 1e-11 to nothing: tests/export/test_c_network.py
# tries both sides.
_CLEAR = 1e-6


def network(p, step, x, std):
    """Prediction and variance (or None) of an `RBFNetRegressor`."""
    found = [_one_network(p, part, x, std) for part in step.networks_]
    if len(found) == 1:
        return found[0]
    place = np.argsort(np.concatenate([part.outputs for part in step.networks_]))
    y = p("join", *(y for y, _ in found))[place]
    return y, p("join", *(v for _, v in found))[place] if std else None


def _one_network(p, net, x, std):
    """Prediction and variance (or None) of outputs that share centres."""
    phi, constant, linear = None, net.polynomial[0], net.polynomial[1:].T
    y = p.constant(constant) + 0.0
    y = x.affine(linear, constant) if np.any(linear) else y
    if len(net.centers):
        # Centred as predict does it: the rounding is the same.
        centers = net.seen(net.centers)
        shift = centers.mean(axis=0)
        squares = p(
            "distances", _seen(p, net, x), shift=shift, inverse_width=1 / net.length_scale,
            centers=(centers - shift) / net.length_scale,
        )  # fmt: skip
        phi = radial(net.kernel, squares)
        y = y + phi.affine(net.coef.T) if np.any(linear) else phi.affine(net.coef.T, constant)
    if not std:
        return y, None
    variance = _network_variance(p, net, x, phi)
    if np.any(net.of_outliers()):
        variance = variance + p.constant(net.of_outliers())
    return y, variance


def _seen(p, net, x):
    """The features, or their ranks: ramps from one training value to the next, and beyond them."""
    if net.ranks is None:
        return x
    found = []
    for number, (values, ranks, below, above) in enumerate(by_feature(net.ranks)):
        steps = np.append(np.diff(ranks), [above, -below])
        if not np.any(steps):
            found.append(p.constant(ranks[0]))
            continue
        ramp = (x[np.full(len(values) - 1, number)] - values[:-1]) / np.diff(values)
        ramp = 1.0 - np.maximum(1.0 - np.maximum(ramp, 0.0), 0.0)
        own = x[number]
        outside = (np.maximum(beyond, 0.0) for beyond in (own - values[-1], values[0] - own))
        found.append(p("join", ramp, *outside).affine(steps[None], ranks[:1]))
    return p("join", *found)


def _network_variance(p, net, x, phi):
    """Variances of a network's outputs, as `Network` has them, by the same two matrices.

    The first of them has rows of very different sizes where data have little noise. It must not be
    multiplied by another then: what is left of the prior's variance is small beside it, and 8 of
    its digits would be lost.
    """
    k, parts = len(net.centers), []
    if k > MOST_CENTERS:
        raise ValueError(
            f"The standard deviation of a network of {k} centres would need a table of "
            f"{k * k / 1e6:.0f} million numbers. Export without it, or fit the network with "
            f"max_centers={MOST_CENTERS}."
        )
    if k and np.all(net.noise_variance > _CLEAR * net.signal_variance):
        return _variance_by_one_matrix(p, net, x, phi)
    columns = [phi] if k else []
    if len(net.tail_map):
        slopes, constant = net.tail_map[:, 1:], net.tail_map[:, 0]
        columns.insert(0, x.affine(slopes, constant) if np.any(slopes) else p.constant(constant))
    for output in range(len(net.outputs)):
        of_prior, of_weights = net.roots(output)
        variance = p.constant(1.0)
        if len(of_weights):
            # From the last row to the first, so that each column ends where its zeros begin.
            seen = p("join", *columns).affine(of_weights[::-1])
            variance = seen.dots(seen) + variance
        variance = variance * net.noise_variance[output]
        outside = p.constant(1.0)
        if k:
            seen = phi.affine(of_prior)
            outside = np.maximum(1.0 - seen.dots(seen), 0.0)
        parts.append(outside * net.signal_variance[output] + variance)
    return p("join", *parts)


def _variance_by_one_matrix(p, net, x, phi):
    r"""The same of data with noise, in a half or a third of the time.

    With g the radial functions in coordinates in which prior and data are diagonal, 1 and s_i, and
    t the polynomial's terms, the variance of an output is, given the weights first, then the
    polynomial, ``signal (1 - sum(g^2)) + noise (sum(g^2 / (s + alpha)) + |R (t - J g)|^2)``. The
    two sums are one.
    """
    noise, signal, size = net.noise_variance, net.signal_variance, len(net.tail_map)
    rows, whiten = net.design_triangle(), net.prior_root
    T, D = rows[:, :size], rows[:, size:] @ whiten.T
    _, singular, turn = np.linalg.svd(D)
    spectrum = np.zeros(len(turn))
    spectrum[: len(singular)] = np.square(singular)
    known = np.maximum(spectrum + net.alpha[:, None], np.finfo(float).tiny)
    D, turn = D @ turn.T, turn @ whiten
    variance = p.constant(noise)
    if size:
        tails = [
            _polynomial_variance(p, net, x, phi, T, D, turn, *ridge)
            for ridge in zip(net.alpha, known, strict=True)
        ]
        variance = variance + p("join", *tails) * noise
    weights = 1 - (noise / signal)[:, None] / known
    distinct, which = np.unique(weights, axis=0, return_inverse=True)
    if len(distinct) > 2 or np.any(distinct < 0):
        inside = np.square(phi.affine(turn)).affine(weights)
    else:
        roots = [np.linalg.qr(np.sqrt(row)[:, None] * turn, mode="r") for row in distinct]
        g = [phi.affine(root) for root in roots]
        inside = p("join", *(one.dots(one) for one in g))[which.ravel()]
    return variance + np.maximum(1.0 - inside, 0.0) * signal


def _polynomial_variance(p, net, x, phi, T, D, turn, alpha, known):
    """Squared length of R (t - J g), see above: what T is beside D, by orthogonal columns."""
    weights = D.T @ T / known[:, None]
    left = np.vstack([T - D @ weights, -np.sqrt(alpha) * weights])
    root = np.asarray(np.linalg.qr(left, mode="r")).T
    of_x, J = np.linalg.solve(root, net.tail_map), np.linalg.solve(root, weights.T @ turn)
    u = p.constant(of_x[:, 0]) - phi.affine(J)
    if np.any(of_x[:, 1:]):
        u = u + x.affine(of_x[:, 1:])
    return u.dots(u)
