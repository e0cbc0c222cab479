r"""Rows of a fit, and sums over them for the harmonics of every joint, many orders at once.

The columns of a harmonic of joint j are :math:`T_j \cos k\theta_j` and :math:`T_j \sin k\theta_j`,
with :math:`T_j` the joint's column of the Jacobian. All orders share :math:`T_j`, so that the inner
products with any other columns R need two steps: the contraction :math:`s = w\, T_j \cdot R` over
x, y and z, and the sums :math:`\sum_n s_n \exp(i k \theta_n)` for all orders k.

Of the Gram matrix of all candidates only the 2 x 2 blocks on its diagonal are summed up beforehand,
and the rows of those candidates that the choice asks for. For many orders every :math:`s_n` of such
a row is spread over the nearest points of a fine grid of angles, by a smooth kernel; the fast
Fourier transform of the grid, divided by that of the kernel, holds all orders to the last digits of
double precision (a nonuniform fast Fourier transform [1]_).

A single-point test compares poses that reach one point. It shows nothing of a motion of the base,
or of a common scale of all lengths: sums are without these, and known lengths between positions
show a part of it.

The noise of a row has the covariance :math:`C = r I + \sum_j v_j J_j J_j'`, with :math:`J_j` what
the angle of joint j does to the probe. With p the residuals times :math:`C^{-1}` and P what
coefficients and unknowns leave of it, a variance is stationary where :math:`v^2 \sum (J'p)^2` is
:math:`v\, \mathrm{tr}(P J J')`: the sum of squares and how many numbers the data determine.
Joints are alike beforehand: see `joint_noise`.

References
----------
.. [1] A. H. Barnett, J. Magland, L. af Klinteberg, "A parallel nonuniform fast Fourier transform
   library based on an exponential of semicircle kernel", SIAM J. Sci. Comput. 41(5), 2019,
   C479-C504.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import warnings
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache, reduce
from itertools import groupby, pairwise, starmap
from operator import attrgetter, methodcaller
from typing import Any, NamedTuple, Self

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.sparse import csr_array

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.error_model._columns import BASE_MOTIONS
from sklearn_raacmm.inference import Extra, GramRows, Sums
from sklearn_raacmm.measurements import Form
from sklearn_raacmm.utils import Groups, Whitening, chunks, one_blas_thread, stage

# Poses whose waves are held at a time: 7 MB for 400 orders of one joint. And such parts that are
# summed up together: the sums of blocks are added in their order, wherever they were made.
_CHUNK, _PARTS = 1024, 32
# Orders and poses from which on the grid is faster: without it the fit of 3000 poses of the UR10
# that ``benchmarks/golden.py`` times takes 1.3 times as long.
_MANY_ORDERS, _MANY_POSES = 128, 256
# Chunks of poses for which is held how they spread over the grid (15 MB), or their waves, of at
# most 127 orders there (130 MB).
_HELD = 10
# Points of the grid for each order up to the highest, points under the kernel, and how sharp it is
# beside the sharpest that the grid allows (``tests/error_model/test_sums.py``).
_PER_ORDER, _WIDTH, _SHARPNESS = 5, 15, 0.97
# Nodes of the integral that is the kernel's own transform: to the last digit with half of them.
_NODES = 64
# The guess that joints are alike counts as so many observations of each joint's noise.
_COUNTS = 3.0
# Steps of the variances at most, and what they change of the shares in all noise that ends them.
_STEPS, _SETTLED = 200, 1e-4
# Least share of the rows themselves, for J J' has rank 2 at some poses. Least lever, of the largest
# one, of a joint that shows anything. Most that coefficients and unknowns take of a joint's noise.
_LEAST_OF_ROWS, _LEAST_LEVER, _MOST_TAKEN = 0.02, 1e-4, 0.9
_TINY = 1e-300


class Noise(NamedTuple):
    """Noise by where it comes from: it grows with the distance from the joints to the probe."""

    of_joints: np.ndarray  # (n_joints,) variance of each angle, rad^2
    of_rows: float  # variance of a coordinate beside that, mm^2
    # Root mean square of what a radian of each moves a coordinate by, (n_joints,).
    lever_mm: np.ndarray

    @property
    def shares(self) -> np.ndarray:
        """Variances of a coordinate by the joints and by the rows, the mean over poses, mm^2."""
        return np.append(np.square(self.lever_mm) * self.of_joints, self.of_rows)

    def scaled(self, factor: float) -> Self:
        """So many times the variances."""
        return self._replace(of_joints=factor * self.of_joints, of_rows=factor * self.of_rows)

    def roots(self, levers: np.ndarray, shown: np.ndarray | None = None) -> np.ndarray:
        """Inverses (n, 3, 3) of the symmetric roots of the covariances: those of I are I.

        Along the axes that are `shown` (n, 3, 3), rows of zeros among them, where not all are.
        """
        covariance = (self.of_joints * levers) @ levers.swapaxes(1, 2) + self.of_rows * np.eye(3)
        if shown is not None:
            covariance = shown @ covariance @ shown.swapaxes(1, 2) + _beside(shown)
        value, axes = np.linalg.eigh(covariance)
        roots = (axes / np.sqrt(value)[:, None]) @ axes.swapaxes(1, 2)
        return roots if shown is None else roots @ shown


def even_noise(levers: np.ndarray, weights: np.ndarray) -> Noise:
    """Noise of the rows alone, of variance 1, at poses of these `levers` (n, 3, n_joints)."""
    squares = np.einsum("n,ncj->j", weights, np.square(levers)) / (3 * weights.sum())
    return Noise(np.zeros(len(squares)), 1.0, np.sqrt(squares))


def _beside(shown):
    """Ones (n, 3, 3) on the diagonal for the axes along which a row shows nothing."""
    return (1 - np.square(shown).sum(axis=2).round())[:, :, None] * np.eye(3)


@stage("noise of each joint")
def joint_noise(
    left: np.ndarray,
    levers: np.ndarray,
    weights: np.ndarray,
    taken: np.ndarray,
    shown: np.ndarray | None = None,
) -> Noise:
    """The likeliest noise of each joint and of the rows, of which a coordinate has 1 in the mean.

    `left` (n, 3) are residuals in mm, `levers` (n, 3, n_joints) what one radian of each joint does.
    `taken` (n_joints + 1,) are the shares of each noise that the fit has followed. The guess of all
    joints is their harmonic mean, which has the highest likelihood of inverse gamma priors: joints
    without noise stay so beside one that has much of it, and one without lever gets that mean.
    `shown` (n, 3, 3) are the axes along which a row shows something, where that is not all.
    """
    n, _, n_joints = levers.shape
    even, rank, beside = even_noise(levers, weights), 3.0, 0.0
    if shown is not None:
        beside, rank = _beside(shown), np.square(shown).sum(axis=(1, 2))
        left, levers = np.einsum("nij,nj->ni", shown, left), shown @ levers
    size = np.append(np.square(even.lever_mm), 1.0)
    seen = size[:-1] > _LEAST_LEVER**2 * size[:-1].max(initial=0.0)
    scale = np.average(np.square(left).sum(axis=1), weights=weights)
    scale /= np.average(rank + np.zeros(n), weights=weights)
    if not (scale > 0 and seen.any()):
        return even
    # Of each noise the covariance that one of it has at each row, which is the last index; it is
    # symmetric, so that a product of nine numbers is a trace.
    shapes = np.empty((n_joints + 1, 3, 3, n))
    np.einsum("nij,nkj->jikn", levers, levers, out=shapes[:-1])
    others = np.moveaxis(np.broadcast_to(beside, (n, 3, 3)), 0, 2)
    shapes[-1] = np.eye(3)[:, :, None] - others
    flat, left = shapes.reshape(n_joints + 1, -1), left.T / np.sqrt(scale)
    one, other = np.array([1, 2, 0]), np.array([2, 0, 1])
    free = 1 - np.minimum(taken, _MOST_TAKEN)
    v = 0.5 / np.where(np.append(seen, True), size, np.inf)
    v[:-1] /= np.count_nonzero(seen)
    v[:-1][~seen] = v[:-1][seen].mean()
    share = v * size
    for _ in range(_STEPS):
        covariance = (v @ flat).reshape(3, 3, n) + others
        precision = covariance[one][:, one] * covariance[other][:, other]
        precision -= covariance[one][:, other] * covariance[other][:, one]  # its cofactors
        precision /= (covariance[0] * precision[0]).sum(axis=0)
        pull = (precision * left).sum(axis=1)
        squares = flat @ (weights * pull[:, None] * pull).ravel()
        determined = free * (flat @ (weights * precision).ravel())
        guess = float(1 / np.mean(1 / v[:-1]))
        squares, determined = v**2 * squares, v * determined
        v = squares / np.maximum(determined, _TINY)
        v[:-1] = (squares[:-1] + _COUNTS * guess) / (determined[:-1] + _COUNTS)
        v[-1] = max(v[-1], _LEAST_OF_ROWS * (v @ size))
        before, share = share, v * size
        if np.abs(share - before).sum() < _SETTLED * share.sum():
            break
    return even._replace(of_joints=v[:-1], of_rows=v[-1]).scaled(float(1 / (v @ size)))


class Rows(NamedTuple):
    """What a model is fitted to."""

    arm: Arm
    X: np.ndarray  # (n, n_joints + n_extra) angles in rad, extra columns, perhaps probes (n, 3)
    y: np.ndarray  # (n, 3) residuals in mm
    weights: np.ndarray  # (n,)
    codes: Any  # (n,) position of each row, from 0, where positions have offsets; else None
    lengths: tuple[Any, ...] = ()  # of (position, position, mm, standard deviation in mm)
    ridge: float = 0.0  # of the offsets: noise variance over theirs; 0: they may be of any size
    noise: Any = None  # `Noise` of variance 1; None: all rows have the same
    root: np.ndarray | None = None  # (n, 3, 3) that whitens a row of this noise; None: I
    # Of touched features: unit vectors (n, 3, 3) along which a row shows something, zeros for the
    # others; (n, 3, q) what the unknowns of its feature do; and the `Form` of each position.
    shown: np.ndarray | None = None
    unknowns: np.ndarray | None = None
    forms: tuple[Any, ...] = ()
    by_dask: bool = False  # whether sums over them are made by the workers of dask

    def at(self, which):
        """Some of the rows, with positions counted from 0 and the lengths that are left."""
        codes, lengths, forms = self.codes, self.lengths, self.forms
        if codes is not None:
            present, codes = np.unique(codes[which], return_inverse=True)
            codes = codes.ravel()
            place = {code: i for i, code in enumerate(present.tolist())}
            lengths = [
                (place[i], place[j], *rest) for i, j, *rest in lengths if i in place and j in place
            ]
            forms = tuple(forms[code] for code in present.tolist()) if forms else ()
        of_rows = {
            name: None if (values := getattr(self, name)) is None else values[which]
            for name in ("X", "y", "weights", "root", "shown", "unknowns")
        }
        return self._replace(**of_rows, codes=codes, lengths=tuple(lengths), forms=forms)

    def chunks(self, size, part_of=None):
        """Slices of at most so many rows, none of which goes on into the next part of the rows.

        Of whole positions where these have offsets, so that a chunk knows what it takes out: rows
        are sorted by position then. `part_of` (n,) are numbers of parts in their order; None: one.
        """
        n, found, start = len(self.X), [], 0
        codes = np.arange(n) if self.codes is None else self.codes
        ends, borders = (
            np.zeros(1, int) + n if of is None else np.flatnonzero(np.diff(of, append=-1)) + 1
            for of in (codes, part_of)
        )
        limit = chunks(n, size)[0].stop
        while start < n:
            least, border = (of[np.searchsorted(of, start, "right")] for of in (ends, borders))
            within = np.searchsorted(ends, min(start + limit, border), "right")
            stop = max(least, ends[max(within - 1, 0)])
            found.append(slice(start, stop))
            start = stop
        return found

    def weighted(self, factor):
        """The rows with their weights times a factor, without those of no weight."""
        rows = self._replace(weights=self.weights * factor)
        kept = rows.weights > 0
        return rows if kept.all() else rows.at(kept)

    def whitening(self, factor=1.0):
        """`Whitening` of the rows, their weights times a factor."""
        given = self.weights * factor, self.root, self.codes, self.unknowns, self.ridge
        return Whitening(*given, self.rank)

    @property
    def rank(self) -> Any:
        """How many numbers a row shows: 3, or (n,)."""
        return 3.0 if self.shown is None else np.square(self.shown).sum(axis=(1, 2)).round()

    def along(self, values):
        """Vectors (n, 3, ...) along what their rows show."""
        return values if self.shown is None else np.einsum("nij,nj...->ni...", self.shown, values)

    def centre(self, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Vectors (n, 3, ...) less what their positions explain, as `judge` compares them.

        Those of touches are as long as those of three numbers.
        """
        if self.shown is None:
            return Groups(self.codes).centred(values, weights)
        left = self._replace(weights=weights, root=self.shown).whitening().centred(values)
        rank = np.reshape(self.rank, (-1, *[1] * (values.ndim - 1)))
        return self.along(left) * np.sqrt(3 / rank)

    def sums(self, columns):
        """`Sums` over the rows, the harmonics of the columns being the candidates."""
        (sums,) = self.sums_of_parts(columns, np.zeros(len(self.X), dtype=int))
        return sums._replace(extra=length_equations(self, columns)) if self.lengths else sums

    def sums_of_parts(self, columns, part_of):
        """The same over each part of the rows, without known lengths, in the order of the parts.

        `part_of` (n,) are their numbers; a position is in one of them.
        """
        sums = candidate_sums(self, columns, part_of)
        if self.codes is None or self.ridge:
            return sums
        return [without_motions(one, columns) for one in sums]


@stage("sums over the poses")
def candidate_sums(rows, columns, part_of):
    """Sum up what the choice of harmonics needs, as `Sums` of each part of the rows.

    The harmonics of the columns, sorted by joint, are the candidates; the others are always in.
    Rows are whitened, and offsets of positions are taken out of them: see `Whitening`. `part_of`
    (n,) is as `Rows.sums_of_parts` has it.
    """
    order = np.lexsort([part_of] if rows.codes is None else [rows.codes, part_of])
    rows, part_of = rows.at(order), part_of[order]
    whitened, given, ends = rows.whitening(), [], [0]
    slices = rows.chunks(_CHUNK, part_of)
    groups = [None] * len(slices) if rows.codes is None else whitened.groups.of_slices(slices)
    for _, own in groupby(zip(slices, groups, strict=True), lambda one: part_of[one[0].start]):
        own = list(own)
        n_held = _HELD // -(-len(own) // _PARTS)
        for i in range(0, len(own), _PARTS):
            some, of_some = zip(*own[i : i + _PARTS], strict=True)
            of = slice(some[0].start, some[-1].stop)
            some = [slice(one.start - of.start, one.stop - of.start) for one in some]
            moved = () if rows.codes is None else (whitened.basis[of], of_some)
            given.append((some, n_held, columns, rows.X[of], rows.y[of], whitened.root[of], *moved))
        ends.append(len(given))
    blocks = of_blocks(_Block, given, rows.by_dask, hold=True)
    shown = np.bincount(np.unique(part_of, return_inverse=True)[1], whitened.observations)
    return [
        _sums_of(blocks[first:end], rows.by_dask, max(n, 0.0))
        for n, (first, end) in zip(shown.tolist(), pairwise(ends), strict=True)
    ]


def _sums_of(blocks, by_dask, n_observations):
    """`Sums` of some blocks."""
    gram, cross, own = sums_of_blocks(attrgetter("sums"), blocks, by_dask)

    def rows_of(pairs):
        return sums_of_blocks(methodcaller("gram_rows", pairs), blocks, by_dask)[0]

    return Sums(
        gram[:-1, :-1],
        gram[:-1, -1],
        cross[:-1],
        own,
        cross[-1],
        float(gram[-1, -1]),
        n_observations,
        GramRows(rows_of, cross.shape[1]),
    )


def explicit_gram(rows, columns_at):
    """Gram matrix of few columns and y of whitened rows, and what offsets of positions explain.

    `columns_at` makes the columns (n, 3, p) of rows of X, y is the last one. Returns the matrix (p
    + 1, p + 1); the sums (n_positions, 3, p + 1) of which `less_constants` takes what offsets
    explain, and the precision (n_positions, 3) of these. Both are None without offsets.
    """
    gram: Any = 0.0
    whitened: Any = rows.whitening()
    of_positions: Any = None if rows.codes is None else 0.0
    for part in chunks(len(rows.X), _CHUNK):
        columns = np.concatenate([columns_at(rows.X[part]), rows.y[part, :, None]], axis=2)
        columns = whitened.root[part] @ columns
        flat = columns.reshape(-1, columns.shape[2])
        gram = gram + flat.T @ flat
        if rows.codes is not None:
            moved = whitened.basis[part].swapaxes(1, 2) @ columns
            n_positions = len(whitened.unit)
            of_positions = of_positions + Groups(rows.codes[part], n_positions).sums(moved)
    return gram, of_positions, whitened.precision


def less_constants(gram, of_positions, share=1.0):
    """The Gram matrix of `explicit_gram` without what constants of the positions explain.

    Or a `share` (n_positions, 3) of that: v / (v + ridge) for those of the precision v that are
    drawn to 0 by as much as `ridge`.
    """
    if of_positions is None:
        return gram
    scaled = np.sqrt(np.broadcast_to(share, of_positions.shape[:2]))[:, :, None] * of_positions
    scaled = scaled.reshape(-1, len(gram))
    return gram - scaled.T @ scaled


def without_motions(sums, columns):
    """Sums that know nothing of a motion of the base and of a common scale of all lengths.

    To first order in the errors a single-point test shows neither. Of its deviations, which a scale
    multiplies, the evidence would prefer an arm of no size.
    """
    if not columns.terms.kinematics:
        return sums
    motions = motions_of(columns.alone)

    def beside(products):
        found = motions @ (motions.T @ products)
        return np.subtract(products, found, out=found)

    gram = beside(beside(sums.gram).T)
    return sums._replace(gram=gram, moment=beside(sums.moment), cross=beside(sums.cross))


@lru_cache(maxsize=64)
def motions_of(columns):
    """Orthonormal coefficients (m, k) that move the base, or scale the arm."""
    # What comes before the first joint in the modified convention moves the arm, too.
    before = ["a1", "alpha1", "beta1"] * (columns.arm.convention == "modified")
    moving = [columns.names.index(name) for name in [*BASE_MOTIONS, *before]]
    unit = np.eye(len(columns.names))
    return np.linalg.qr(np.column_stack([unit[:, moving], columns.scale]))[0]


def length_equations(rows, columns):
    """Known lengths between positions as rows of the linear model, an `Extra`.

    The difference of the corrections of two positions along the line between them is what the
    measured length is too long.
    """
    first, second, length, sd = (np.array(part) for part in zip(*rows.lengths, strict=True))
    used, ends = np.unique([first, second], return_inverse=True)
    ends = ends.reshape(2, -1)
    rows = rows._replace(lengths=()).at(np.isin(rows.codes, used))
    whitened = rows.whitening()
    given = np.stack([columns.points(rows.X), rows.y], axis=2)
    points, found = np.moveaxis(whitened.unknowns(given), 2, 0)
    moved: Any = 0.0
    for part in chunks(len(rows.X), _CHUNK):
        sums = whitened.basis[part].swapaxes(1, 2) @ (
            whitened.root[part] @ columns.at(rows.X[part])
        )
        moved = moved + Groups(rows.codes[part], len(used)).sums(sums)
    means = whitened.unit @ moved
    measured, slopes = known_lengths(rows.forms, ends, points, found)
    moved = sum(np.einsum("lq,lqp->lp", slopes[i], means[ends[i]]) for i in (0, 1))
    unit = whitened.unit
    share: Any = sum(np.einsum("lq,lqk->lk", slopes[i], unit[ends[i]]) ** 2 for i in (0, 1))
    return Extra(moved, measured - length, np.square(sd), share.sum(axis=1))


def known_lengths(
    forms: tuple[Form | None, ...], ends: np.ndarray, points: np.ndarray, found: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What lengths (l,) measure, mm, and their slopes by the unknowns of both ends, (2, l, q).

    Of what was touched, `points` (g, q) are the unknowns of the arm's points, and `found` those of
    the residuals, about which the `forms` of surfaces are; `ends` (2, l) number them.
    """
    q = points.shape[1]
    measured, slopes = np.zeros(ends.shape[1]), np.zeros((*ends.shape, q))
    for i, (one, other) in enumerate(ends.T.tolist()):
        of_surfaces = [forms[end] if forms else None for end in (one, other)]
        of_ends = [
            form or Form(points[end, :3])
            for form, end in zip(of_surfaces, (one, other), strict=True)
        ]
        if one == other:
            of_ends[1] = of_ends[0]
        measured[i], *along = of_ends[0].length_to(of_ends[1])
        slopes[:, i] = [slope[:q] for slope in along]
        # Forms are about y; a point is where the arm says that it is.
        measured[i] += sum(
            slope[:q] @ found[end]
            for form, slope, end in zip(of_surfaces, along, (one, other), strict=True)
            if form is not None
        )
    return measured, slopes


def of_blocks(function: Callable, given: Iterable[tuple], by_dask: bool, hold: bool = False) -> Any:
    """Results of a function of the arguments of each block, in the order of the blocks.

    To `hold` them leaves what dask makes where it is; such a result may be an argument again.
    """
    if not by_dask:
        return [*starmap(function, given)] if hold else starmap(function, given)
    from dask.base import compute, persist
    from dask.delayed import delayed

    task = delayed(_with_one_thread, pure=False)
    tasks = [task(function, *one) for one in given]
    with warnings.catch_warnings():
        # Arguments are sent with the tasks, so that a block that is lost can be made again.
        warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
        return persist(*tasks) if hold else compute(*tasks)


def sums_of_blocks(function: Callable, blocks: Sequence[Any], by_dask: bool) -> list[Any]:
    """Sums of the arrays that a function makes of each of the blocks, added in their order."""

    def added(one, other):
        return [a + b for a, b in zip(one, other, strict=True)]

    return list(reduce(added, of_blocks(function, zip(blocks), by_dask)))


@one_blas_thread
def _with_one_thread(function, *given):
    return function(*given)


class _Block:
    """Rows that are summed up together, in `parts` of whole positions; waves of some are held.

    `groups` are the positions of the rows of each part, where these have offsets.

    `sums` are those of the columns that are always in and of y, of their products with the
    harmonics, and of the harmonics' own blocks.
    """

    def __init__(self, parts, n_held, columns, X, y, root, basis=None, groups=()):
        n_joints, offered = columns.arm.n_joints, columns.terms.harmonics
        self.parts, self.n_held, self.columns = parts, n_held, columns
        self.basis, self.groups = basis, groups
        of_joints = [slice(start // 2, end // 2) for start, end in columns.spans]
        # Joint, orders, and which of those offered they are.
        self.spans: Any = [(offered[of.start, 0], offered[of, 1], of) for of in of_joints]
        many = len(X) >= _MANY_POSES
        self.is_on_grid = [many and len(orders) >= _MANY_ORDERS for _, orders, _ in self.spans]
        self.held: dict[int, list] = {}
        self.turns: Any = np.empty((*y.shape, n_joints))
        self.angles = np.empty((len(X), n_joints))
        m, own = len(columns.others) + 1, np.zeros((3, len(offered)))
        gram, total = np.zeros((m, m)), np.empty((0, 0))
        found: Any = [0.0] * len(self.spans)
        for k, part in enumerate(parts):
            turns, others, self.angles[part], every = columns.parts(X[part])
            self.turns[part] = root[part] @ turns
            left = always = root[part] @ np.concatenate([others, y[part, :, None]], axis=2)
            if basis is not None:
                total = self.groups[k].total
                explained = total @ (basis[part].swapaxes(1, 2) @ always).reshape(len(left), -1)
                explained = explained.reshape(len(explained), -1, m)[self.groups[k].codes]
                left = always - basis[part] @ explained  # one side of a product is enough
            gram += always.reshape(-1, m).T @ left.reshape(-1, m)
            for i, (own_waves, (joint, _, pairs)) in enumerate(
                zip(self._of_part(k, every), self.spans, strict=True)
            ):
                turn, wave = self.turns[part, :, joint], every[:, pairs]
                # Sums over poses of columns times waves.
                found[i] = found[i] + own_waves @ np.einsum("ncm,nc->nm", left, turn)
                size = np.square(turn).sum(axis=1)
                double, whole = size @ np.square(wave), size.sum()
                own[:, pairs] += [whole + double.real, whole - double.real, double.imag]
                if basis is not None:
                    for component in np.einsum("ncq,nc->qn", basis[part], turn):
                        sums = (total @ (component[:, None] * wave).view(float)).view(complex)
                        taken = sums.real**2, sums.imag**2, sums.real * sums.imag
                        own[:, pairs] -= 2 * np.array(taken).sum(axis=1)
        cross = self._of_candidates(found) if found else np.empty((m, 0))
        self.sums: Any = gram, np.ascontiguousarray(cross), 0.5 * own

    def __getstate__(self):
        return vars(self) | {"held": {}}

    def _of_part(self, k, every: Any = None):
        """What the waves of each joint share at rows, of which `every` are the waves."""
        if (found := self.held.get(k)) is None:
            angles = self.angles[self.parts[k]]
            missing = every is None and not all(self.is_on_grid)
            waves: Any = self.columns.waves(angles).view(complex) if missing else every
            found = []
            for on_grid, (joint, orders, pairs) in zip(self.is_on_grid, self.spans, strict=True):
                # Copied, lest what is held hold the waves of all joints.
                own = _spread(angles[:, joint], orders) if on_grid else waves[:, pairs].copy()
                found.append((own if on_grid else own.view(float)).T)
            if len(self.held) < self.n_held:
                self.held[k] = found
        return found

    def gram_rows(self, pairs):
        """Inner products of the columns of pairs with those of all candidates, (2 b, 2 n_pairs)."""
        found: Any = [0.0] * len(self.spans)
        joints, order = self.columns.terms.harmonics[pairs].T
        twice = np.repeat(joints, 2)
        for k, part in enumerate(self.parts):
            turn = self.turns[part]
            phase = order * self.angles[part][:, joints]
            wave = np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(phase), -1)
            products, moved, taken = turn.swapaxes(1, 2) @ turn, turn, turn
            if self.basis is not None:
                moved = self.basis[part].swapaxes(1, 2) @ turn  # (n, q, n_joints)
                taken = moved[:, :, twice] * wave[:, None]
                sums = self.groups[k].total @ taken.reshape(len(taken), -1)
                taken = sums[self.groups[k].codes].reshape(taken.shape)
            for i, (own, (joint, *_)) in enumerate(zip(self._of_part(k), self.spans, strict=True)):
                share = products[:, joint].take(twice, axis=1) * wave
                if self.basis is not None:
                    share -= np.einsum("nqm,nq->nm", taken, moved[:, :, joint])
                found[i] = found[i] + own @ share
        return (self._of_candidates(found),)

    def _of_candidates(self, found):
        """Sums (m, 2 n_pairs) of what each joint has found of them, on the grid or not."""
        for i in np.flatnonzero(self.is_on_grid):
            found[i] = _of_orders(found[i], self.spans[i][1])
        return np.concatenate(found).T


def _spread(theta, orders):
    """What each angle gives to the points of the grid around it, (n, n_points) sparse."""
    size, sharpness, _ = _grid(int(orders[-1]))
    at = np.mod(theta / (2 * np.pi), 1.0) * size
    points = np.ceil(at - _WIDTH / 2).astype(np.int32)[:, None] + np.arange(_WIDTH, dtype=np.int32)
    values = _kernel((points - at[:, None]) * (2 / _WIDTH), sharpness)
    ends = np.arange(0, values.size + 1, _WIDTH, dtype=np.int32)
    points %= size
    return csr_array((values.ravel(), points.ravel(), ends), shape=(len(theta), size))


def _of_orders(total, orders):
    """Sums for the orders, (2 n_orders, m), of those on the grid with `_spread`."""
    factors = _grid(int(orders[-1]))[2]
    found = rfft(np.ascontiguousarray(total.T), axis=1).take(orders, axis=1)
    return np.conj(found * factors[orders]).view(float).T


@lru_cache(maxsize=16)
def _grid(highest):
    """Points around the circle, sharpness, and one over the transform of the kernel."""
    size = next_fast_len(_PER_ORDER * highest, real=True)
    sharpness = _SHARPNESS * np.pi * _WIDTH * (1 - highest / size)
    nodes, shares = np.polynomial.legendre.leggauss(_NODES)
    phase = np.outer(np.arange(highest + 1), nodes * _WIDTH * np.pi / size)
    transform = np.cos(phase) @ (shares * _kernel(nodes, sharpness)) * _WIDTH / 2
    return size, sharpness, 1 / transform


def _kernel(x, sharpness):
    """Exponential of a semicircle, between -1 and 1."""
    return np.exp(sharpness * (np.sqrt(np.maximum(1 - x * x, 0.0)) - 1))
