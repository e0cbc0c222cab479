"""A guess at the next steps of a forward selection, so that they can be taken together.

A step of the selection reads the coordinates of all candidates once, for their products with the
direction just chosen: memory is the limit, not arithmetic. If the next choices are guessed, all
their products are one matrix product, which reads the memory once. The guess is a forward selection
among a pool of candidates, whose steps are those of a pivoted Cholesky factorisation of their Gram
matrix. `_forward_selection` checks every guess against all candidates: the pool decides on the time
only, not on the choice, and needs no more digits than a guess does.

Where the Gram matrix would cost more than it saves, the guess is a forward selection on the leading
coordinates of all candidates in single precision (`Sketch`). A direction is known to all digits
there, and only its products are not: they are good to 1e-7 of a length, where a Gram matrix in
single precision would be good to 1e-7 of its square.
"""

import numpy as np
from scipy.linalg import blas

from sklearn_raacmm.network._kernels import largest

# Directions looked ahead at least and at most. As many are projected out of the Gram matrix at
# once: fewer would read the memory too often, more would cost each guess as much.
FEWEST, MOST = 4, 64
# Directions that a sketch looks ahead at first: it seldom guesses wrong.
_FIRST = 16
# Candidates that enter a pool that does not hold all, when one outside turns out to be the best.
_ENTRANTS = 64
# Inner products of vectors, for a Gram matrix, in the time in which one vector is read: a pool is
# filled once the single steps so far have taken as long as its Gram matrix takes.
_ENTRIES_PER_READ = 20
# Below this many steps a guess on the mean of so many guesses, looking ahead does not pay.
_SHORT_RUN, _TRIALS = 4, 8
# Candidates in the pool where the kernel matrix itself is worked on: with 256 runs of 25 guesses
# were right on average (3000 rows, width a tenth), with 64 half as many.
_FEW_CANDIDATES = 256
# Memory of the Gram matrix, in coordinates: as much as their factor has needed while it grew. Up to
# this many candidates it is taken in any case, 200 MB. In single precision a Gram matrix guesses
# three choices in a row instead of sixty: it is no way to save memory.
_MEMORY, _FREE = 1.25, 5000
# Part of a squared length below which its running figure is not good enough for a guess.
_FEW_DIGITS = 1e-7
# Rows of the Gram matrix that are updated together.
_ROWS = 512
# Leading coordinates in a sketch: so many, and so many for each of the directions it is to see, at
# first and after a wrong guess. With these, runs of 64 guesses are right where functions are smooth
# (10 000 rows, rank 914). Where they are rough (three outputs of different noise) the first number
# is too small, and 2.5 in place of the last one as well: a third of the guesses was wrong.
_WIDTH, _PER_DIRECTION = 192, (1.5, 4)
# Coordinates of all candidates from which a sketch pays: fewer stay in the cache.
_LARGE = 1_000_000


def gains(norms, floor, correlations):
    """By how much candidates would lower the objective of each output of a group.

    Parameters
    ----------
    norms, floor : ndarray of shape (n,)
        What is left of the squared lengths, and up to where a candidate counts as dependent.
    correlations : ndarray of shape (n, n_outputs)
        Inner products with what is left of the targets.

    Returns
    -------
    ndarray of shape (n, n_outputs)
    """
    gained = np.square(correlations)
    gained /= np.where(norms > floor, norms, np.inf)[:, None]
    return gained


def all_scores(score, states):
    """Score of candidates, -1 of those that depend on the chosen ones in every group's eyes.

    Parameters
    ----------
    score : callable
        As for `forward_selection`.
    states : list of tuple
        Arguments of `gains` for each group.

    Returns
    -------
    ndarray of shape (n,)
    """
    every = [gains(*state) for state in states]
    scores = score(every[0] if len(every) == 1 else np.hstack(every))
    norms, floor, _ = states[0]
    dependent = norms <= floor
    for norms, floor, _ in states[1:]:
        dependent &= norms <= floor
    np.copyto(scores, -1.0, where=dependent)
    return scores


def pays_for_all(n, n_select):
    """Whether a Gram matrix of all columns of a kernel matrix costs less than single steps.

    It takes 2 n^3 operations, of which 20 are done while one number is read; step k reads half the
    kernel matrix and four times the k directions so far.
    """
    return n_select * (n / 2 + 2 * n_select) > n**2 / 10


class Pool:
    """Candidates that score high, with the Gram matrix of what is left of them.

    Parameters
    ----------
    passes : list of ForwardPass
        One for each group of outputs.
    score : callable
        As for `forward_selection`.
    n_select : int
        Most steps that will be taken.
    """

    def __init__(self, passes, score, n_select):
        self.passes, self.score = passes, score
        n, rank = len(passes[0].norms), passes[0].candidates.rank
        if not passes[0].whitened:
            # Widths are narrow there: the best candidates are far apart, and few are enough.
            self.size = n if pays_for_all(n, n_select) else min(n, _FEW_CANDIDATES)
        else:
            # Some of the candidates would not do: the next best is among the others too often.
            self.size = n if n <= max(_FREE, _MEMORY * rank) else 0
        self.members = np.empty(0, dtype=np.intp)
        self.grams = []  # of each pass; only the lower triangle is up to date
        self.pending = [[] for _ in passes]  # products not yet projected out of it
        large = passes[0].whitened and n * rank >= _LARGE
        self.sketch = Sketch(passes, score) if large else None
        self.length = FEWEST if self.sketch is None else _FIRST
        self.taken, self.rounds, self.n_read = 0, 0, 0

    def guess(self, j, scores, room):
        """Candidate j, which scores highest, and those that are likely to be chosen after it."""
        if self.rounds >= _TRIALS and self.taken < _SHORT_RUN * self.rounds:
            self._give_up()
        length = min(self.length, room)
        if not self.grams:
            # What is read in a step, in rows of coordinates.
            step = 2 * self.passes[0].U.size
            step += len(scores) if self.sketch is None else self.sketch.share * len(scores)
            price = self.size**2 / _ENTRIES_PER_READ
            if self.size < FEWEST or min(self.n_read + step, room * step) < price:
                picks = [j] if self.sketch is None else self.sketch.walk(j, length)
                self.n_read += step * len(picks)
                return picks
            self.rounds, self.taken = 0, 0
        if not self.grams or j not in self.members:
            self._fill(scores)
        return self._walk(j, length)

    def _give_up(self):
        """Leave the way that has guessed wrong too often."""
        if self.grams:
            self.size, self.grams = 0, []
        self.sketch, self.rounds, self.taken = None, 0, 0

    def count(self, taken, wrong):
        """Note how many choices of the last guess were taken, and whether the next was wrong."""
        if self.sketch is not None and wrong:
            self.sketch.per_direction = _PER_DIRECTION[1]
        if self.grams or self.sketch is not None:
            self.rounds, self.taken = self.rounds + 1, self.taken + taken
            self.length = min(max(FEWEST, 2 * taken + 2), MOST)

    def note(self, i, h):
        """Note the products h of all candidates with a direction chosen in pass i."""
        if self.grams:
            self.pending[i].append(h[self.members])
            if len(self.pending[i]) >= MOST:
                self._settle()

    def _settle(self):
        """Project the directions that were chosen since out of the Gram matrices."""
        for gram, rows in zip(self.grams, self.pending, strict=True):
            H = np.array(rows)
            for start in range(0, len(gram) if rows else 0, _ROWS):
                part, below = slice(start, start + _ROWS), slice(0, start + _ROWS)
                gram[part, below] -= H[:, part].T @ H[:, below]
            rows.clear()

    def _fill(self, scores):
        """Take in the candidates that score highest now; those of low score make room."""
        if not self.grams:
            self.members = np.sort(largest(scores, self.size))
            self.grams = [self._gram(one) for one in self.passes]
            return
        self._settle()
        outside = scores.copy()
        outside[self.members] = -np.inf
        new = largest(outside, min(_ENTRANTS, self.size, len(scores) - self.size))
        places = largest(-scores[self.members], len(new))
        self.members[places] = new
        for gram, one in zip(self.grams, self.passes, strict=True):
            u, v = one.candidates.columns(new)
            one.project(u, v)
            for place, row in zip(places, one.candidates.products(v, self.members), strict=True):
                gram[place, :place], gram[place:, place] = row[:place], row[place:]

    def _gram(self, one):
        """Gram matrix of what is left of the members."""
        m = self.members
        if one.whitened:
            u, v = one.candidates.columns(m)
            one.project(u, v)
            # Fortran's upper triangle is our lower one.
            return blas.dsyrk(1.0, u.T, trans=1, lower=0).T
        # Some rows at a time, for their columns are as large as the kernel matrix.
        gram = np.empty((len(m), len(m)))
        for start in range(0, len(m), _ROWS):
            u, v = one.candidates.columns(m[start : start + _ROWS])
            one.project(u, v)
            gram[start : start + _ROWS] = one.candidates.products(v, m)
        return gram

    def _walk(self, j, length):
        """Forward selection in the pool alone, from candidate j on."""
        picks, m = [j], self.members
        states = [(one.norms[m], one.floor[m], one.correlations[m]) for one in self.passes]
        place = int(np.flatnonzero(m == j)[0])
        products = []
        for pending in self.pending:
            H = np.empty((len(pending) + length, len(m)))
            H[: len(pending)] = pending if pending else 0.0
            products.append((H, len(pending)))
        while len(picks) < length:
            for gram, (H, start), state in zip(self.grams, products, states, strict=True):
                if not _project_out(gram, H, start + len(picks) - 1, place, *state):
                    return picks
            scores = all_scores(self.score, states)
            place = int(np.argmax(scores))
            if scores[place] <= 0:
                return picks
            picks.append(int(m[place]))
        return picks


class Sketch:
    """Leading coordinates of all candidates in single precision, to guess the next choices from.

    The coordinates of whitened candidates are ordered: the first ones hold most of every length.

    Parameters
    ----------
    passes : list of ForwardPass
        One for each group of outputs.
    score : callable
        As for `forward_selection`.
    """

    def __init__(self, passes, score):
        self.passes, self.score, self.per_direction = passes, score, _PER_DIRECTION[0]
        # Room for all of them; memory that is not written to yet is not taken yet.
        sizes = [one.candidates.coordinates.shape for one in passes]
        self.leading = [np.empty(size, dtype=np.float32, order="F") for size in sizes]
        self.width = 0

    @property
    def share(self):
        """Part of all coordinates that a step reads."""
        return 0.5 * self.width / self.passes[0].candidates.rank

    def walk(self, j, length):
        """Candidate j, and those that a forward selection on the sketch takes after it."""
        picks, place = [j], int(j)
        width = self._widen(self.passes[0].U.size + length)
        states = [(one.norms.copy(), one.floor, one.correlations.copy()) for one in self.passes]
        bases = [_leading_basis(one, width, length) for one in self.passes]
        while len(picks) < length:
            for one, leading, basis, state in zip(
                self.passes, self.leading, bases, states, strict=True
            ):
                size = one.U.size + len(picks) - 1
                if not _project_sketched(leading[:, :width], basis, size, place, *state):
                    return picks
            scores = all_scores(self.score, states)
            place = int(np.argmax(scores))
            if scores[place] <= 0:
                return picks
            picks.append(place)
        return picks

    def _widen(self, n_directions):
        """Hold enough coordinates for so many directions, and return how many these are."""
        rank = self.passes[0].candidates.rank
        need = min(rank, _WIDTH + int(self.per_direction * n_directions))
        new = slice(self.width, need)
        for leading, one in zip(self.leading, self.passes, strict=True):
            leading[:, new] = one.candidates.coordinates[:, new]
        self.width = max(self.width, need)
        return need


def _leading_basis(one, width, length):
    """Leading coordinates of the directions chosen so far, with room for more below them."""
    basis = np.empty((one.U.size + length, width), dtype=np.float32)
    basis[: one.U.size] = one.U()[:, :width]
    return basis


def _project_sketched(leading, basis, size, place, norms, floor, correlations):
    """One step of a forward selection on a sketch, in place; False where nothing is left."""
    known, u = basis[:size], basis[size]
    u[:] = leading[place]
    for _ in range(2):
        u -= (known @ u) @ known
    squared_norm = float(u @ u)
    if not squared_norm > floor[place]:
        return False
    on_target = correlations[place] / np.sqrt(squared_norm)
    u /= np.sqrt(squared_norm)
    h = (leading @ u).astype(float)
    correlations -= h[:, None] * on_target
    h *= h
    norms -= h
    norms[place] = 0.0
    return True


def _project_out(gram, H, size, place, norms, floor, correlations):
    """One step of a pivoted Cholesky factorisation in place; False where digits are too few."""
    if norms[place] <= floor[place]:
        return False
    h = np.concatenate([gram[place, :place], gram[place:, place]])
    squared_norm = h[place]
    h -= H[:size, place] @ H[:size]
    if not h[place] > _FEW_DIGITS * squared_norm:
        return False
    h /= np.sqrt(h[place])
    H[size] = h
    correlations -= np.outer(h, correlations[place] / h[place])
    norms -= h * h
    norms[place] = 0.0
    return True
