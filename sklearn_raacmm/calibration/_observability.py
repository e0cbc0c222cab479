"""What measurements can show of an arm's parameters, from the Jacobian alone."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

# Singular values below this part of the largest are rounding.
_RANK = 1e-9
# Terms of a combination that move the probe by less than this part of its largest are not written.
_SMALL_TERM = 0.05
# Columns whose sizes differ by less than this part are equal.
_TIE = 1e-6
# A combination is open where its posterior standard deviation is above half the prior's, which is
# 1 / sqrt(1 + s^2) of it for a singular value s of the data in prior units.
_OPEN = np.sqrt(3.0)


def observability(root, n_rows, names, prior_sd, unit, sigma):
    """Rank, condition, observability index and open combinations.

    `root` (<= p, p) is the triangular factor of the derivatives of `n_rows` data, in standard
    deviations `sigma` (mm), by the free parameters; `prior_sd` (p,) counts as knowing nothing of
    each, and `unit` (p,) moves the probe by about 1 mm. As fields of a `CalibrationResult`.
    """
    values = np.linalg.svd(root * unit * sigma, compute_uv=False)
    rank = int(np.sum(values > _RANK * values.max(initial=0.0)))
    values = values[:rank]
    index = float(np.exp(np.log(values).mean()) / np.sqrt(n_rows / 3)) if rank else 0.0
    condition = np.inf
    if rank == len(names):
        condition = float(values[0] / values[-1]) if rank else 1.0
    _, strength, directions = np.linalg.svd(root * prior_sd, full_matrices=True)
    strength = np.r_[strength, np.zeros(len(names) - len(strength))]
    combinations = _readable(directions[strength < _OPEN], names, prior_sd, unit)
    return {
        "rank": rank,
        "condition_number": condition,
        "observability_index": index,
        "unidentified_combinations": combinations,
    }


def _readable(basis, names, prior_sd, unit):
    """A basis (k, p), in prior units, as sums with few terms: its reduced echelon form."""
    lines, pivots, rest = [], [], basis.copy()
    for _ in range(len(basis)):
        # What is left of each column beside those chosen: that does not depend on which basis of
        # the space was given. Of equal ones the first, whatever rounding says.
        size = np.linalg.norm(rest, axis=0)
        pivots.append(int(np.argmax(size > (1 - _TIE) * size.max())))
        along = rest[:, pivots[-1]] / size[pivots[-1]]
        rest = rest - np.outer(along, along @ rest)
        rest[:, pivots] = 0.0
    basis = np.linalg.solve(basis[:, pivots], basis)
    for row, pivot in sorted(zip(basis, pivots, strict=True), key=lambda pair: pair[1]):
        moves = np.abs(row * prior_sd / unit)  # mm at the probe, about
        large = moves > _SMALL_TERM * moves.max()
        factors, text = row * prior_sd / prior_sd[pivot], ""
        for i in [pivot, *(i for i in np.flatnonzero(large) if i != pivot)]:
            minus, plus = (" - ", " + ") if text else ("-", "")
            size = abs(factors[i])
            text += minus if factors[i] < 0 else plus
            text += names[i] if abs(size - 1) < 0.005 else f"{size:.3g} {names[i]}"
        lines.append(text)
    return tuple(lines)
