r"""Linear regression whose structures are chosen by evidence.

The model is :math:`y = A w + H u + e` with noise variance :math:`s^2`. The columns A are always in;
those of H are candidates in pairs, such as the cosine and the sine of one harmonic, of which few
are taken. A structure is some columns with one prior variance and a price:

- a family: columns of A that share one variance;
- a line: one pair of H, with the variance that all lines share;
- the field: many pairs of H together, with one variance times a share of each pair.

A column that belongs to several structures has the sum of their variances. Variances and noise
follow MacKay's fixed point [1]_: the sum of squares of a structure's coefficients over the number
of them that the data determine.

A line joins if that raises the log evidence by more than its price. Selection is that of orthogonal
least squares, on the penalised Gram matrix instead of the columns, a pair at a time. Choice and
variances take turns: lines join at the variances at hand, the variances follow the choice, and
lines that the others have made needless leave, while the evidence less the prices rises.

Lines that were not taken are not known to be absent: that each is small is all that is known. The
field lets many pairs join together, each with a small share of one variance. It stays if the
evidence less the prices rises by its price.

References
----------
.. [1] D. J. C. MacKay, "Bayesian interpolation", Neural Computation 4(3), 1992, 415-447.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import LinAlgError, cho_solve, cholesky, lapack, solve_triangular
from scipy.linalg.blas import dtrsm

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
# Lines are guessed to be so many, for the first choice.
_GUESSED_LINES = 12
# Shares of its diagonal that are added to a matrix, one instead of another, until it has a factor.
_RIDGES = (0.0, 1e-14, 1e-13, 1e-12, 1e-11, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6)
# Rows of the candidates' Gram matrix that are summed up together: those of the next best candidates
# are likely asked for next. 32 to 96 take the same time (``benchmarks/bench_speed.py fit``).
_BATCH = 48
# Steps of the variances between two looks at which lines have become needless: 1 and 2 end alike.
_STEPS_WHILE_LEAVING = 1
# Sizes of the field's variance at which its search may begin, relative to that of the lines.
_FIELD_SIZES = 10.0 ** np.arange(-4.0, 1.0)


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

    @classmethod
    def of_gram(cls, gram: np.ndarray, n_pairs: int, n_observations: float) -> Self:
        """Of one Gram matrix of the candidates, of the columns that are always in, and of y."""
        n = 2 * n_pairs
        waves, (first, second) = gram[:n, :n], np.arange(n).reshape(-1, 2).T
        return cls(
            gram=gram[n:-1, n:-1],
            moment=gram[n:-1, -1],
            cross=gram[n:-1, :n],
            own=np.array([waves[first, first], waves[second, second], waves[first, second]]),
            candidate_moment=gram[:n, -1],
            square=float(gram[-1, -1]),
            n_observations=n_observations,
            rows=GramRows(lambda pairs: waves[pair_columns(pairs)], n),
        )

    def of_pairs(self, pairs: np.ndarray) -> Self:
        """The same sums with some of the candidates only."""
        columns, n, extra = pair_columns(pairs), self.cross.shape[1], self.extra
        if extra is not None:
            always = np.arange(n, extra.rows.shape[1])
            extra = extra._replace(rows=extra.rows[:, np.r_[columns, always]])
        return self._replace(
            cross=self.cross[:, columns],
            own=self.own[:, pairs],
            candidate_moment=self.candidate_moment[columns],
            rows=GramRows(lambda some: self.rows(pairs[some], (), pairs), len(columns)),
            extra=extra,
        )


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
        return gains_of(self.coef[m:].reshape(-1, 2), half @ half.swapaxes(1, 2), self.prior[m::2])

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

    By their coefficients (k, 2), the blocks (k, 2, 2) of the posterior covariance, and the prior
    variances (k,).
    """
    fit = np.einsum("bi,bij,bj->b", coef, np.linalg.inv(blocks), coef)
    return 0.5 * (fit + np.linalg.slogdet(blocks)[1] - 2 * np.log(prior))


def combined(parts: Sequence[Sums], signs: Sequence[float]) -> Sums:
    """Sums of the same columns times numbers, added up, without what was observed beside them."""

    def total(values) -> Any:
        return sum(sign * value for sign, value in zip(signs, values, strict=True))

    whole = [total(values) for values in zip(*(part[:7] for part in parts), strict=True)]
    rows = GramRows(
        lambda pairs: total([part.rows(pairs) for part in parts]), parts[0].cross.shape[1]
    )
    return Sums._make([*whole, rows, None])


def pair_columns(pairs: ArrayLike) -> np.ndarray:
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
            missing = missing[: max(_BATCH, len(wanted))]
            self._place |= {pair: i for i, pair in enumerate(missing, start=len(self._place))}
            self._rows = np.concatenate([self._rows, self._sum_up(np.array(missing))])
        rows = pair_columns([self._place[p] for p in wanted])
        if beside is None:
            return self._rows[rows]
        return self._rows.view(complex)[np.ix_(rows, beside)].view(float)  # both columns at once


class Problem:
    """Sums and known structures: what a posterior is found from.

    `line` is the index of the variance that lines share; that of the field is the next one.
    """

    def __init__(self, sums: Sums, structures: Structures) -> None:
        self.sums: Sums = sums
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
        sizes = np.zeros(self.line + 2)
        np.add.at(sizes, self.structures.family, self.sums.gram.diagonal())
        if self.sums.own.size:
            sizes[self.line] = _GUESSED_LINES * self.sums.own[:2].sum(axis=0).mean()
        guess = np.divide(self.start * self.n, sizes, out=np.ones(len(sizes)), where=sizes > 0)
        return np.where(self.known, self.structures.given, guess)

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
            n_waves, columns = self.sums.cross.shape[1], pair_columns(pairs)
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
        sums, m, columns = self.sums, len(self.structures.family), pair_columns(pairs)
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
        determined = scale * (shares @ (state.determined / state.prior))
        found = scale * squares / np.maximum(determined, 1e-12)
        variance = np.where(shares.any(axis=1), found, state.variance)
        gram, moment = self._products(state.pairs)
        rss = self.sums.square - 2 * state.coef @ moment + state.coef @ gram @ state.coef
        free = max(self.n - state.determined.sum(), 0.0)
        noise = (max(rss, 0.0) + _ASSUMED_ROWS * self.assumed) / (free + _ASSUMED_ROWS)
        return variance, noise

    def net_evidence(self, state: State) -> float:
        """Log evidence of a state less the prices of its lines."""
        return state.log_evidence - self.structures.price[state.lines].sum()

    def search(self, state: State | None = None) -> State:
        """Lines that are worth their price, and their variances.

        A state of nearly the same data says where the search begins: at its variances and its
        lines; if the field is in, it stays.
        """
        if state is None:
            variance = np.minimum(self.guess, self.structures.largest)
            best = self.state(np.empty(0, dtype=int), False, variance, self.start)
            best = self.with_variances(best)
        else:
            best = self._settled(self.with_lines(state, state.lines))
        while True:
            lines = self._extended(best)
            if len(lines) == len(best.lines):
                return best
            last, best = best, self._settled(self.with_lines(best, lines))
            if not self.net_evidence(best) > self.net_evidence(last) + SMALL_RISE:
                return last

    def search_at(self, state: State) -> State:
        """Lines worth their price at the variances of a state of more data, beside its field.

        The choice begins at the lines of the state; those that are needless here leave at the end.
        """
        return self._pruned(self.with_lines(state, self._extended(state)))

    def with_field_if_worth(self, state: State, of_field: "Problem", alone: State) -> State:
        """The choice beside the field, where the data speak for it; else the state of lines alone.

        It is searched for where its rise of the evidence, beside all that is there, and the prices
        of those lines that it may replace come to its own price.
        `of_field` is the problem with no other candidates than the lines and the field's, which
        costs less, and `alone` the state in it.
        """
        structures = self.structures
        assert structures.share is not None
        size, rise = of_field._first_size(alone)
        saved = structures.price[state.lines] @ (structures.share[state.lines] > 0)
        if rise + saved < structures.field_price:
            return state
        variance = np.append(state.variance[:-1], size)
        found = self.search(state._replace(with_field=True, variance=variance))
        least = self.net_evidence(self.with_variances(state)) + structures.field_price
        return found if self.net_evidence(found) >= least else state

    def _extended(self, state):
        """The lines of a state, and those that raise the evidence by more than their price.

        With S the penalised Gram matrix of what is left of the columns beside the chosen ones and r
        their products with what is left of y, a pair b raises the log evidence by
        r_b' inv(S_b) r_b / 2 - log det(v S_b) / 2, v its prior variance.

        S is never formed nor downdated as a whole: as in a pivoted Cholesky factorisation, the rows
        of the factor and the pairs' own 2 x 2 blocks suffice.
        """
        try:
            left = _Leftover(self, state)
        except LinAlgError:  # so little noise that only rounding is left of the others
            return state.lines
        chosen, price = state.lines.tolist(), self.structures.price[left.free]
        alive = np.ones(len(left.free), dtype=bool)
        while alive.any():
            gain, sound = left.gains()
            alive &= sound
            net = np.where(alive, gain - price, -np.inf)
            best = int(np.argmax(net))
            if not net[best] > 0:
                break
            likely = np.argsort(-net, kind="stable")[: min(_BATCH, np.count_nonzero(net > 0))]
            alive[best] = False
            try:
                left.take(best, likely.tolist())
            except LinAlgError:
                continue
            chosen.append(int(left.free[best]))
        return np.sort(np.array(chosen, dtype=int))

    def _settled(self, state):
        """The state at its own variances, without lines that are needless there.

        The variances follow a few steps at a time while lines leave, and settle at the end.
        """
        steps = _STEPS_WHILE_LEAVING
        while True:
            state = self.with_variances(state, steps)
            left = self._pruned(state)
            if len(left.lines) < len(state.lines):
                state, steps = left, _STEPS_WHILE_LEAVING
            elif steps < MAX_STEPS:
                steps = MAX_STEPS
            else:
                return state

    def _pruned(self, state):
        """The state without lines whose loss the others make good; at its variances.

        All of them but the best go at once, then that one where it is needless still: each of two
        lines that are the same is needless beside the other.
        """
        lines, price = state.lines, self.structures.price[state.lines]
        is_line = np.isin(state.pairs, lines, assume_unique=True)
        own = len(self.structures.family) + pair_columns(np.flatnonzero(is_line)).reshape(-1, 2)
        half, prior = state.half[own], state.prior[own]
        coef, blocks = state.coef[own], half @ half.swapaxes(1, 2)
        out, seen = np.zeros(len(lines), dtype=bool), None
        while True:
            net = np.where(out, np.inf, gains_of(coef, blocks, prior[:, 0]) - price)
            needless = np.count_nonzero(net <= 0)
            if not needless:
                return state if seen is None else self._without(state, lines[~out], *seen)
            out[np.argsort(net, kind="stable")[: max(needless - 1, 1)]] = True
            # To lose lines is to observe that their coefficients have a smaller variance before
            # the data, that of the field, or that they are 0: see `_without`.
            noise = np.maximum(prior[out] * (prior[out] / state.variance[self.line] - 1), 0.0)
            volume, noise = prior[out].ravel() + noise.ravel(), np.diag(np.sqrt(noise.ravel()))
            unit, root = np.linalg.qr(np.concatenate([state.half[own[out].ravel()].T, noise]))
            along = unit[: -len(noise)]
            pull = solve_triangular(root, state.coef[own[out]].ravel(), trans="T")
            volume = 2 * np.log(np.abs(root.diagonal())) - np.log(volume)
            seen = along, pull, 0.5 * (pull @ pull + volume.sum())
            explained = half @ along
            coef = state.coef[own] - explained @ pull
            blocks = half @ half.swapaxes(1, 2) - explained @ explained.swapaxes(1, 2)
            blocks[out] = np.eye(2)

    def _without(self, state, lines, along, pull, fall):
        """The state with the `lines` that are left, where others have been observed to be nothing.

        In units of `half` the observation takes ``along @ along.T`` from the covariance, moves the
        mean by ``-along @ pull``, and lowers the log evidence by `fall`. This takes half the time
        of the posterior anew.
        """
        unit, size, _ = np.linalg.svd(along, full_matrices=False)
        taken = 1 - np.sqrt(np.maximum(1 - size * size, 0.0))
        half = state.half - ((state.half @ unit) * taken) @ unit.T
        pairs, shares = self.pairs_and_shares(lines, state.with_field)
        m, prior = len(self.structures.family), state.variance @ shares
        kept = np.r_[:m, m + pair_columns(np.flatnonzero(np.isin(state.pairs, pairs)))]
        return state._replace(
            lines=lines,
            pairs=pairs,
            coef=(state.coef - state.half @ (along @ pull))[kept],
            half=half[kept],
            prior=prior,
            log_evidence=state.log_evidence - float(fall),
            determined=1 - np.square(half[kept]).sum(axis=1) / prior,
        )

    def _first_size(self, state):
        """Variance of the field beside a state's families, and the rise of the evidence by it.

        With S what is left of the penalised Gram matrix of its columns, each times the root of its
        share, and r of their products with y, that is ``(v r' inv(I + v S) r - log det(I + v S)) /
        2`` at the variance v.
        """
        try:
            left = _Leftover(self, state)
        except LinAlgError:  # so little noise that only rounding is left
            return 1.0, -np.inf
        S, r, share = left.gram(), left.r, np.asarray(self.structures.share)
        root = np.repeat(np.sqrt(share[left.free]), 2)
        S, r = S * root * root[:, None], r * root
        best = 1.0, -np.inf
        for v in state.variance[self.line] * _FIELD_SIZES:
            try:
                factor = root_of(np.eye(len(S)) + v * S)
            except LinAlgError:  # the rounding of large numbers
                break
            seen = solve_triangular(factor, r, trans="T", check_finite=False)
            rise = 0.5 * v * (seen @ seen) - np.log(factor.diagonal()).sum()
            best = max(best, (v, float(rise)), key=lambda one: one[1])
        return best


def root_of(matrix: np.ndarray, lower: bool = False) -> np.ndarray:
    """Cholesky factor; where rounding has eaten what the priors add, of slightly more.

    LinAlgError, a ValueError, says what could not be factored.
    """
    own, said = matrix.diagonal(), ""
    for more in _RIDGES:
        try:
            shifted = matrix + np.diag(more * own) if more else matrix
            return cholesky(shifted, lower=lower, check_finite=False)
        except LinAlgError as error:
            said = str(error)
    raise LinAlgError(
        f"The equations of {len(own)} coefficients have no solution: their matrix, of diagonal "
        f"{own.min():.3g} to {own.max():.3g}, has no Cholesky factor ({said}). Either one row "
        "outweighs all others, or the sums are not those of the columns."
    )


class _Leftover:
    """What the columns that are in leave of the candidates, at the variances of a state.

    Arrays over candidates hold those that are not in at the beginning, `free`: of others nothing is
    left, and nothing is asked.
    """

    def __init__(self, problem, state):
        sums, noise = problem.sums, state.noise_variance
        self.sums, self.noise = sums, noise
        choice = state.lines, state.with_field, state.variance, noise
        pairs, _, S, r, _ = problem.equations(*choice)
        self.free = np.setdiff1d(np.arange(sums.own.shape[1]), pairs)
        self.prior = state.variance[problem.line]
        columns, m = pair_columns(self.free), len(sums.gram)
        self.r = sums.candidate_moment[columns] / noise
        self.own = sums.own[:, self.free] / noise + np.array([[1.0], [1.0], [0.0]]) / self.prior
        self.size = len(S)
        self.factor = np.empty((self.size + 64, len(columns)))
        np.take(sums.cross, columns, axis=1, out=self.factor[:m], mode="clip")
        self.factor[m : self.size] = sums.rows(pairs, (), self.free)
        self.extra = None
        if sums.extra is not None:
            scale = 1 / np.sqrt(sums.extra.variance + noise * sums.extra.share)
            rows, waves = sums.extra.rows * scale[:, None], pair_columns(pairs)
            self.extra = rows[:, columns]
            known = rows[:, np.r_[sums.cross.shape[1] : rows.shape[1], waves]]
            self.factor[: self.size] += noise * (known.T @ self.extra)
            first, second = self.extra[:, ::2], self.extra[:, 1::2]
            both = (first, first), (second, second), (first, second)
            self.own += [(a * b).sum(axis=0) for a, b in both]
            self.r += self.extra.T @ (sums.extra.values * scale)
        if self.size and len(columns):
            root = root_of(S)
            # The transpose is in Fortran order: the factor is solved for in place.
            dtrsm(1 / noise, root, self.factor[: self.size].T, side=1, overwrite_b=1)
            self._explain(self.factor[: self.size], solve_triangular(root, r, trans="T"))

    def _explain(self, rows, solved):
        """Take off what rows of the factor explain; `solved` are their products with y."""
        first, second = rows[:, ::2], rows[:, 1::2]
        squares = np.einsum("kc,kc->c", rows, rows)
        self.own -= [squares[::2], squares[1::2], np.einsum("kc,kc->c", first, second)]
        self.r -= solved @ rows

    def gram(self):
        """What is left of the Gram matrix of all candidates."""
        known = self.factor[: self.size]
        S = self.sums.rows(self.free, (), self.free) / self.noise - known.T @ known
        return S if self.extra is None else S + self.extra.T @ self.extra

    def take(self, candidate, likely):
        """Choose a candidate; LinAlgError if only rounding is left of it."""
        columns = [2 * candidate, 2 * candidate + 1]
        pairs, others = self.free[[candidate]], self.free[np.asarray(likely, dtype=int)]
        rows = self.sums.rows(pairs, others.tolist(), self.free) / self.noise
        if self.extra is not None:
            rows += self.extra[:, columns].T @ self.extra
        known = self.factor[: self.size]
        rows -= known[:, columns].T @ known
        block = rows[:, columns]
        root = cholesky(0.5 * (block + block.T) + np.eye(2) / self.prior, check_finite=False)
        solved = solve_triangular(root, self.r[columns], trans="T", check_finite=False)
        rows = solve_triangular(root, rows, trans="T", check_finite=False)
        if self.size + 2 > len(self.factor):
            self.factor = np.concatenate([self.factor, np.empty_like(self.factor)])
        self.factor[self.size : self.size + 2] = rows
        self.size += 2
        self._explain(rows, solved)

    def gains(self):
        """Rise of the log evidence by each free candidate, and whether it can be trusted."""
        (a, d, o), x, z = self.own, self.r[::2], self.r[1::2]
        determinant = a * d - o * o
        volume = determinant * self.prior**2
        # A posterior wider than the prior is rounding.
        sound = volume >= 1 - 1e-6
        safe = np.where(sound, determinant, 1.0)
        gain = 0.5 * (x * x * d - 2 * x * z * o + z * z * a) / safe
        return gain - 0.5 * np.log(np.where(sound, np.maximum(volume, 1.0), 1.0)), sound
