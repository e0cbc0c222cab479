"""Which rows become centres, and how many: the network's settings turned into calls."""

import warnings
from typing import NamedTuple

import numpy as np
from sklearn.exceptions import ConvergenceWarning

from sklearn_raacmm.network._all_rows import may_take_all, share_of_parameters
from sklearn_raacmm.network._candidates import MAX_RANK, candidate_groups
from sklearn_raacmm.network._forward_selection import (
    exchange,
    forward_selection,
    squared_ratio_score,
    total_score,
)
from sklearn_raacmm.network._kernels import largest
from sklearn_raacmm.network._nested_fits import size_scores
from sklearn_raacmm.utils import stage

# Rows drawn as candidate centres where there are more: their factor fits in memory.
MAX_CANDIDATES = 10_000
# Centres tried where their number is not given. For "gcv" the whole path is needed.
_MAX_CENTERS = dict.fromkeys(("posterior", "error_reduction", "mse"), 2000) | {"gcv": 500}
# Rank of the candidates' factor per centre that may be tried: the centres are to be chosen from
# more dimensions than they take up.
_RANK_PER_CENTER = 1.5
# Mean part of the prior variance outside the candidates' factor that is passed over in silence.
_UNSEEN = 0.01
# Effective parameters of the process, per row, from which on all rows become centres. On 21 random
# functions of 2 to 8 features (1000 and 3000 rows) a network needed 1.0 to 1.7 centres for each.
# Above a quarter its fit, without the search of the widths, took 4 to 35 times as long as that of
# all rows, for a third or more of their centres and the same error to 1 %.
_ALL_ROWS = 0.25
# Centres of a network for each effective parameter: where they are more than may be tried, all rows
# become centres, too.
_CENTERS_PER_PARAMETER = 1.5
# Of a warm start: candidates beside the last centres, as a share of these and at the least. With
# 1 % more rows a twentieth would do; the rest is for rows from where there were none.
_NEW, _FEWEST_NEW = 0.3, 50
# Frames from a warning here to the line on which a user has called `fit`, whose decorators count.
_CALLER = 11
# Parameters of the process below which its function is none; the same in an average of models,
# where noise has had its weight. With the first instead of the second, networks of 5 rows had 1 %
# more error (45 simulated functions).
_NO_FUNCTION, _NO_FUNCTION_OF_SEVERAL = 0.5, 0.01
# Ratio of ridges up to which outputs see the candidates alike.
_ALIKE = 4.0


class CenterSettings(NamedTuple):
    """Parameters of `RBFNetRegressor` that decide on the centres."""

    n_centers: int | None  # None: found by the criterion
    criterion: str
    tol: float
    max_centers: int | None  # None: the default for the criterion
    candidates: int | None  # None: `MAX_CANDIDATES`
    selection: str
    refine: bool
    several: bool = False  # whether the process is a part of an average of models

    @classmethod
    def of(cls, estimator):
        """Those of an `RBFNetRegressor`."""
        return cls(
            None if estimator.n_centers == "auto" else estimator.n_centers,
            estimator.criterion,
            estimator.tol,
            estimator.max_centers,
            estimator.max_candidates,
            estimator.selection,
            estimator.refine,
        )


def criterion_in_force(settings, alpha):
    """Name of the criterion for the number of centres; None where that is given.

    Raises
    ------
    ValueError
        If the posterior gain is asked for where it is not known.
    """
    if settings.n_centers is not None:
        return None
    applies = np.all(alpha > 0) and settings.selection == "ols"
    if settings.criterion == "posterior" and not applies:
        raise ValueError(
            'criterion="posterior" needs alpha > 0 and selection="ols"; got a least alpha of '
            f"{alpha.min():g}, selection={settings.selection!r}."
        )
    if settings.criterion == "auto":
        return "posterior" if applies else "gcv"
    return settings.criterion


def takes_all_rows(problem, alpha, functions, settings):
    """Whether every row becomes a centre, because a network would need nearly as many.

    Parameters
    ----------
    problem : Problem or ChunkedProblem
    alpha : ndarray of shape (q,)
        Ridge of every output, in units of an observation.
    functions : RadialFunctions
    settings : CenterSettings

    Returns
    -------
    bool
        Never where a number of centres or candidates was asked for.
    """
    asked = settings.n_centers, settings.max_centers, settings.candidates
    if any(number is not None for number in asked) or settings.refine:
        return False
    if criterion_in_force(settings, alpha) != "posterior" or not np.any(problem.spread > 0):
        return False
    if not may_take_all(problem, alpha):
        return False
    # The output that needs most decides, as it does on the centres.
    least = alpha[problem.spread > 0].min()
    most = _MAX_CENTERS["posterior"] / (_CENTERS_PER_PARAMETER * problem.n_rows)
    limit = min(_ALL_ROWS, most)
    return share_of_parameters(problem, least, functions, limit) > limit


@stage("centres of the network")
def choose_centers(problem, alpha, functions, settings, rng, last=None):
    """Choose centres in order of how much they lower the objective.

    Parameters
    ----------
    problem : Problem
    alpha : ndarray of shape (q,)
        Ridge of every output, in the problem's units.
    functions : RadialFunctions
    settings : CenterSettings
    rng : numpy.random.RandomState
        Draws the candidates.
    last : NetworkPosterior, optional
        Of other rows; its centres are candidates, and rows that are far from them.

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
    ConvergenceWarning
        If a limit that the user has not set decided on the number of centres.
    """
    criterion = criterion_in_force(settings, alpha)
    n, most = len(problem.X), settings.candidates or MAX_CANDIDATES
    rows = np.arange(n) if n <= most else np.sort(rng.permutation(n)[:most])
    if last is not None:
        near = rows_near(problem.X, last)
        rows = near if (settings.n_centers or 1) <= len(near) else rows
    n_select = _most_steps(settings, criterion, len(rows))
    view = problem.view(centred=settings.selection == "ols")
    if not len(view.outputs):
        # Nothing varies: no centre is needed, and any is as good as another.
        return (rows[:n_select], "n_centers") if criterion is None else (rows[:0], "criterion")
    members, alphas = group_alphas(alpha[view.outputs])
    limits = {
        "n_select": n_select if criterion is None else None,
        "max_rank": max(MAX_RANK, int(_RANK_PER_CENTER * n_select)),
        "whitened": settings.refine,
    }
    where = rows, functions.shift, functions.length_scale, members, functions.kernel
    candidates = candidate_groups(problem, view, *where, alphas, **limits)
    score, goal = total_score, None
    if settings.selection == "newrb":
        score = squared_ratio_score(view.total[np.concatenate(members)])
    elif criterion == "posterior":
        score, goal = _posterior_goal(problem, view, candidates, members, settings)
    found = forward_selection(candidates.groups, n_select, score=score, enough=goal)
    if criterion == "posterior":
        _warn_of_limits(found, candidates, settings, goal)
    indices = found.indices
    if settings.refine and len(indices) > 0:
        indices = exchange(candidates.groups, indices)[0]
    # With newrb the tail joins only now: together they must not outnumber the rows.
    offsets = 0 if problem.codes is None else problem.codes[-1] + 1
    room = problem.n_rows - problem.n_tail - offsets
    if alpha.min() == 0 and len(indices) > room:
        return rows[indices[:room]], "dependent"
    reasons = {
        "n_select": "n_centers" if criterion is None else "max_centers",
        "enough": "criterion",
        "dependent": "rank" if candidates.unseen > 0 else "dependent",
    }
    return rows[indices], reasons[found.stop]


def rows_near(X, last):
    """Rows that are centres of another network, and those that it knows least of.

    Parameters
    ----------
    X : ndarray of shape (n, d)
        Distinct rows.
    last : NetworkPosterior

    Returns
    -------
    ndarray of shape (m,)
        Sorted; empty where fewer than half of the centres are among the rows.
    """
    number = {row.tobytes(): i for i, row in enumerate(X)}
    same = [number.get((center + 0.0).tobytes()) for center in last.centers]
    same = [i for i in same if i is not None]
    if 2 * len(same) <= len(last.centers):
        return np.empty(0, dtype=np.intp)
    outside = last.outside(X)
    outside[same] = -1.0
    new = largest(outside, min(len(X) - len(same), max(_FEWEST_NEW, int(_NEW * len(same)))))
    return np.sort(np.append(same, new).astype(np.intp))


def _most_steps(settings, criterion, n_candidates):
    """Number of centres to choose: as many as are asked for, or as may be tried."""
    if criterion is not None:
        limit = _MAX_CENTERS[criterion] if settings.max_centers is None else settings.max_centers
        return min(limit, n_candidates)
    if settings.n_centers > n_candidates:
        warnings.warn(
            f"n_centers={settings.n_centers}, but there are only {n_candidates} distinct "
            "candidate rows: all of them are taken.",
            stacklevel=_CALLER,
        )
    return min(settings.n_centers, n_candidates)


def _posterior_goal(problem, view, candidates, members, settings):
    """How the posterior criterion scores gains, and the reduction of each output that is enough.

    Gains count in units of each output's noise, as in the likelihood.
    """
    noises, goal = [], []
    groups = zip(candidates.groups, members, candidates.degrees_of_freedom, strict=True)
    for group, of, degrees in groups:
        explained = np.square(group.target).sum(axis=0)
        left = view.total[of] + view.within[of] - explained
        noise = np.maximum(left, 1e-14 * problem.n_total) / problem.n_total
        noises.append(noise)
        least = _NO_FUNCTION_OF_SEVERAL if settings.several else _NO_FUNCTION
        goal.append(explained - settings.tol * degrees * noise if degrees > least else 0 * noise)
    noises = np.concatenate(noises)
    return lambda gains: total_score(gains / noises), np.concatenate(goal)


def _warn_of_limits(found, candidates, settings, goal):
    """Warn where a limit that the user has not set decided on the network."""
    if found.stop == "n_select" and settings.max_centers is None:
        reached = np.sum(found.reduction, axis=0)
        share = np.max((goal - reached)[goal > 0] / goal[goal > 0], initial=0.0)
        if share > 0:
            warnings.warn(
                f"The number of centres is the default limit of {len(found.indices)}; "
                f"{100 * share:.2g} % of what the criterion asks for is not reached. Give a larger "
                "max_centers, or set it to this number if the network is good enough.",
                ConvergenceWarning,
                stacklevel=_CALLER,
            )
    if candidates.unseen > _UNSEEN:
        warnings.warn(
            f"The widths are narrow for so many rows: {100 * candidates.unseen:.2g} % of the prior "
            f"variance at the candidates lies outside the {candidates.groups[0].rank} dimensions "
            "from which centres are chosen. A larger max_centers raises their number, to "
            f"{_RANK_PER_CENTER:g} times as many.",
            ConvergenceWarning,
            stacklevel=_CALLER,
        )


def choose_size(problem, alpha, path, settings):
    """Number of centres to keep.

    Parameters
    ----------
    problem : Problem
    alpha : ndarray of shape (q,)
    path : NestedFits
        Of the centres, in order.
    settings : CenterSettings

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
    scores = size_scores(path, criterion, problem.spread, problem.n_total)
    if criterion == "posterior":
        # The forward pass has stopped by it; what is shown is the objective it lowers.
        return tried, scores, False
    if criterion == "gcv":
        return int(np.argmin(scores)) + 1, scores, False
    reached = np.flatnonzero(scores <= settings.tol)
    return (int(reached[0]) + 1, scores, True) if len(reached) else (tried, scores, False)


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
