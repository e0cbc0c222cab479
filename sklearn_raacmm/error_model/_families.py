"""How much the data speak for a family of columns: its share of the evidence."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.error_model._columns import (
    DIRECTION,
    FAMILIES,
    FORCE,
    TEMPERATURE,
    TOOL,
    term_names,
)

# Families of the extra columns: a user may name causes that are none.
_OF_EXTRA = (TEMPERATURE, DIRECTION, FORCE, TOOL)
# Log evidence that such a family has to add, in nats: as much as an order of harmonics above 72.
# With noise as the extra column 30 fits to five simulated arms came to at most 5, with a true cause
# that helped at positions left out to 22 or more (``benchmarks/bench_extra.py`` has the cases).
_PRICE_OF_FAMILY = 10.0
# Prior variance of a family that is not worth its price: its coefficients are nothing.
IDLE_VARIANCE = 1e-12


def least_of_the_idle(model, idle):
    """Family of extra columns that is least worth its price, or None where all are worth it.

    Parameters
    ----------
    model : LinearModel
    idle : set of int
        Families that have been put aside by now.
    """
    there = {f for f in _OF_EXTRA if FAMILIES[f] in model.prior_sd} - idle
    gains = {f: gain_of_family(model, f) for f in there}
    least = min(gains, key=gains.get, default=None)
    return least if least is not None and gains[least] < _PRICE_OF_FAMILY else None


def gain_of_family(model, family):
    """By how much a family raises the log evidence, beside all others and at its own variance.

    With w its coefficients, S their covariance and v their prior variance that is
    ``(w' inv(S) w + log det(S / v)) / 2``, as for a pair of a harmonic.

    Parameters
    ----------
    model : LinearModel
    family : int
        Index into `FAMILIES`.

    Returns
    -------
    float
        In nats; 0 where the model has no such columns.
    """
    of = np.flatnonzero(term_names(model.arm, model.terms)[1] == family)
    of = of + 2 * len(model.terms.harmonics)
    if not len(of):
        return 0.0
    half, w = model.half[of], model.coef[of]
    covariance = half @ half.T / model.prior_sd[FAMILIES[family]] ** 2
    w = w / model.prior_sd[FAMILIES[family]]
    fit = w @ np.linalg.solve(covariance, w)
    return float(0.5 * (fit + np.linalg.slogdet(covariance)[1]))
