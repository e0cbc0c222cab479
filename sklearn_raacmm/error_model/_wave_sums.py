r"""Sums over poses of columns times the waves of one joint, for many orders at once.

What is asked for is :math:`\sum_n c_n \exp(i k \theta_n)` for all orders k. Few orders are summed
up as they stand. For many of them every :math:`c_n` is spread over the nearest points of a fine
grid of angles, by a smooth kernel; the fast Fourier transform of the grid, divided by that of the
kernel, holds all orders to the last digits of double precision (a nonuniform fast Fourier
transform [1]_). The time then hardly depends on the number of orders.

References
----------
.. [1] A. H. Barnett, J. Magland, L. af Klinteberg, "A parallel nonuniform fast Fourier transform
   library based on an exponential of semicircle kernel", SIAM J. Sci. Comput. 41(5), 2019,
   C479-C504.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.sparse import csr_array

# Orders and poses from which on the grid is faster, measured with 96 columns.
_MANY_ORDERS, _MANY_POSES = 128, 256
# Points of the grid for each order up to the highest, points under the kernel, and how sharp the
# kernel is beside the sharpest that the grid allows. With 1000 orders the error is that of the
# phase of the highest one; 13 points under the kernel leave ten times as much.
_PER_ORDER, _WIDTH, _SHARPNESS = 5, 15, 0.97
# Nodes of the integral that is the kernel's own transform: to the last digit with half of them.
_NODES = 64


class WaveSums:
    """Sums over poses of columns times ``exp(i k theta)``, for the orders k of one joint.

    Parameters
    ----------
    orders : ndarray of shape (n_orders,)
        Sorted.
    n_poses : int
        That there will be in all.
    """

    def __init__(self, orders, n_poses):
        self.orders, self._total = orders, 0.0
        self._grid = _grid(int(orders[-1])) if _on_grid(orders, n_poses) else None

    def add(self, theta, columns):
        """Add some poses.

        Parameters
        ----------
        theta : ndarray of shape (n,)
            In rad.
        columns : ndarray of shape (n, m)
        """
        if self._grid is None:
            self._total = self._total + columns.T @ waves(theta, self.orders).view(float)
        else:
            self._total = self._total + _spread(theta, self._grid).T @ columns

    def result(self):
        """Real and imaginary part of each order by turns, (m, 2 n_orders)."""
        if self._grid is None:
            return self._total
        found = rfft(np.ascontiguousarray(self._total.T), axis=1).take(self.orders, axis=1)
        return np.conj(found * self._grid.correction[self.orders]).view(float)


def sums_of_doubles(theta, size, orders):
    """Sums over poses of sizes (n,) times ``exp(2 i k theta)``, (n_orders,) complex."""
    if not _on_grid(orders, len(theta)):
        return size @ np.square(waves(theta, orders))
    sums = WaveSums(2 * orders, len(theta))
    sums.add(theta, size[:, None])
    return sums.result().view(complex).ravel()


def _on_grid(orders, n_poses):
    return len(orders) >= _MANY_ORDERS and n_poses >= _MANY_POSES


def waves(theta, orders):
    """exp(i k theta), (n, n_orders) complex; orders 1 to K by doubling, those beyond one by one."""
    n = np.count_nonzero(orders == np.arange(1, len(orders) + 1))
    out = np.empty((len(theta), len(orders)), dtype=complex)
    if n:
        out[:, 0] = np.exp(1j * theta)
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


class _Grid(NamedTuple):
    size: int  # points around the circle
    sharpness: float
    correction: np.ndarray  # (highest + 1,) one over the transform of the kernel


@lru_cache(maxsize=16)
def _grid(highest):
    size = next_fast_len(_PER_ORDER * highest, real=True)
    sharpness = _SHARPNESS * np.pi * _WIDTH * (1 - highest / size)
    nodes, shares = np.polynomial.legendre.leggauss(_NODES)
    phase = np.outer(np.arange(highest + 1), nodes * _WIDTH * np.pi / size)
    transform = np.cos(phase) @ (shares * _kernel(nodes, sharpness)) * _WIDTH / 2
    return _Grid(size, sharpness, 1 / transform)


def _kernel(x, sharpness):
    """Exponential of a semicircle, between -1 and 1."""
    return np.exp(sharpness * (np.sqrt(np.maximum(1 - x * x, 0.0)) - 1))


def _spread(theta, grid):
    """What each angle gives to the points of the grid around it, (n, size) sparse."""
    at = np.mod(theta / (2 * np.pi), 1.0) * grid.size
    points = np.ceil(at - _WIDTH / 2).astype(np.int32)[:, None] + np.arange(_WIDTH, dtype=np.int32)
    values = _kernel((points - at[:, None]) * (2 / _WIDTH), grid.sharpness)
    ends = np.arange(0, values.size + 1, _WIDTH, dtype=np.int32)
    points %= grid.size
    return csr_array((values.ravel(), points.ravel(), ends), shape=(len(theta), grid.size))
