r"""Linear regression whose structures are chosen by evidence: sums, priors and posterior.

The model is :math:`y = A w + H u + e` with noise variance :math:`s^2`. The columns A are always in;
those of H are candidates in pairs, such as the cosine and the sine of one harmonic, of which few
are taken. A structure is some columns with one prior variance and a price:

- a family: columns of A that share one variance;
- a line: one pair of H, with the variance that all lines share;
- the field: many pairs of H together, with one variance times a share of each pair.

A column that belongs to several structures has the sum of their variances. Variances and noise
follow MacKay's fixed point [1]_: the sum of squares of a structure's coefficients over the number
of them that the data determine.

References
----------
.. [1] D. J. C. MacKay, "Bayesian interpolation", Neural Computation 4(3), 1992, 415-447.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import LinAlgError, cho_solve, cholesky, lapack

# Steps of the variances at most. They stop by the evidence: few problems take more than 30.
MAX_STEPS = 100
# Rise of the evidence, in nats, that is not worth another step: it moves no coefficient by more
# than a few per cent of its standard deviation.
SMALL_RISE = 0.01
# Noise is known beforehand as three observations would show it, at a hundredth of the square of y:
# with fewer rows than columns the evidence else grows without limit as all noise is explained away.
_ASSUMED_ROWS, _ASSUMED_SHARE = 3.0, 0.01
# Least share of the first guess that a variance falls to. Least mean square of residuals, whose
# square is still above zero in floating point. Least noise variance, relative to the mean square of
# y. These three only keep arithmetic from underflow and overflow.
_LEAST_SHARE, _NO_NOISE, _LEAST_NOISE = 1e-8, 1e-120, 1e-12
# Halvings of a step that lowers the evidence.
_HALVINGS = 5
# Share of the largest eigenvalue of the always-in columns' scaled Gram matrix below which a
# direction is rounding, not data; size of a column, relative to the largest, that is rounding, too.
_ROUNDING, _NO_SIZE = 1e-12, 1e-7
# Lines are guessed to be so many, for the first choice.
_GUESSED_LINES = 12
# Shares of its diagonal that are added to a matrix, one after another, until it has a factor.
_RIDGES = (1e-14, 1e-13, 1e-12, 1e-11, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6)
# Rows of the candidates' Gram matrix that are summed up together: those of the next best candidates
# are likely asked for next. 32 to 96 take the same time (``benchmarks/bench_speed.py fit``).
_BATCH = 48


class Extra(NamedTuple):
    """Observations beside the sums: ``rows @ coefficients`` is `values` and noise."""

    rows: np.ndarray  # (n, 2 n_pairs + m) the candidates' columns, then those that are always in
    values: np.ndarray  # (n,)
    variance: np.ndarray  # (n,) that they have by themselves
    share: np.ndarray  # (n,) of the noise variance that comes on top


class Sums(NamedTuple):
    """Inner products of the columns that are always in (A), of the candidates (H) and of y.

    The columns of H are the first and the second of the first pair, then those of the second, and
    so on.
    """

    gram: np.ndarray  # (m, m) A'A
    moment: np.ndarray  # (m,) A'y
    cross: np.ndarray  # (m, 2 n_pairs) A'H
    own: np.ndarray  # (3, n_pairs) of each pair: first'first, second'second, first'second
    candidate_moment: np.ndarray  # (2 n_pairs,) H'y
    square: float  # y'y
    n_observations: float
    rows: Callable[..., np.ndarray]  # (pairs, likely, beside) to rows of H'H, see `GramRows`
    extra: Extra | None = None  # what was observed beside them


class Structures(NamedTuple):
    """What may be in a model, and what it costs."""

    family: np.ndarray  # (m,) family of each column that is always in
    price: np.ndarray  # (n_pairs,) of a line, in nats
    share: np.ndarray | None  # (n_pairs,) of the field's variance; None: there is no field
    field_price: float  # in nats
    given: np.ndarray  # (n_families + 2,) variances that are known, NaN for those to be found
    largest: float  # variance beyond which a coefficient makes no sense


class State(NamedTuple):
    """A choice of structures, its posterior and what it is worth."""

    lines: np.ndarray  # (n_lines,) pairs that are lines, sorted
    with_field: bool
    pairs: np.ndarray  # (k,) pairs of lines and field, sorted
    coef: np.ndarray  # (m + 2 k,) of the columns that are always in, then of the pairs
    half: np.ndarray  # (m + 2 k, r) with covariance = half @ half.T
    variance: np.ndarray  # (n_families + 2,) of the structures
    prior: np.ndarray  # (m + 2 k,) variance of each coefficient before any data
    noise_variance: float
    log_evidence: float  # up to a constant of the data
    determined: np.ndarray  # (m + 2 k,) share of each coefficient that the data determine

    @property
    def gains(self) -> np.ndarray:
        """Rise of the log evidence by each pair, beside all others, (k,)."""
        m = len(self.coef) - 2 * len(self.pairs)
        half = self.half[m:].reshape(-1, 2, max(self.half.shape[1], 1))
        return gains_of(self.coef[m:], half @ half.swapaxes(1, 2), self.prior[m:])

    def gain_of(self, columns: np.ndarray) -> float:
        """Rise of the log evidence by some columns together, beside all others, in nats.

        With w their coefficients, S their covariance and v their prior variances that is
        ``(w' inv(S) w + log det(S / v)) / 2``.
        """
        scale = np.sqrt(self.prior[columns])
        half, w = self.half[columns] / scale[:, None], self.coef[columns] / scale
        covariance = half @ half.T
        fit = w @ np.linalg.solve(covariance, w)
        return float(0.5 * (fit + np.linalg.slogdet(covariance)[1]))


def gains_of(coef: np.ndarray, blocks: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Rise of the log evidence by each of k pairs, beside all others, (k,).

    By their coefficients (2 k,), the blocks (k, 2, 2) of the posterior covariance, and the prior
    variances (2 k,).
    """
    coef = coef.reshape(-1, 2)
    fit = np.einsum("bi,bij,bj->b", coef, np.linalg.inv(blocks), coef)
    return 0.5 * (fit + np.linalg.slogdet(blocks)[1] - 2 * np.log(prior[::2]))


def combined(parts: Sequence[Sums], signs: Sequence[float]) -> Sums:
    """Sums of the same columns times numbers, added up, without what was observed beside them."""

    def total(values) -> Any:
        whole = signs[0] * values[0]
        for sign, value in zip(signs[1:], values[1:], strict=True):
            whole += value if sign == 1 else sign * value
        return whole

    def sum_up(pairs):
        return total([part.rows(pairs) for part in parts])

    whole = [total(values) for values in zip(*(part[:7] for part in parts), strict=True)]
    return Sums._make([*whole, GramRows(sum_up, parts[0].cross.shape[1]), None])


def sums_of_pairs(sums: Sums, pairs: np.ndarray) -> Sums:
    """The same sums with some of the candidates only."""
    columns, n, extra = columns_of(pairs), sums.cross.shape[1], sums.extra
    if extra is not None:
        always = np.arange(n, extra.rows.shape[1])
        extra = extra._replace(rows=extra.rows[:, np.r_[columns, always]])
    return sums._replace(
        cross=sums.cross[:, columns],
        own=sums.own[:, pairs],
        candidate_moment=sums.candidate_moment[columns],
        rows=GramRows(lambda some: sums.rows(pairs[some], (), pairs), len(columns)),
        extra=extra,
    )


def sums_of_gram(gram: np.ndarray, n_pairs: int, n_observations: float) -> Sums:
    """`Sums` of one Gram matrix of the candidates, of the columns that are always in, and of y."""
    n = 2 * n_pairs
    waves, (first, second) = gram[:n, :n], np.arange(n).reshape(-1, 2).T
    return Sums(
        gram=gram[n:-1, n:-1],
        moment=gram[n:-1, -1],
        cross=gram[n:-1, :n],
        own=np.array([waves[first, first], waves[second, second], waves[first, second]]),
        candidate_moment=gram[:n, -1],
        square=float(gram[-1, -1]),
        n_observations=n_observations,
        rows=GramRows(lambda pairs: waves[columns_of(pairs)], n),
    )


def columns_of(pairs: ArrayLike) -> np.ndarray:
    """First and second columns of some candidates."""
    pairs = np.asarray(pairs, dtype=int)
    return np.stack([2 * pairs, 2 * pairs + 1], axis=1).ravel()


class GramRows:
    """Rows of the candidates' Gram matrix, summed up when first asked for and kept.

    `sum_up` makes of pairs (k,) their rows (2 k, n_columns).
    """

    def __init__(self, sum_up: Callable[[np.ndarray], np.ndarray], n_columns: int) -> None:
        self._sum_up = sum_up
        self._place: dict[int, int] = {}
        self._rows = np.empty((0, n_columns))

    def __call__(
        self, pairs: np.ndarray, likely: Sequence[int] = (), beside: np.ndarray | None = None
    ) -> np.ndarray:
        """Products of `pairs` with those of `beside`, (2 b, 2 k); with all where it is None.

        Those of `likely` are summed up on the way.
        """
        wanted = np.asarray(pairs, dtype=int).tolist()
        missing = [p for p in wanted if p not in self._place]
        if missing:
            missing += [p for p in likely if p not in self._place and p not in missing]
            self._keep(missing[: max(_BATCH, len(wanted))])
        rows = columns_of([self._place[p] for p in wanted])
        if beside is None:
            return self._rows[rows]
        return self._rows.view(complex)[np.ix_(rows, beside)].view(float)  # both columns at once

    def _keep(self, pairs):
        known, needed = len(self._place), len(self._place) + len(pairs)
        found = self._sum_up(np.array(pairs))
        if not known:
            self._rows = np.ascontiguousarray(found)
        else:
            if 2 * needed > len(self._rows):  # to the double: each row is copied once or twice
                larger = np.empty((2 * max(needed, 2 * known), self._rows.shape[1]))
                larger[: 2 * known] = self._rows[: 2 * known]
                self._rows = larger
            self._rows[2 * known : 2 * needed] = found
        self._place |= {pair: known + i for i, pair in enumerate(pairs)}


class Problem:
    """Sums and known structures: what a posterior is found from.

    `line` is the index of the variance that lines share; that of the field is the next one.
    """

    def __init__(self, sums: Sums, structures: Structures) -> None:
        self.sums: Sums = _without_rounding(sums)
        self.structures: Structures = structures
        self.line: int = len(structures.given) - 2
        self.n: float = max(sums.n_observations, 1.0)
        self.start: float = max(sums.square / self.n, _NO_NOISE)
        self.assumed: float = _ASSUMED_SHARE * self.start
        self.known: np.ndarray = np.isfinite(structures.given)
        self.guess: np.ndarray = self._first_guess()
        self._last = None  # pairs and products: most choices have the columns of the last one

    def _first_guess(self):
        """Variances at which the columns of a structure together would explain all there is."""
        structures = self.structures
        variance = np.where(self.known, structures.given, 1.0)
        diagonal, family = self.sums.gram.diagonal(), structures.family
        sizes = {f: diagonal[family == f].sum() for f in np.unique(family)}
        if self.sums.own.size:
            sizes[self.line] = _GUESSED_LINES * self.sums.own[:2].sum(axis=0).mean()
        for f, size in sizes.items():
            if not self.known[f]:
                variance[f] = self.start * self.n / size if size > 0 else 1.0
        return variance

    def nothing(self) -> State:
        """The state without lines and field, with the variances that it has the evidence for."""
        variance = np.minimum(self.guess, self.structures.largest)
        start = self.state(np.empty(0, dtype=int), False, variance, self.start)
        return self.with_variances(start)

    def pairs_and_shares(
        self, lines: np.ndarray, with_field: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Pairs that are in, sorted, and the share (n_structures, m + 2 k) that each column has."""
        structures, pairs, line = self.structures, lines, self.line
        share = structures.share if with_field else None
        if share is not None:
            pairs = np.union1d(lines, np.flatnonzero(share > 0)).astype(int)
        m = len(structures.family)
        shares = np.zeros((line + 2, m + 2 * len(pairs)))
        shares[structures.family, np.arange(m)] = 1.0
        shares[line, m:] = np.repeat(np.isin(pairs, lines, assume_unique=True), 2)
        if share is not None:
            shares[line + 1, m:] = np.repeat(share[pairs], 2)
        return pairs, shares

    def state(
        self, lines: np.ndarray, with_field: bool, variance: np.ndarray, noise: float
    ) -> State:
        """Posterior and evidence at given variances."""
        pairs, prior, S, r, fixed = self.equations(lines, with_field, variance, noise)
        # The last column is eliminated first: those that are always in then have the shortest rows
        # of `half`, which makes standard deviations cheap.
        S = S[::-1, ::-1]
        coef, half, volume = r, S, np.log(prior).sum()
        if len(S):
            root = root_of(S.T, lower=True)  # of which S.T is the same, in the order of Fortran
            coef = cho_solve((root, True), r[::-1], check_finite=False)[::-1]
            volume += 2 * np.log(root.diagonal()).sum()
            root[:] = lapack.dtrtri(root, lower=1, overwrite_c=1)[0]
            half = root.T[::-1]
        return State(
            lines=lines,
            with_field=with_field,
            pairs=pairs,
            coef=coef,
            half=half,
            variance=variance,
            prior=prior,
            noise_variance=float(noise),
            log_evidence=float(-0.5 * (fixed - r @ coef + volume)),
            determined=1 - np.einsum("ij,ij->i", half, half) / prior,
        )

    def with_lines(self, state: State, lines: np.ndarray) -> State:
        """Other lines at the variances of a state, beside its field."""
        return self.state(lines, state.with_field, state.variance, state.noise_variance)

    def equations(
        self, lines: np.ndarray, with_field: bool, variance: np.ndarray, noise: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
        """Pairs that are in, prior variances, and the equations of the coefficients.

        The latter are the penalised Gram matrix, the products with y, and what of minus twice the
        log evidence depends on the noise alone.
        """
        pairs, shares = self.pairs_and_shares(lines, with_field)
        prior = variance @ shares
        gram, moment = self._products(pairs)
        S, r, extra = gram / noise, moment / noise, self.sums.extra
        fixed = (self.n + _ASSUMED_ROWS) * np.log(noise)
        fixed += (self.sums.square + _ASSUMED_ROWS * self.assumed) / noise
        if extra is not None:
            precision = 1 / (extra.variance + noise * extra.share)
            n_waves, columns = self.sums.cross.shape[1], columns_of(pairs)
            rows = extra.rows[:, np.r_[n_waves : extra.rows.shape[1], columns]]
            weighted = rows.T * precision
            S += weighted @ rows
            r += weighted @ extra.values
            fixed += precision @ np.square(extra.values) - np.log(precision).sum()
        S[np.diag_indices(len(S))] += 1 / prior
        return pairs, prior, S, r, fixed

    def _products(self, pairs):
        """Gram matrix of the columns that are always in and of some pairs, and products with y."""
        if self._last is not None and np.array_equal(pairs, self._last[0]):
            return self._last[1:]
        sums, m, columns = self.sums, len(self.structures.family), columns_of(pairs)
        gram = np.empty((m + len(columns), m + len(columns)))
        gram[:m, :m], gram[:m, m:] = sums.gram, sums.cross[:, columns]
        gram[m:, :m] = gram[:m, m:].T
        rows = sums.rows(pairs, (), pairs)
        np.add(rows, rows.T, out=gram[m:, m:])
        gram[m:, m:] *= 0.5
        moment = np.concatenate([sums.moment, sums.candidate_moment[columns]])
        self._last = pairs, gram, moment
        return gram, moment

    def with_variances(self, state: State, max_steps: int = MAX_STEPS) -> State:
        """The same choice at the variances and the noise of highest evidence."""
        for _ in range(max_steps):
            last, state = state, self._step(state)
            if not state.log_evidence > last.log_evidence + SMALL_RISE:
                return max(state, last, key=lambda one: one.log_evidence)
        return state

    def _step(self, last):
        """MacKay's step, half of it and so on (in logarithms) where the evidence falls."""
        variance, noise = self._fixed_point(last)
        least = _LEAST_SHARE * self.guess
        variance = np.clip(variance, least, np.maximum(least, self.structures.largest))
        variance = np.where(self.known, self.structures.given, variance)
        noise, found = max(noise, _LEAST_NOISE * self.start), last
        for _ in range(_HALVINGS):
            found = self.state(last.lines, last.with_field, variance, noise)
            if found.log_evidence >= last.log_evidence:
                break
            variance = np.sqrt(variance * last.variance)
            noise = np.sqrt(noise * last.noise_variance)
        return found

    def _fixed_point(self, state):
        """MacKay's variances of the structures and of the noise."""
        shares = self.pairs_and_shares(state.lines, state.with_field)[1]
        scale = np.maximum(state.variance, _NO_NOISE)
        squares = scale * (shares @ np.square(state.coef / state.prior))
        determined = shares @ (state.determined / state.prior)
        there = shares.any(axis=1)
        found = scale * evidence_variance(squares, np.maximum(scale * determined, 1e-12))
        variance = np.where(there, found, state.variance)
        gram, moment = self._products(state.pairs)
        rss = self.sums.square - 2 * state.coef @ moment + state.coef @ gram @ state.coef
        free = max(self.n - state.determined.sum(), 0.0)
        return variance, evidence_variance(max(rss, 0.0), free, self.assumed, _ASSUMED_ROWS)


def refit(sums: Sums, structures: Structures, state: State, lines: np.ndarray, steps: int) -> State:
    """A state of other sums with these lines, whose variances follow the data for some steps."""
    problem = Problem(sums, structures)
    return problem.with_variances(problem.with_lines(state, lines), steps)


def evidence_variance(
    squares: float | np.ndarray,
    determined: float | np.ndarray,
    guess: float = 0.0,
    counts: float = 0.0,
) -> Any:
    """Variance of highest evidence by MacKay's fixed point, with a guess that few data keep.

    `squares` is the sum of squares of what has this variance, `determined` how many of them the
    data determine, `counts` how many the `guess` is worth.
    """
    return (squares + counts * guess) / (determined + counts)


def root_of(matrix: np.ndarray, lower: bool = False) -> np.ndarray:
    """Cholesky factor; where rounding has eaten what the priors add, of slightly more.

    LinAlgError, a ValueError, says what could not be factored.
    """
    diagonal = np.diag_indices(len(matrix))
    for more in _RIDGES:
        with suppress(LinAlgError):
            return cholesky(matrix, lower=lower, check_finite=False)
        matrix = matrix.copy()
        matrix[diagonal] *= 1 + more
    try:
        return cholesky(matrix, lower=lower, check_finite=False)
    except LinAlgError as error:
        own = matrix[diagonal]
        raise LinAlgError(
            f"The equations of {len(own)} coefficients have no solution: their matrix, of diagonal "
            f"{own.min():.3g} to {own.max():.3g}, has no Cholesky factor ({error}). Either one row "
            "outweighs all others, or the sums are not those of the columns."
        ) from None


def _without_rounding(sums):
    """Sums without the directions of the always-in columns that hold only rounding.

    Where the data do not show a direction, the exact sums vanish along it; the computed ones do not
    quite, and a wide prior would take that for information.
    """
    size = np.sqrt(np.maximum(sums.gram.diagonal(), 0.0))
    if not size.any():
        return sums
    size = np.maximum(size, _NO_SIZE * size.max())
    value, vectors = np.linalg.eigh(sums.gram / np.outer(size, size))
    is_seen = value > _ROUNDING * value[-1]
    if is_seen.all():
        return sums
    root = size[:, None] * vectors[:, is_seen] * np.sqrt(value[is_seen])
    unseen = vectors[:, ~is_seen]
    to_unseen, unseen = unseen.T / size, size[:, None] * unseen
    moment = sums.moment - unseen @ (to_unseen @ sums.moment)
    cross = unseen @ (to_unseen @ sums.cross)
    np.subtract(sums.cross, cross, out=cross)
    return sums._replace(gram=root @ root.T, moment=moment, cross=cross)
