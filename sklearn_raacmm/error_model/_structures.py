"""The list of structures that a model of the arm may have, and what each costs.

Families of causes are always in; harmonics are lines that have to be worth their price; a smooth
function of every joint's angle, all low orders together, is the field.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from numbers import Integral
from typing import Any

import numpy as np

from sklearn_raacmm.error_model._columns import FAMILIES, FAMILIES_OF_EXTRA, term_names
from sklearn_raacmm.inference import Structures

# What a harmonic costs per logarithm of its order.
_PRICE_PER_LOG_ORDER = 2.0
# Orders up to this may be there all together, smaller the higher they are: a smooth function of the
# joint's angle. Order at which the decay begins; price in nats (``benchmarks/bench_prices.py
# --field``).
_FIELD_ORDER, _DECAY_FROM, _PRICE_OF_FIELD = 48, 16.0, 16.0
# Log evidence that a family of extra columns has to add, in nats: noise came to at most 5, a true
# cause that helped to 22 or more (``benchmarks/bench_beyond_the_paper.py extra``).
_PRICE_OF_EXTRA = 10.0
# Prior standard deviation of a family that is not worth its price: its coefficients are nothing.
UNUSED_SD = 1e-6
# One degree, in square arc seconds: beyond it an arm's errors are not linear; directions that the
# data do not show would carry the variance beyond all bounds by their rounding.
_LARGEST_VARIANCE = 3600.0**2
# Standard deviation of the families at which a second search begins: any from 10 to 300 arc seconds
# leads to the same models (``benchmarks/bench_few_poses.py --narrow``).
WIDE_SD = 30.0
# Angles nearer to each other than this, in rad, count as one: the rounding of files.
_SAME_ANGLE = 1e-6
# Orders above this are offered where a joint's angles, those nearer than 0.001 rad counted as one,
# are at least half as many as the poses (``benchmarks/bench_few_poses.py``).
HIGHEST_OF_FEW, _SAME_TOOTH, _SCATTERED = 72, 1e-3, 0.5


def offered_harmonics(angles, orders):
    """Harmonics that a fit may take, (n_pairs, 2): joint from 0 and order, sorted.

    `angles` (n, n_joints) of the poses are in rad. `orders` may be the highest order: a joint at m
    different angles is offered none above m, for on a grid the waves of lower orders are the same
    there; but all above 72 where its angles are scattered. Or the orders themselves, for all joints
    or for each.
    """
    n_joints = angles.shape[1]
    if isinstance(orders, Integral):
        n_poses = len(np.unique(np.round(angles / _SAME_TOOTH), axis=0))
        named = [_seen_orders(column, orders, n_poses) for column in angles.T]
    else:
        named = _named_orders(orders, n_joints)
    pairs = [(joint, order) for joint, own in enumerate(named) for order in own]
    return np.array(pairs, dtype=int).reshape(-1, 2)


def _seen_orders(angles, most, n_poses):
    """Orders up to `most` that the angles of a joint can tell apart."""
    n, n_teeth = (len(np.unique(np.round(angles / same))) for same in (_SAME_ANGLE, _SAME_TOOTH))
    low = list(range(1, min(most, n) + 1))
    high = range(max(HIGHEST_OF_FEW, len(low)) + 1, most + 1)
    return [*low, *high] if n_teeth >= _SCATTERED * n_poses else low


def _named_orders(orders, n_joints):
    """Orders of each joint, sorted."""
    orders = list(orders)
    if not any(np.iterable(order) for order in orders):
        orders = [orders] * n_joints
    if len(orders) != n_joints:
        raise ValueError(
            f"orders has {len(orders)} lists, but the arm has {n_joints} joints: give one for all, "
            "or one for each."
        )
    for joint, own in enumerate(orders, start=1):
        bad = [k for k in own if not isinstance(k, Integral) or isinstance(k, bool) or k < 1]
        if bad:
            raise ValueError(
                f"orders must be whole numbers of 1 or more, got {bad[0]!r} for joint {joint}."
            )
    return [np.unique(np.array(list(own), dtype=int)).tolist() for own in orders]


def structures_of(arm, terms, with_field, unused=frozenset()):
    """Families, lines and field of a model with some columns.

    Variances are in the order of `FAMILIES`. The harmonics of `terms` are those that are offered.
    The families `unused` have proved not to be worth their price.
    """
    family, order = term_names(arm, terms)[1], terms.harmonics[:, 1]
    if not len(order) and not len(family):
        raise ValueError("The model has no columns: no orders are offered and no causes are named.")
    given = np.full(len(FAMILIES), np.nan)
    given[list(unused)] = UNUSED_SD**2
    return Structures(
        family=family,
        price=order_price(order),
        share=smooth_shares(order) if with_field and len(order) else None,
        field_price=_PRICE_OF_FIELD,
        given=given,
        largest=_LARGEST_VARIANCE,
        wide=WIDE_SD**2,
    )


def order_price(order: Any) -> Any:
    """Price in nats of harmonics of the orders k: ``2 log(k)``, for the odds fall with its square.

    Every encoder is a little eccentric, so that order 1 is free. On simulated arms factors from 1.5
    to 2.5 leave the same within 0.5 % (``benchmarks/bench_prices.py``).
    """
    return _PRICE_PER_LOG_ORDER * np.log(order)


def smooth_shares(order: np.ndarray) -> np.ndarray:
    """Prior variance of each order as a part of the field, relative to that of order 0.

    ``(1 + (k / 16)^2)^-2``, the spectrum of functions that can be differentiated; 0 above order 48.
    """
    share = (1 + np.square(order / _DECAY_FROM)) ** -2.0
    return np.where(order <= _FIELD_ORDER, share, 0.0)


def least_unused(state, family, unused):
    """Family of extra columns that is least worth its price, or None where all are worth it.

    `family` is that of each column that is always in; `unused` have been put aside by now.
    """
    there = set(np.unique(family).tolist()) & set(FAMILIES_OF_EXTRA) - unused
    gains = [(state.gain_of(np.flatnonzero(family == f)), f) for f in there]
    gain, least = min(gains, default=(_PRICE_OF_EXTRA, None))
    return least if gain < _PRICE_OF_EXTRA else None
