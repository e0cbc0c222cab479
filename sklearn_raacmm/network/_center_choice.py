"""Which rows become centres, and how many: the network's settings turned into calls."""

import warnings
from functools import partial
from typing import NamedTuple

import numpy as np

from sklearn_raacmm.network._candidates import candidate_groups
from sklearn_raacmm.network._forward_selection import (
    exchange,
    forward_selection,
    squared_ratio_score,
    total_score,
)
from sklearn_raacmm.network._kernels import KERNELS
from sklearn_raacmm.network._nested_fits import leave_one_out, size_scores

# Rows drawn as candidate centres where there are more: their factor fits in memory.
MAX_CANDIDATES = 10_000
# Centres tried where their number is not given. A minimum needs the whole path.
_MAX_CENTERS = dict.fromkeys(("posterior", "error_reduction", "mse"), 2000)
_MAX_CENTERS |= dict.fromkeys(("gcv", "loo", "bic"), 500)
# Ratio of ridges up to which outputs see the candidates alike.
_ALIKE = 4.0


class Settings(NamedTuple):
    """Parameters of `RBFNetRegressor` that decide on the centres; None is the default."""

    kernel: str
    n_centers: int | None  # found by the criterion where None
    criterion: str
    tol: float
    max_centers: int | None
    candidates: int | None
    selection: str
    refine: bool


def criterion_in_force(settings, alpha):
    """Name of the criterion for the number of centres; None where that is given.

    Raises
    ------
    ValueError
        If the posterior gain is asked for where it is not known.
    """
    if settings.n_centers is not None:
        return None
    applies = np.all(alpha > 0) and KERNELS[settings.kernel].positive_definite
    applies = applies and settings.selection == "ols"
    if settings.criterion == "posterior" and not applies:
        raise ValueError(
            'criterion="posterior" needs a positive definite kernel, alpha > 0 and '
            f'selection="ols"; got kernel={settings.kernel!r}, a least alpha of {alpha.min():g}, '
            f"selection={settings.selection!r}."
        )
    if settings.criterion == "auto":
        return "posterior" if applies else "gcv"
    return settings.criterion


def choose_centers(problem, alpha, shift, length_scale, settings, rng):
    """Choose centres in order of how much they lower the objective.

    Parameters
    ----------
    problem : Problem
    alpha : ndarray of shape (q,)
        Ridge of every output, in the problem's units.
    shift, length_scale : ndarray of shape (d,)
    settings : Settings
    rng : numpy.random.RandomState
        Draws the candidates.

    Returns
    -------
    indices : ndarray of shape (k,)
        Among the problem's rows.
    stop_reason : str
        Why there are no more.

    Warns
    -----
    UserWarning
        If more centres are asked for than there are candidates: all are taken then.
    """
    n, criterion = len(problem.X), criterion_in_force(settings, alpha)
    most = MAX_CANDIDATES if settings.candidates is None else settings.candidates
    rows = np.arange(n) if n <= most else np.sort(rng.permutation(n)[:most])
    if criterion is None:
        if settings.n_centers > len(rows):
            warnings.warn(
                f"n_centers={settings.n_centers}, but there are only {len(rows)} distinct "
                "candidate rows: all of them are taken.",
                stacklevel=4,
            )
        n_select = min(settings.n_centers, len(rows))
    else:
        limit = _MAX_CENTERS[criterion] if settings.max_centers is None else settings.max_centers
        n_select = min(limit, len(rows))
    view, score = problem.view(centred=settings.selection == "ols"), total_score
    if not len(view.outputs):
        # Nothing varies: no centre is needed, and any is as good as another.
        return (rows[:n_select], "n_centers") if criterion is None else (rows[:0], "criterion")
    members, alphas = group_alphas(alpha[view.outputs])
    if settings.selection == "newrb":
        score = squared_ratio_score(view.total[np.concatenate(members)])
    groups, dof = candidate_groups(
        problem,
        view,
        rows,
        shift,
        length_scale,
        members,
        settings.kernel,
        alphas,
        n_select if criterion is None else None,
        whitened=settings.refine,
    )
    enough = None
    if criterion == "posterior":
        # Gains in units of each output's noise, as the likelihood counts them.
        enough = []
        for candidates, of, free in zip(groups, members, dof, strict=True):
            explained = np.square(candidates.target).sum(axis=0)
            left = view.total[of] + view.within[of] - explained
            noise = np.maximum(left, 1e-14 * problem.n_total) / problem.n_total
            candidates.target = candidates.target / np.sqrt(noise)
            # Less than half a parameter's worth of function is none.
            enough.extend(explained / noise - settings.tol * free if free > 0.5 else 0 * noise)
    found = forward_selection(groups, n_select, score=score, enough=enough)
    indices = found.indices
    if settings.refine and len(indices) > 0:
        indices = exchange(groups, indices)[0]
    stop = {
        "n_select": "n_centers" if criterion is None else "max_centers",
        "enough": "criterion",
    }
    # With newrb the tail joins only now: together they must not outnumber the rows.
    room = problem.n_rows - problem.n_tail
    if alpha.min() == 0 and len(indices) > room:
        return rows[indices[:room]], "dependent"
    return rows[indices], stop.get(found.stop, found.stop)


def choose_size(problem, alpha, columns, path, settings):
    """Number of centres to keep.

    Parameters
    ----------
    problem : Problem
    alpha : ndarray of shape (q,)
    columns : Features
        Of the centres, in order.
    path : Path
        Of the same.
    settings : Settings

    Returns
    -------
    n_centers : int
    scores : ndarray of shape (k,)
        The criterion after 1, 2, ... centres; empty where their number is given.
    reached : bool
        Whether the criterion named a tolerance and it was reached.
    """
    criterion = criterion_in_force(settings, alpha)
    tried = len(path.dof) - 1
    if criterion is None or tried == 0:
        return tried, np.empty(0), False
    press = None
    if criterion == "loo":
        function = partial(_press, columns, path)
        press = problem.reduce(function, np.add, 3 * tried) + problem.within
    scores = size_scores(path, criterion, problem.spread, problem.n_total, press)
    if criterion == "posterior":
        # The forward pass has stopped by it; what is shown is the objective it lowers.
        return tried, scores, False
    if criterion not in ("mse", "error_reduction"):
        return int(np.argmin(scores)) + 1, scores, False
    reached = np.flatnonzero(scores <= settings.tol)
    return (int(reached[0]) + 1, scores, True) if len(reached) else (tried, scores, False)


def _press(columns, path, block):
    return leave_one_out(block.tail, columns(block), block.targets, path)


def group_alphas(alphas):
    """Outputs whose ridges are alike, to select for together, and the ridge of each group.

    Returns
    -------
    members : list of ndarray
        Indices, together all of them in order of their ridge.
    shared : list of float
        Geometric mean of the members' ridges.
    """
    order = np.argsort(alphas, kind="stable")
    members, shared = [], []
    for i in order:
        if members and alphas[i] <= _ALIKE * alphas[members[-1][0]]:
            members[-1].append(i)
        else:
            members.append([i])
    for of in members:
        shared.append(float(np.exp(np.mean(np.log(alphas[of])))) if alphas[of[0]] > 0 else 0.0)
    return [np.array(of) for of in members], shared
