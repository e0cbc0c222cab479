"""Which orders of harmonics are offered, and what each has to be worth to be taken."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from numbers import Integral, Real

import numpy as np

from sklearn_raacmm.utils import show

# Orders up to this are common: eccentric discs (1, 2), poles, teeth. Higher ones come from gears
# and motor encoders, on some arms only.
COMMON_ORDER = 72
# Every encoder is a little eccentric, every disc a little oval: orders up to this are as likely to
# be there as not, and cost nothing. With the price of the others most of them were missing in a
# model of few positions. Of 128 simulated single-point tests with 12 or 20 positions the true
# errors elsewhere are 0.80 to 0.99 of what they were (means of four machines), the measured
# deviations 0.91 to 1.00; of 50 arms of six machines, half of them with a tracker, the deviations
# 0.98 in the mean.
LIKELY_ORDER = 2
# Price in nats of an order above that, beside that of a common one. With simulated errors at poses
# of real arms (with gears, without, and with smooth errors outside the model) steps of 0 to 10 nats
# and prices that grow with the logarithm of the order leave the same within half a per cent.
_PRICE_OF_HIGH = 10.0
# A gear shows at its ratio and at small multiples of it, on each joint that has one of the kind.
# Multiples that make an order likelier once another is taken; those offered for a known ratio.
_MULTIPLES = np.array([1, 2, 3, 4])
# Orders up to this that are not taken for themselves may be there all together, small, and smaller
# the higher they are: a smooth function of the joint's angle, see `smooth_shares`. Order at which
# the decay begins. With simulated functions of three kinds at poses of real arms, starts at 8, 16
# and 32, and a slower decay, leave the same within 5 % where the data ask for such a function.
_SMOOTH_ORDER, _DECAY_FROM = 48, 16.0
# Angles nearer to each other than this, in rad, count as one: the rounding of files.
_SAME_ANGLE = 1e-6


def offered_harmonics(angles, max_order, orders=None, gear_ratio=None):
    """Harmonics that a fit may take.

    Parameters
    ----------
    angles : ndarray of shape (n, n_joints)
        Of the training poses, in rad.
    max_order : int
        Highest order. A joint at m different angles is offered none above m: there the waves of
        lower orders are the same.
    orders : array-like of int, or one array-like per joint, default=None
        The orders themselves, for all joints or for each; `max_order` is then not used.
    gear_ratio : float or array-like of shape (n_joints,), default=None
        Gear ratio of all joints or of each, 0 where it is unknown. Its multiples up to four that
        are whole numbers are offered, too.

    Returns
    -------
    offered : ndarray of shape (n_pairs, 2)
        Joint from 0 and order, sorted.
    expected : ndarray of shape (n_pairs,)
        Which of them the user has named.

    Raises
    ------
    ValueError
        If orders are not whole numbers of 1 or more, or a list has not one entry per joint.
    """
    n_joints = angles.shape[1]
    named = _named_orders(orders, n_joints)
    geared = _geared_orders(gear_ratio, n_joints)
    pairs, expected = [], []
    for joint in range(n_joints):
        own = named[joint]
        if own is None:
            different = len(np.unique(np.round(angles[:, joint] / _SAME_ANGLE)))
            own = np.arange(1, min(max_order, different) + 1)
        everything = np.union1d(own, geared[joint]).astype(int)
        known = everything if orders is not None else geared[joint]
        pairs += [(joint, order) for order in everything.tolist()]
        expected += np.isin(everything, known).tolist()
    return np.array(pairs, dtype=int).reshape(-1, 2), np.array(expected, dtype=bool)


def _named_orders(orders, n_joints):
    """Orders of each joint, or None for those up to the highest."""
    if orders is None:
        return [None] * n_joints
    orders = list(orders)
    if all(isinstance(order, Real) for order in orders):
        orders = [orders] * n_joints
    if len(orders) != n_joints:
        raise ValueError(
            f"orders has {len(orders)} lists, but the arm has {n_joints} joints: give one list for "
            "all joints, or one for each."
        )
    for joint, own in enumerate(orders, start=1):
        bad = [k for k in own if not isinstance(k, Integral) or isinstance(k, bool) or k < 1]
        if bad:
            raise ValueError(
                f"orders must be whole numbers of 1 or more, got {bad[0]!r} for joint {joint}."
            )
    return [np.unique(np.array(list(own), dtype=int)) for own in orders]


def _geared_orders(gear_ratio, n_joints):
    """Whole multiples of the gear ratio of each joint."""
    ratios = np.atleast_1d(np.asarray(0.0 if gear_ratio is None else gear_ratio, dtype=float))
    if ratios.shape not in ((1,), (n_joints,)):
        raise ValueError(
            f"gear_ratio has shape {ratios.shape}, but the arm has {n_joints} joints: give one "
            "ratio for all joints, or one for each (0 where it is unknown)."
        )
    if not np.all(np.isfinite(ratios) & (ratios >= 0)):
        raise ValueError(f"gear_ratio must be finite and 0 or more, got {show(gear_ratio)}.")
    found = []
    for ratio in np.broadcast_to(ratios, n_joints).tolist():
        orders = ratio * _MULTIPLES
        whole = np.round(orders)
        found.append(whole[(np.abs(orders - whole) < 1e-9) & (whole >= 1)].astype(int))
    return found


def order_prices(offered, expected):
    """Rule by which harmonics are priced while they are chosen.

    A common order costs the logarithm of the number of common ones that are offered: the odds that
    one of so many would reach by chance are then even, so that their number hardly matters. Higher
    ones cost 10 nats more, but for those that the user has named, and for small multiples and
    divisors of a high order that has been taken on any joint: gears of one make have one ratio.
    Orders 1 and 2 cost nothing, but beside a smooth function, of which they are a part.

    Parameters
    ----------
    offered : ndarray of shape (n_pairs, 2)
    expected : ndarray of shape (n_pairs,)

    Returns
    -------
    callable
        From indices of the pairs chosen so far, and whether there is a smooth function, to the
        prices in nats, (n_pairs,).
    """
    order = offered[:, 1]
    high = (order > COMMON_ORDER) & ~expected
    common = np.log(max(np.count_nonzero(~high), 1))
    every = common + _PRICE_OF_HIGH * high
    cheap = np.where(order > LIKELY_ORDER, every, 0.0)

    def prices(chosen, beside_smooth=False):
        alone = every if beside_smooth else cheap
        gears = np.unique(order[chosen])
        gears = gears[gears > COMMON_ORDER]
        if not len(gears):
            return alone
        related = np.isin(order, np.outer(gears, _MULTIPLES))
        for multiple in _MULTIPLES:
            related |= np.isin(multiple * order, gears)
        return np.where(related, np.minimum(common, alone), alone)

    return prices


def smooth_shares(order):
    """Prior variance of each order as a part of a smooth function, relative to that of order 0.

    ``(1 + (k / 16)^2)^-2``, the spectrum of functions that can be differentiated; 0 above order 48.

    Parameters
    ----------
    order : ndarray of shape (n_pairs,)

    Returns
    -------
    ndarray of shape (n_pairs,)
    """
    share = (1 + np.square(order / _DECAY_FROM)) ** -2.0
    return np.where(order <= _SMOOTH_ORDER, share, 0.0)


def likely_gear_ratios(joint, order, evidence, n_joints):
    """Gear ratio of each joint of which high orders look like multiples.

    Parameters
    ----------
    joint : ndarray of shape (n_harmonics,)
        Joint of each harmonic found, from 1.
    order : ndarray of shape (n_harmonics,)
    evidence : ndarray of shape (n_harmonics,)
        Log Bayes factor of each.
    n_joints : int

    Returns
    -------
    ndarray of shape (n_joints,)
        Ratio, or 0 where none is likely: the order above 72 for which the evidence of its multiples
        on all joints is largest, given that it has a multiple on this joint and one more anywhere.
    """
    ratios = np.zeros(n_joints, dtype=int)
    most = np.zeros(n_joints)
    for ratio in np.unique(order[order > COMMON_ORDER]):
        members = np.isin(order, ratio * _MULTIPLES)
        support = evidence[members].sum()
        if np.count_nonzero(members) > 1:
            own = np.unique(joint[members].astype(int)) - 1
            better = own[support > most[own]]
            ratios[better], most[better] = ratio, support
    return ratios
