"""Which poses to measure next, by what the linear model does not know yet."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.error_model import check_poses
from sklearn_raacmm.utils import check_whole_number, encode_groups


def next_poses(model, X, n_poses, *, groups=None, targets=None, criterion="I"):
    """Choose the poses whose measurement would tell the model most, one after another.

    The posterior of a linear model says before any measurement how much it would narrow: what is
    measured does not enter, only where. So poses, or whole positions of a single-point test, can be
    chosen from a list of those that are in reach.

    Parameters
    ----------
    model : JointHarmonicRegressor or ArmResidualRegressor
        Fitted model; of the latter, the first stage.

    X : array-like of shape (n_candidates, n_joints)
        Poses that could be measured: joint angles, in the unit that the model takes.

    n_poses : int
        How many to choose: poses, or positions where `groups` are given.

    groups : array-like of shape (n_candidates,), default=None
        Label of the position of each pose: positions are then chosen, with all of their poses.
        Needed where the model has offsets: a pose alone says nothing beside an unknown offset.

    targets : array-like of shape (n_targets, n_joints), default=None
        Poses where the correction will be used; None: the candidates.

    criterion : {"I", "D"}, default="I"
        "I" lowers the mean variance of the correction at the targets, "D" the volume of the
        coefficients' posterior.

    Returns
    -------
    chosen : ndarray of shape (n_poses,)
        Indices of rows of X in order of choice; labels of positions where `groups` are given.

    std_mm : ndarray of shape (n_poses + 1,)
        Standard deviation of the correction at the targets, as the length of a vector, root mean
        square over them, mm: now, and after each choice.

    Raises
    ------
    TypeError
        If the model is of another kind.
    ValueError
        If X has the wrong shape, there are fewer candidates than `n_poses`, groups are missing
        though the model has offsets, or the criterion is unknown.

    See Also
    --------
    JointHarmonicRegressor : The model.

    Notes
    -----
    Greedy I- and D-optimal design (V. V. Fedorov, Theory of Optimal Experiments, 1972), with the
    priors, the harmonics and the noise that the model found. Where a position has an unknown
    offset, its poses count as deviations from their mean. Standard deviations are as honest as the
    model's: where it lacks a term, they know nothing of it.

    Examples
    --------
    >>> from sklearn_raacmm import JointHarmonicRegressor, next_poses
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> test = make_single_point(n_positions=12, n_poses=15, random_state=0)  # simulated
    >>> known = test.groups < 4
    >>> model = JointHarmonicRegressor(test.arm, max_order=4)
    >>> _ = model.fit(test.data[known], test.target[known], groups=test.groups[known])
    >>> chosen, std = next_poses(model, test.data[~known], 3, groups=test.groups[~known])
    >>> len(chosen), bool(std[-1] < std[0])
    (3, True)
    """
    check_is_fitted(model)
    linear = getattr(model, "linear_model_", None)
    if linear is None:
        raise TypeError(
            "next_poses needs a JointHarmonicRegressor or an ArmResidualRegressor, got "
            f"{type(model).__name__}."
        )
    if not (isinstance(criterion, str) and criterion in ("I", "D")):
        raise ValueError(f'criterion must be "I" or "D", got {criterion!r}.')
    X = check_poses(model, X)
    if groups is None:
        if linear.offsets:
            raise ValueError(
                "The model has an unknown offset at every position: give groups, the position of "
                "each candidate."
            )
        labels, codes = np.arange(len(X)), np.arange(len(X))
    else:
        labels, codes = encode_groups(groups, len(X))
    check_whole_number("n_poses", n_poses, 1, len(labels))  # no more than there are candidates

    def whitened(angles):
        """What one standard deviation of each of the posterior's axes does, (n, 3, k)."""
        return linear.columns(angles) @ linear.gauge_free_half

    rows = whitened(X)
    aim = rows if targets is None else whitened(check_poses(model, targets))
    aim = aim.reshape(-1, aim.shape[2])
    gram = aim.T @ aim / (len(aim) / 3)
    if linear.offsets:
        mean = np.stack([rows[codes == i].mean(axis=0) for i in range(len(labels))])
        rows = rows - mean[codes]
    order = np.argsort(codes, kind="stable")
    rows = (rows[order] / linear.noise_sd).reshape(-1, rows.shape[2])
    ends = np.cumsum(3 * np.bincount(codes))
    # The posterior in its own axes: the unit matrix now, M after some choices.
    M = np.eye(rows.shape[1])
    variance, chosen = [np.trace(gram)], []
    for _ in range(n_poses):
        moved = rows @ M
        gains = np.full(len(labels), -np.inf)
        for i, (low, high) in enumerate(zip(ends - 3 * np.bincount(codes), ends, strict=True)):
            if i not in chosen:
                gains[i] = _gain(rows[low:high], moved[low:high], gram, criterion)
        best = int(np.argmax(gains))
        low, high = (ends[best - 1] if best else 0), ends[best]
        half = moved[low:high]
        inner = np.eye(high - low) + half @ rows[low:high].T
        M = M - half.T @ np.linalg.solve(inner, half)
        chosen.append(best)
        variance.append(np.sum(gram * M))
    return labels[chosen], np.sqrt(np.maximum(variance, 0.0))


def _gain(rows, moved, gram, criterion):
    """What a candidate's rows B are worth: with `moved` = B M, the posterior's M."""
    inner = np.eye(len(rows)) + moved @ rows.T
    if criterion == "D":
        return np.linalg.slogdet(inner)[1]
    return np.trace(np.linalg.solve(inner, moved @ gram @ moved.T))
