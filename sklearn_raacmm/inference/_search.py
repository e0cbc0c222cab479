r"""Which structures are in: lines by orthogonal least squares on the evidence, the field by a gate.

A line joins if that raises the log evidence by more than its price. Selection is that of orthogonal
least squares, on the penalised Gram matrix instead of the columns, a pair at a time. Choice and
variances take turns: lines join at the variances at hand, the variances follow the choice, and
lines that the others have made needless leave, while the evidence less the prices rises.

Lines that were not taken are not known to be absent: that each is small is all that is known. The
field lets many pairs join together, each with a small share of one variance. It stays if the
evidence less the prices rises by its price.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular
from scipy.linalg.blas import dtrsm

from sklearn_raacmm.inference._linear import (
    MAX_STEPS,
    SMALL_RISE,
    Problem,
    State,
    columns_of,
    gains_of,
    root_of,
)

# Rounds of the choice at most; it stops by the evidence, and few problems take more than five.
_MAX_ROUNDS = 10
# Steps of the variances between two looks at which lines have become needless: 1 and 2 end alike.
_STEPS_WHILE_LEAVING = 1
# Of the next best candidates, how many are named as likely to be asked for next.
_LIKELY = 48
# Sizes of the field's variance at which its search may begin, relative to that of the lines.
_FIELD_SIZES = 10.0 ** np.arange(-4.0, 1.0)


def search(problem: Problem, state: State | None = None) -> State:
    """Lines that are worth their price, and their variances.

    A state of nearly the same data says where the search begins: at its variances and its lines;
    if the field is in, it stays.
    """
    if state is None:
        best = problem.nothing()
    else:
        best = _settled(problem, problem.with_lines(state, state.lines))
    for _ in range(_MAX_ROUNDS):
        lines = _extended(problem, best)
        if len(lines) == len(best.lines):
            break
        last, best = best, _settled(problem, problem.with_lines(best, lines))
        if not net_evidence(problem, best) > net_evidence(problem, last) + SMALL_RISE:
            return last
    return best


def search_at(problem: Problem, state: State) -> State:
    """Lines worth their price at the variances of a state of more data, beside its field.

    The choice begins at the lines of the state; those that are needless here leave at the end.
    """
    return _pruned(problem, problem.with_lines(state, _extended(problem, state)))


def beside_field(problem: Problem, state: State, of_field: Problem, alone: State) -> State | None:
    """The choice beside the field, where the data speak for it against a state of lines alone.

    It is searched for where its rise of the evidence, beside all that is there, and the prices of
    those lines that it may replace come to its own price: else None. The state as it was where the
    search finds nothing better.
    `of_field` is the problem with no other candidates than the lines and the field's, which costs
    less, and `alone` the state in it.
    """
    structures = problem.structures
    assert structures.share is not None
    size, rise = _first_size(of_field, alone)
    saved = structures.price[state.lines] @ (structures.share[state.lines] > 0)
    if rise + saved < structures.field_price:
        return None
    variance = np.append(state.variance[:-1], size)
    found = search(problem, state._replace(with_field=True, variance=variance))
    least = net_evidence(problem, problem.with_variances(state)) + structures.field_price
    return found if net_evidence(problem, found) >= least else state


def net_evidence(problem: Problem, state: State) -> float:
    """Log evidence less the prices of the lines."""
    return state.log_evidence - problem.structures.price[state.lines].sum()


def _extended(problem, state):
    """The lines of a state and those that raise the evidence by more than their price beside them.

    With S the penalised Gram matrix of what is left of the columns beside the chosen ones and r
    their products with what is left of y, a pair b raises the log evidence by
    r_b' inv(S_b) r_b / 2 - log det(v S_b) / 2, v its prior variance.

    S is never formed nor downdated as a whole: as in a pivoted Cholesky factorisation, the factor's
    rows and the pairs' own 2 x 2 blocks suffice.
    """
    try:
        left = _Leftover(problem, state)
    except LinAlgError:  # so little noise that only rounding is left of the others
        return state.lines
    chosen, price = state.lines.tolist(), problem.structures.price[left.free]
    alive = np.ones(len(left.free), dtype=bool)
    while alive.any():
        gain, sound = left.gains()
        alive &= sound
        net = np.where(alive, gain - price, -np.inf)
        best = int(np.argmax(net))
        if not net[best] > 0:
            break
        likely = np.argsort(-net, kind="stable")[: min(_LIKELY, np.count_nonzero(net > 0))]
        alive[best] = False
        try:
            left.take(best, likely.tolist())
        except LinAlgError:
            continue
        chosen.append(int(left.free[best]))
    return np.sort(np.array(chosen, dtype=int))


def _settled(problem, state):
    """The state at its own variances, without lines that are needless there.

    The variances follow a few steps at a time while lines leave, and settle at the end.
    """
    steps = _STEPS_WHILE_LEAVING
    while True:
        state = problem.with_variances(state, steps)
        left = _pruned(problem, state)
        if len(left.lines) < len(state.lines):
            state, steps = left, _STEPS_WHILE_LEAVING
        elif steps < MAX_STEPS:
            steps = MAX_STEPS
        else:
            return state


def _pruned(problem, state):
    """The state without lines whose loss the others make good; at its variances.

    All of them but the best go at once, then that one where it is needless still: each of two
    lines that are the same is needless beside the other.
    """
    lines, price = state.lines, problem.structures.price[state.lines]
    is_line = np.isin(state.pairs, lines, assume_unique=True)
    own = len(problem.structures.family) + columns_of(np.flatnonzero(is_line)).reshape(-1, 2)
    root, prior = state.half[own], state.prior[own]
    coef, blocks = state.coef[own], root @ root.swapaxes(1, 2)
    out, seen = np.zeros(len(lines), dtype=bool), None
    while True:
        net = np.where(out, np.inf, gains_of(coef.ravel(), blocks, prior.ravel()) - price)
        needless = np.count_nonzero(net <= 0)
        if not needless:
            break
        out[np.argsort(net, kind="stable")[: max(needless - 1, 1)]] = True
        seen = _Nothing(problem, state, own[out].ravel())
        explained = root @ seen.along
        coef = state.coef[own] - explained @ seen.pull
        blocks = root @ root.swapaxes(1, 2) - explained @ explained.swapaxes(1, 2)
        blocks[out] = np.eye(2)
    return state if seen is None else seen.state(problem, state, lines[~out])


class _Nothing:
    """What it shows that some coefficients of lines, `out` (k,) of a state, are nothing.

    To lose a line is to observe that its coefficients have a smaller variance before the data, that
    of the field, or that they are 0. In units of `half` the observation takes ``along @ along.T``
    from the covariance, moves the mean by ``-along @ pull``, and lowers the log evidence by `fall`.
    """

    def __init__(self, problem, state, out):
        prior, variance = state.prior[out], state.variance[problem.line]
        # That of an observation of 0 after which the prior is the field's.
        noise = np.maximum(prior * (prior / variance - 1), 0.0)
        unit, root = np.linalg.qr(np.concatenate([state.half[out].T, np.diag(np.sqrt(noise))]))
        self.along = unit[: len(unit) - len(out)]
        self.pull = solve_triangular(root, state.coef[out], trans="T", check_finite=False)
        volume = 2 * np.log(np.abs(root.diagonal())) - np.log(prior + noise)
        self.fall = 0.5 * (self.pull @ self.pull + volume.sum())

    def state(self, problem, state, lines):
        """The state with the `lines` that are left."""
        unit, size, _ = np.linalg.svd(self.along, full_matrices=False)
        taken = 1 - np.sqrt(np.maximum(1 - size * size, 0.0))
        half = state.half - ((state.half @ unit) * taken) @ unit.T
        coef = state.coef - state.half @ (self.along @ self.pull)
        pairs, shares = problem.pairs_and_shares(lines, state.with_field)
        m, prior = len(problem.structures.family), state.variance @ shares
        kept = np.r_[:m, m + columns_of(np.flatnonzero(np.isin(state.pairs, pairs)))]
        half = half[kept]
        return state._replace(
            lines=lines,
            pairs=pairs,
            coef=coef[kept],
            half=half,
            prior=prior,
            log_evidence=state.log_evidence - float(self.fall),
            determined=1 - np.einsum("ij,ij->i", half, half) / prior,
        )


def _first_size(problem, state):
    """Variance of the field beside a state's families, and the rise of the evidence by it.

    With S what is left of the penalised Gram matrix of its columns, each times the root of its
    share, and r of their products with y, that is ``v r' inv(I + v S) r / 2 - log det(I + v S) /
    2`` at the variance v.
    """
    try:
        left = _Leftover(problem, state)
    except LinAlgError:  # so little noise that only rounding is left
        return 1.0, -np.inf
    S, r = left.gram(), left.r
    root = np.repeat(np.sqrt(problem.structures.share[left.free]), 2)
    S, r = S * root * root[:, None], r * root
    best = 1.0, -np.inf
    for v in state.variance[problem.line] * _FIELD_SIZES:
        try:
            factor = root_of(np.eye(len(S)) + v * S)
        except LinAlgError:  # the rounding of large numbers
            break
        seen = solve_triangular(factor, r, trans="T", check_finite=False)
        rise = 0.5 * v * (seen @ seen) - np.log(factor.diagonal()).sum()
        best = max(best, (v, float(rise)), key=lambda one: one[1])
    return best


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
        columns, m = columns_of(self.free), len(sums.gram)
        self.r = sums.candidate_moment[columns] / noise
        self.own = sums.own[:, self.free] / noise + np.array([[1.0], [1.0], [0.0]]) / self.prior
        self.size = len(S)
        self.factor = np.empty((self.size + 64, len(columns)))
        np.take(sums.cross, columns, axis=1, out=self.factor[:m], mode="clip")
        self.factor[m : self.size] = sums.rows(pairs, (), self.free)
        self.extra = None
        if sums.extra is not None:
            scale = 1 / np.sqrt(sums.extra.variance + noise * sums.extra.share)
            rows, waves = sums.extra.rows * scale[:, None], columns_of(pairs)
            self.extra = rows[:, columns]
            known = rows[:, np.r_[sums.cross.shape[1] : rows.shape[1], waves]]
            self.factor[: self.size] += noise * (known.T @ self.extra)
            first, second = self.extra[:, ::2], self.extra[:, 1::2]
            both = (first, first), (second, second), (first, second)
            self.own += [(a * b).sum(axis=0) for a, b in both]
            self.r += self.extra.T @ (sums.extra.values * scale)
        if self.size and len(columns):
            root = _root_of_parts(S, m)
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


def _root_of_parts(S, m):
    """Upper Cholesky factor of S, whose first m columns may hold rounding, but not the others."""
    root = np.zeros(S.shape, order="F")
    root[:m, :m] = first = root_of(S[:m, :m]) if m else S[:m, :m]
    beside = solve_triangular(first, S[:m, m:], trans="T", check_finite=False) if m else S[:m, m:]
    left = S[m:, m:] - beside.T @ beside
    root[:m, m:] = beside
    if len(left):
        root[m:, m:] = cholesky(0.5 * (left + left.T), check_finite=False)
    return root
