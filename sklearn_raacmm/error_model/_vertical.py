"""Where gravity points, by the evidence: the direction of its columns beside the stated one.

With the direction the columns of gravity turn as one: two more numbers, not three times as many
columns. Their products are quadratic in the direction and those with other columns linear: sums at
the six axes of an icosahedron are those at every direction.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.error_model._columns import GRAVITY, LOAD, columns_of
from sklearn_raacmm.error_model._fit import WIDE_SD, fit_with_constants, of_pairs
from sklearn_raacmm.inference import refit
from sklearn_raacmm.utils import Finding, stage

_GOLDEN = (1 + np.sqrt(5)) / 2
_AXES = np.array([[0, 1, _GOLDEN], [0, -1, _GOLDEN], [1, _GOLDEN, 0], [-1, _GOLDEN, 0],
                  [_GOLDEN, 0, 1], [_GOLDEN, 0, -1]]) / np.hypot(1, _GOLDEN)  # fmt: skip
# Poses of which a direction is found at most: more take time and turn it by less than a degree.
_ENOUGH = 600
# Rounds of a fit and a search: of a direction that is far off the fit has taken poses for outliers.
_ROUNDS = 4
# Log evidence that another direction has to add, in nats: of upright arms, real and simulated, it
# came to at most 10; of those inclined by 45 degrees or on a wall to at least 170. Cosine of 2
# degrees: gravity's columns change by less than 4 % (``benchmarks/bench_after_the_lab.py mounts``).
_PRICE, _NEAR = 20.0, np.cos(np.deg2rad(2))
# Where the fit leaves less than this share of the residuals there is nothing to be gained.
_NOTHING_LEFT = 1e-3
# Steps of the variances at a direction; steps of the search in rad, the last of which finds it to a
# quarter of a degree; moves in units of a step.
_STEPS, _LADDER, _FARTHEST = 3, (0.3, 0.3, 0.1, 0.03), 3.0


def fit_with_vertical(rows, positions, columns, with_field):
    """The fit of `fit_with_constants` along the vertical of the arm, or that which data show."""
    # A force that is always there is not told from gravity in its direction.
    terms = columns.terms
    may_turn = terms.gravity and not any(name.startswith("force") for name, _ in terms.extra)
    fitted, rounds = fit_with_constants(rows, positions, columns, with_field), 0
    while may_turn and rounds < _ROUNDS and (up := _higher(fitted)):
        columns, rounds = columns_of(rows.arm, terms._replace(up=up)), rounds + 1
        fitted = fit_with_constants(rows, positions, columns, with_field)
    if rounds:
        shown = [f"({x:.2f}, {y:.2f}, {z:.2f})" for x, y, z in (columns.up, rows.arm.up)]
        said = (
            f"Gravity seems to pull against {shown[0]} of the base frame, not against up = "
            f"{shown[1]}: its columns follow the data."
        )
        advice = "If the arm is mounted so, state it: Arm(..., up=), or raacmm arm --up."
        Finding("vertical", said, advice).report()
    return fitted


@stage("direction of gravity")
def _higher(fitted):
    """A direction against gravity of higher evidence than that of a fit, or ().

    The harmonics that the fit chose stay. To turn the direction round changes signs only: of both
    the one is taken along which the arm gives way.
    """
    rows, state = fitted.rows.weighted(fitted.pose_weight), fitted.state
    if state.noise_variance < _NOTHING_LEFT**2 * np.square(fitted.rows.y).mean():
        return ()
    if len(rows.X) > _ENOUGH:
        rows = rows.at(np.arange(0, len(rows.X), -(-len(rows.X) // _ENOUGH)))
    few, structures, lines = of_pairs(fitted.columns, fitted.structures, state.lines, state.pairs)
    loads = few.table["kind"][few.n_waves :] == LOAD
    if rows.y.shape[1] * len(np.unique(rows.X, axis=0)) < loads.sum():
        return ()  # along any direction so many columns explain so few poses

    def along(up):
        return columns_of(rows.arm, few.terms._replace(up=tuple(up.tolist())))

    parts = [rows.sums(along(axis)) for axis in _AXES]
    variance = state.variance.copy()
    explains_all = parts[0].square / parts[0].gram.diagonal()[loads].mean()
    variance[GRAVITY] = max(variance[GRAVITY], min(WIDE_SD**2, explains_all))
    start = state._replace(variance=variance)

    def at(up):
        return refit(_sums_at(up, parts, loads), structures, start, lines, _STEPS)

    # A direction that has paid already is only made better.
    stated, price = few.up, 0.0 if few.terms.up else _PRICE
    up = max([stated, *_AXES], key=lambda axis: at(axis).log_evidence)
    for step in _LADDER:
        higher, rise = _climbed(up, step, lambda near: at(near).log_evidence)
        if up is stated and rise < price:
            return ()
        up = higher
    there = at(up)
    if there.log_evidence - at(stated).log_evidence < price:
        return ()
    # A probe sags, whatever the pose: the arm measures it above where it is.
    columns = along(up).at(rows.X)[:, :, few.n_waves :][:, :, loads]
    above = columns @ there.coef[: len(loads)][loads] @ up
    up = up * np.sign(above.sum())
    return () if stated @ up > _NEAR else tuple(up.tolist())


def _climbed(up, step, value):
    """Direction of the top of a parabola through a direction and five that are a step away.

    And by how much the parabola is higher there. Far from the top the evidence is no parabola: the
    highest of the six, where that is higher.
    """
    across = np.linalg.svd(up[None])[2][1:]

    def turned(two):
        there = up + step * two @ across
        return there / np.linalg.norm(there)

    points = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1]])
    f = [value(turned(two)) for two in points]
    slope = np.array([f[1] - f[2], f[3] - f[4]]) / 2
    cross = f[5] - f[1] - f[3] + f[0]
    bend = np.array([[f[1] + f[2] - 2 * f[0], cross], [cross, f[3] + f[4] - 2 * f[0]]])
    best = turned(points[np.argmax(f)]), max(f) - f[0]
    if not np.all(np.linalg.eigvalsh(bend) < 0):
        return best
    move = -np.linalg.solve(bend, slope)
    top, rise = turned(move / max(np.linalg.norm(move) / _FARTHEST, 1.0)), 0.5 * slope @ move
    return (top, rise) if value(top) > max(f) else (best[0], max(rise, best[1]))


def _sums_at(up, parts, loads):
    """Sums at a direction, of those at the `_AXES`."""
    pairs = np.triu_indices(3)
    square = np.linalg.solve(
        np.array([np.outer(axis, axis)[pairs] for axis in _AXES]).T, np.outer(up, up)[pairs]
    )
    linear = np.linalg.pinv(_AXES.T) @ up
    # Shares of the six in products with none, one and two columns of gravity.
    shares = np.array([np.eye(len(_AXES))[0], linear, square])
    one = loads.astype(int)
    gram, moment, cross = (np.array(p) for p in zip(*(part[:3] for part in parts), strict=True))
    whole = parts[0]._replace(
        gram=np.einsum("ijp,pij->ij", shares[one[:, None] + one], gram),
        moment=np.einsum("ip,pi->i", shares[one], moment),
        cross=np.einsum("ip,piw->iw", shares[one], cross),
    )
    if whole.extra is None:
        return whole
    one = np.r_[np.zeros(cross.shape[2], int), one]
    rows = np.einsum("ip,pni->ni", shares[one], np.array([part.extra.rows for part in parts]))
    return whole._replace(extra=whole.extra._replace(rows=rows))
