r"""A bound of the variance in single precision, that shows at half the price that nothing fades.

With the root R (m, r) of a covariance and the columns x of one coordinate at a pose, its standard
deviation is :math:`|R^\top x|`. Computed with numbers rounded to single precision, whose unit is
:math:`u = 2^{-24}`, and in whatever order the sums are taken, the result y has the error [1]_
(section 3.1; two roundings of data, one of each product, those of the sums)

.. math:: |y - R^\top x| \le \gamma\, |R|^\top |x|, \qquad \gamma = \frac{n u}{1 - n u},

in each of its r numbers, with n the roundings on the longest way of a number through the sums. The
length of the right-hand side is by the triangle inequality at most :math:`\gamma \sum_c |x_c|
\varrho_c`, with :math:`\varrho_c` the length of row c of R, which costs m products. So

.. math:: |R^\top x| \le (1 + \gamma) |y| + \gamma \sum_c |x_c| \varrho_c,

where the factor of the first term is for the roundings of |y| itself. The same holds for the length
over three coordinates. Where this is below what counts as known, no exact variance is needed.

A root of lower rank with a bound of what it leaves is no way: with a diagonal remainder, in the
best of four metrics, 110 of 185 directions were needed before training poses were known to be known
(two single-point tests, simulated), which is more work than the triangle of all.

References
----------
.. [1] N. J. Higham, "Accuracy and Stability of Numerical Algorithms", 2nd edition, SIAM 2002.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import NamedTuple

import numpy as np


class SingleRoot(NamedTuple):
    """A root in single precision, and what its bound is made of."""

    root: np.ndarray  # (m, r) float32
    lengths: np.ndarray  # (m,) float32, of the rows, and a little more
    rounding: float  # gamma


def single_root(root: np.ndarray) -> SingleRoot:
    """A root of a covariance in single precision.

    Parameters
    ----------
    root : ndarray of shape (m, r)

    Returns
    -------
    SingleRoot
    """
    m, r = root.shape
    # Columns may be products of three numbers, summed up in two stages, and then squared.
    n = (2 * m + r + 16) * 2.0**-24
    lengths = np.sqrt(np.square(root).sum(axis=1)) * (1 + 2 * n)
    return SingleRoot(root.astype(np.float32), lengths.astype(np.float32), n / (1 - n))


def bounded_std(columns, single):
    """Lengths that standard deviations over the coordinates do not exceed.

    Parameters
    ----------
    columns : FactoredColumns
        Of n poses.
    single : SingleRoot

    Returns
    -------
    ndarray of shape (n,)
        In mm.
    """
    columns = columns.map(np.float32)
    found = np.sqrt(columns.squares(single.root).sum(axis=1, dtype=float))
    # These sums have roundings of their own, which `lengths` leave room for.
    error = np.linalg.norm(columns.map(np.abs).dot(single.lengths), axis=1)
    return (1 + single.rounding) * found + single.rounding * error
