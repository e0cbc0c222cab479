"""The fit of the linear error model, from arrays to a `LinearModel`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.error_model._columns import (
    FAMILIES,
    factored_columns,
    levers,
    term_names,
)
from sklearn_raacmm.error_model._fading import LEAST_POSITIONS
from sklearn_raacmm.error_model._gauge import constrained, length_equations, without_motions
from sklearn_raacmm.error_model._linear_model import LinearModel
from sklearn_raacmm.error_model._structures import least_unused, structures_of
from sklearn_raacmm.error_model._waves import candidate_sums
from sklearn_raacmm.inference import (
    Problem,
    State,
    beside_field,
    combined,
    search,
    sums_of_pairs,
)
from sklearn_raacmm.utils import (
    TUKEY_CUT,
    Finding,
    centred,
    chunks,
    group_means,
    group_sums,
    report_findings,
    stage,
    tukey_weights,
)

# Rounds of robust weights at one choice, and choices with what they have become. Weights that
# change by less than this have settled.
_ROUNDS, _MAX_CHOICES, _SETTLED_WEIGHT = 4, 3, 0.05
# Steps of the variances where they are nearly right: others follow, with the robust weights.
_REFIT_STEPS = 5
# Where less than this share of the poses is concerned, sums over them cost less than new ones
# (``benchmarks/bench_speed.py fit``).
_FEW_POSES = 0.4
# Poses whose columns are held at a time.
_POSES = 256
# Shares of the noise that may come through the angles: not all, for J J' has rank 2 at some poses.
_SHARES = np.arange(0.0, 0.99, 0.02)
# Rows of which that is compared at a time: 5 MB for an array of all shares.
_ROWS_OF_NOISE = 4096

# What the weights leave of the noise variance, of normal errors in three coordinates: E[w d^2] /
# (3 E[w]) with w = (1 - d^2 / c^2)^2 and d^2 of the chi-squared distribution, whose moments are 1,
# 3, 15 and 105; beyond the limit c the density is next to nothing.
_C2 = TUKEY_CUT**2
_SHARE_OF_NOISE = (3 - 30 / _C2 + 105 / _C2**2) / (3 * (1 - 6 / _C2 + 15 / _C2**2))

# Noise variances over those of constants of positions that are compared: smaller constants than the
# noise are not told from what a model that is not complete leaves alike at the rows of a position.
# Steps of the other variances at each, and rounds with a fit at what was found
# (``benchmarks/bench_few_poses.py --constants``).
_KNOWN, _CONSTANT_STEPS, _CONSTANT_ROUNDS = 10.0 ** np.arange(-4.0, 0.5, 0.5), 3, 2
# Variance of means that are 0 but for rounding, in parts of that of the residuals. What it costs,
# in nats, that means say nothing of the arm: of four to seven positions that a calibration has
# drawn together it came to 18, of twelve and deviations from a median to 55 (same script).
_LEAST_MEANS, _PRICE_OF_DEVIATIONS = 1e-6, 30.0


class Rows(NamedTuple):
    """What a model is fitted to."""

    arm: Arm
    X: np.ndarray  # (n, n_joints + n_extra) angles in rad, extra columns, perhaps probes (n, 3)
    y: np.ndarray  # (n, 3) residuals in mm
    weights: np.ndarray  # (n,)
    codes: np.ndarray | None  # (n,) position of each row, from 0, where positions have offsets
    lengths: tuple = ()  # of (position, position, mm, standard deviation in mm)
    known: float = 0.0  # noise variance over that of the offsets; 0: nothing is known of them

    def at(self, which):
        """Some of the rows, with positions counted from 0 and the lengths that are left."""
        codes, lengths = self.codes, self.lengths
        if codes is not None:
            present, codes = np.unique(codes[which], return_inverse=True)
            codes = codes.ravel()
            place = {code: i for i, code in enumerate(present.tolist())}
            lengths = [
                (place[i], place[j], *rest) for i, j, *rest in lengths if i in place and j in place
            ]
        return self._replace(
            X=self.X[which],
            y=self.y[which],
            weights=self.weights[which],
            codes=codes,
            lengths=tuple(lengths),
        )

    def weighted(self, factor):
        """The rows with their weights times a factor, without those of no weight."""
        rows = self._replace(weights=self.weights * factor)
        kept = rows.weights > 0
        return rows if kept.all() else rows.at(kept)

    def sums(self, terms):
        """Sums over the rows, the harmonics of `terms` being the candidates; known lengths."""
        rows = self.arm, self.X, self.y, self.weights, self.codes
        sums = candidate_sums(*rows, terms.harmonics, terms, self.known)
        if self.codes is None or self.known:
            return sums, None
        sums, lengths = without_motions(sums, self.arm, terms), None
        if self.lengths:
            poses = self.X, self.weights, self.codes
            lengths = length_equations(self.arm, *poses, terms, self.lengths)
        return sums, lengths

    def sums_after(self, sums, old, new, terms):
        """The `sums` at the factors `new`, from those at `old`: few rows are summed up again."""
        touched = old != new
        if not touched.any():
            return sums
        if self.codes is not None:
            touched = np.isin(self.codes, self.codes[touched])
        # Rows that all had no weight, or all lose it, have no sums of their own.
        empty = any(not np.any(factor[touched]) for factor in (old, new))
        if self.lengths or empty or touched.mean() > _FEW_POSES:
            return self.weighted(new).sums(terms)
        rows = self.at(touched)
        less, more = (rows.weighted(factor[touched]).sums(terms)[0] for factor in (old, new))
        return combined((sums[0], less, more), (1, -1, 1)), None


class Fitted(NamedTuple):
    """A fitted model, how it was found, and what the robust weights left of each row."""

    model: LinearModel
    state: State
    pose_weight: np.ndarray  # (n,)
    rows: Rows


def fit_with_constants(rows, positions, terms, with_field):
    """Fit the model, and constants of the positions of the variance that the evidence asks for.

    A reference may be off by a constant in each position. The arm's own differences between
    positions are told from these, for they are the same function of the angles everywhere. With the
    variance v of the constants and s of the noise a constant is drawn to 0 as by rows of the weight
    s / v.

    `positions` (n,) count from 0; None: there are no constants. Returns a `Fitted`, whose rows are
    those given less their constants, or with positions of which nothing is known.
    """
    fitted = fit_linear_model(rows, terms, with_field)
    if positions is None or rows.codes is not None:
        return fitted
    n_positions = int(positions.max()) + 1
    if n_positions < LEAST_POSITIONS or len(positions) < 2 * n_positions:
        return fitted
    known: Any = np.inf
    for _ in range(_CONSTANT_ROUNDS):
        last, known = known, _known_of_constants(rows, positions, terms, with_field, fitted)
        if known == last:
            break
        given = rows if np.isinf(known) else rows._replace(codes=positions, known=known)
        fitted = fit_linear_model(given, terms, with_field)
    if np.isinf(known):
        return fitted
    weights = rows.weights * fitted.pose_weight
    total = np.bincount(positions, weights)
    left = rows.y - fitted.model.predict(rows.X)[0]
    constants = group_sums(left, positions, weights) / np.maximum(total + known, 1e-9)[:, None]
    size = float(np.sqrt(np.square(constants).sum(axis=1).mean()))
    # Deviations from a row of the position are as large as its rows scatter, at most.
    within = centred(rows.y, positions, rows.weights)
    scatter = float(np.sqrt(np.average(np.square(within).sum(axis=1), weights=rows.weights)))
    said = (
        f"The positions differ by constants of {size:.2g} mm each (root mean square) that the "
        "causes of the model do not explain."
    )
    advice = (
        "How well are the references known, and is a cause missing? The constants are not taken "
        "for the arm's."
    )
    weight = "doubt" if size > 2 * scatter else "note"
    report_findings([Finding("constants-of-positions", said, advice, weight, size_mm=size)])
    if not known:
        return fitted
    return fitted._replace(rows=rows._replace(y=rows.y - constants[positions]))


def _known_of_constants(rows, positions, terms, with_field, fitted):
    """Noise variance over that of the constants, by the evidence of what a fit has chosen.

    Infinite: there are none. With W the weight of a position its constant takes
    ``log(1 + W / known) / 2`` of the log evidence, for x, y and z each. Their variance is one more
    number, which costs half the logarithm of how many there are (Schwarz).

    0: the means of the positions say nothing of the arm, as those of deviations from a mean, a
    median or a row of their position. They are then normal by themselves, of another variance.
    """
    # As counts of rows, weights of another size would have means scatter too much or too little.
    weight = rows.weights.mean()
    rows = rows._replace(weights=rows.weights / weight)
    state, structures = fitted.state, structures_of(rows.arm, terms, with_field)
    few, structures, lines = of_pairs(terms, structures, state.lines, state.pairs)
    total = np.bincount(positions, rows.weights)
    start = lines, state.with_field, state.variance, state.noise_variance / weight

    def evidence(given):
        problem = Problem(given.sums(few)[0], structures)
        return problem.with_variances(problem.state(*start), _CONSTANT_STEPS).log_evidence

    n = 3 * len(total)
    found = {np.inf: evidence(rows)}
    for known in _KNOWN.tolist():
        taken = 1.5 * np.log1p(total / known).sum() + 0.5 * np.log(n)
        found[known] = evidence(rows._replace(codes=positions, known=known)) - taken
    squares = np.square(group_means(rows.y, positions, rows.weights)) * total[:, None]
    least = _LEAST_MEANS * np.average(np.square(rows.y).mean(axis=1), weights=rows.weights)
    variance = max(squares.mean(), least)
    taken = 0.5 * n * (np.log(variance) + squares.mean() / variance) + 0.5 * np.log(n)
    found[0.0] = evidence(rows._replace(codes=positions)) - taken - _PRICE_OF_DEVIATIONS
    known = max(found, key=lambda one: found[one])
    # Constants that are no larger than the noise are none.
    return np.inf if known == _KNOWN[-1] else known * weight


@stage("linear error model")
def fit_linear_model(rows, terms, with_field) -> Any:
    """Fit the model to rows of weights above 0, with robust weights of the poses: a `Fitted`.

    The harmonics of `terms` are those that are offered; `with_field` allows a smooth function of
    each angle. Families of extra columns that are not worth their price stay out.
    """
    unused: frozenset[int] = frozenset()
    while True:
        structures = structures_of(rows.arm, terms, with_field, unused)
        state, factor = _fit(rows, terms, structures)
        least = least_unused(state, structures.family, unused)
        if least is None:
            break
        unused |= {least}
    model = model_of(rows.weighted(factor), terms, state)
    if np.any(factor < 1):
        model = replace(model, noise_variance=model.noise_variance / _SHARE_OF_NOISE)
    return Fitted(_with_noise_of_angles(model, rows.weighted(factor)), state, factor, rows)


def _with_noise_of_angles(model, rows):
    """Model with the share of the noise that comes through the joints' angles.

    With J what the angles do to the probe, the noise of a pose is ``(1 - q) I + q J J' / l^2`` of
    the usual, with l^2 the mean square of J. Its likelihood over a grid of shares q, the size of
    the noise being the likeliest for each, gives the mean of q: there is nothing to decide.
    """
    squares = np.empty((len(rows.X), 3, 3))
    for part in chunks(len(rows.X), _ROWS_OF_NOISE):
        J = levers(rows.arm, model.terms, rows.X[part])
        squares[part] = J @ J.swapaxes(1, 2)
    lever = np.average(np.einsum("nii->n", squares), weights=rows.weights) / 3
    if not lever > 0:
        return model
    size, axes = np.linalg.eigh(squares / lever)
    left = centred(rows.y - model.predict(rows.X)[0], rows.codes, rows.weights)
    left = np.square(np.einsum("nca,nc->na", axes, left))
    total, fit, volume = 3 * rows.weights.sum(), np.zeros(len(_SHARES)), np.zeros(len(_SHARES))
    for part in chunks(len(rows.X), _ROWS_OF_NOISE):
        variance = 1 - _SHARES[:, None, None] * (1 - size[part])
        fit += np.einsum("n,qna->q", rows.weights[part], left[part] / variance) / total
        volume += np.einsum("n,qna->q", rows.weights[part], np.log(variance))
    if not fit.all():  # no noise
        return model
    logs = -0.5 * (total * np.log(fit) + volume)
    odds = np.exp(logs - logs.max())
    share = float(odds @ _SHARES / odds.sum())
    return replace(model, noise_of_angles=share, lever_mm=float(np.sqrt(lever)))


def _fit(rows, terms, structures) -> tuple[Any, Any]:
    """Choose structures and weights by turns: the state, and the factors of the weights."""
    factor = np.ones(len(rows.weights))
    sums, state = rows.sums(terms), None
    for _ in range(_MAX_CHOICES):
        start = factor
        state = search(Problem(sums[0], structures, sums[1]), state)
        state, factor, sums = _settled(rows, terms, structures, sums, state, factor)
        if structures.share is not None and not state.with_field:
            beside = _beside_field(rows, terms, structures, sums, state, factor)
            if beside is not None:
                state, factor, sums = _settled(rows, terms, structures, sums, beside, factor)
        if np.all(factor == start):
            break
    return state, factor


def _beside_field(rows, terms, structures, sums, state, factor):
    """The choice beside the field, or None; sums of the field alone say whether it is searched."""
    problem = Problem(sums[0], structures, sums[1])
    pairs = problem.pairs_and_shares(state.lines, True)[0]
    few, of_field, lines = of_pairs(terms, structures, state.lines, pairs)
    some = rows.weighted(factor).sums(few)
    alone = state._replace(lines=lines, pairs=lines)
    return beside_field(problem, state, Problem(some[0], of_field, some[1]), alone)


def of_pairs(terms, structures, lines, pairs):
    """Terms, structures, and which are lines, where some pairs are the only candidates."""
    few = terms._replace(harmonics=terms.harmonics[pairs])
    share = None if structures.share is None else structures.share[pairs]
    structures = structures._replace(price=structures.price[pairs], share=share)
    return few, structures, np.flatnonzero(np.isin(pairs, lines))


def _settled(rows, terms, structures, sums, state, factor):
    """A choice with robust weights that have settled: state, weights, and sums at these weights."""
    pairs, before = state.pairs, factor
    few, structures, lines = of_pairs(terms, structures, state.lines, pairs)
    some = (sums_of_pairs(sums[0], pairs), None)
    for _ in range(_ROUNDS):
        left = centred(rows.y - _expected(rows, few, state), rows.codes, rows.weights * factor)
        old, new = factor, tukey_weights(left, rows.weights, weighed=bool(np.any(factor < 1)))
        factor = np.where(np.abs(new - old) < _SETTLED_WEIGHT, old, new)
        if np.all(factor == old):
            break
        some = rows.sums_after(some, old, factor, few)
        problem = Problem(some[0], structures, some[1])
        start = problem.state(lines, state.with_field, state.variance, state.noise_variance)
        found = problem.with_variances(start, _REFIT_STEPS)
        state = found._replace(lines=state.lines, pairs=pairs)
    return state, factor, rows.sums_after(sums, before, factor, terms)


def _expected(rows, terms, state):
    """Residuals (n, 3) that a state of these terms expects at the rows."""
    coef = np.roll(state.coef, 2 * len(terms.harmonics))
    found = np.empty_like(rows.y)
    for part in chunks(len(rows.X), _POSES):
        found[part] = factored_columns(rows.arm, rows.X[part], terms).dot(coef)
    return found


def model_of(rows, terms, state):
    """`LinearModel` of a state: harmonics by joint, then the other columns.

    The harmonics of `terms` are the candidates of the state.
    """
    offered, terms = terms.harmonics, terms._replace(harmonics=terms.harmonics[state.pairs])
    n_waves = 2 * len(state.pairs)
    order = np.roll(np.arange(len(state.coef)), n_waves)
    half = state.half[order]
    families = np.unique(term_names(rows.arm, terms)[1]).tolist()
    line = len(FAMILIES) - 2
    families += [line] * bool(len(offered)) + [line + 1] * state.with_field
    model = LinearModel(
        arm=rows.arm,
        terms=terms,
        coef=state.coef[order],
        half=half,
        noise_variance=state.noise_variance,
        prior_sd={FAMILIES[f]: float(np.sqrt(state.variance[f])) for f in families},
        offsets=rows.codes is not None and not rows.known,
        n_determined=float(state.determined.sum()),
        log_bayes_factor=state.gains,
        gauge_free_half=half,
        fading_half=half,
    )
    poses = rows.X, rows.weights, rows.codes
    return constrained(model, *poses, keep_scale=not rows.lengths)
