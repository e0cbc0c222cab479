"""What the models of an arm ask of their training data; each fault gets one clear sentence."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.arm import arm_for, check_angles, points_of, reach_mm
from sklearn_raacmm.calibration import check_length
from sklearn_raacmm.error_model._columns import CAUSES
from sklearn_raacmm.error_model._extra import check_extra, check_tools, warn_of_constants
from sklearn_raacmm.error_model._fit import Rows
from sklearn_raacmm.residuals import refuse_large, refuse_points, warn_of_another_frame
from sklearn_raacmm.utils import (
    CENTRED,
    centred,
    check_data,
    check_features,
    check_weights,
    encode_groups,
    floats,
    listed,
    refuse_huge,
    share_of_means,
    show,
    warn_user,
)

# Repeats that no row has. Rows, in units of those given, that weights may add up to without a word:
# those of weights that add up to 1 are too few, those of inverse variances too many.
_MOST_REPEATS, _LEAST_WORTH, _LARGEST_WORTH = 1e9, 0.1, 100.0
# Reaches of the arm beyond which a residual is in another unit, or no residual at all.
_LARGEST_REACHES = 10.0
# A residual of the orientation that is larger, in rad, is no small error of an arm.
_LARGEST_TURN = 0.5
# A share between that and 1 is worth a warning where independent rows have one as small in fewer
# fits than one of a thousand. Against a reference it is above 1, as neighbours err alike.
_BY_CHANCE = 1e-3


def check_fit(estimator, X, y, sample_weight, groups, lengths):
    """All that `fit` is given.

    Parameters
    ----------
    estimator : ArmResidualRegressor
    X, y, sample_weight, groups, lengths
        As for its `fit`.

    Returns
    -------
    Rows
        Those of weight 0 among them.
    """
    X, y = check_data(estimator, X, y)
    extra = check_extra(estimator.extra)
    arm = arm_for(estimator.arm, type(estimator).__name__, X.shape[1], extra=extra)
    check_extra(extra, arm.n_joints)
    unknown = [name for name in estimator.causes if name not in CAUSES]
    if unknown:
        raise ValueError(f"causes must be some of {', '.join(CAUSES)}, got {show(unknown[0])}.")
    X = _in_rad(X, arm.n_joints, estimator.angle_unit)
    y = _check_vectors(y, arm)
    weights = _check_repeats(check_weights(sample_weight, X))
    warn_of_constants(extra, X[:, arm.n_joints :], weights)
    codes = _check_offsets(estimator.offsets, y, weights, groups)
    points = points_of(arm, X[:, : arm.n_joints])
    _check_residuals(y, points, weights, codes, reach_mm(arm))
    lengths = _check_lengths(lengths, codes, groups, "kinematics" in estimator.causes)
    return Rows(arm, X, y, weights, codes, tuple(lengths))


def _check_repeats(weights):
    """Weights (n,), which are numbers of repeats."""
    if weights.max() > _MOST_REPEATS:
        raise ValueError(
            f"sample_weight holds {weights.max():.4g}, but a weight is worth that many repeats of "
            f"its row: more than {_MOST_REPEATS:g} are refused."
        )
    n = np.count_nonzero(weights)
    if not _LEAST_WORTH * n <= weights.sum() <= _LARGEST_WORTH * n:
        warn_user(
            f"By their sample_weight the {n} rows are worth {weights.sum():.3g} rows: too little "
            "or too much will be learnt. A weight counts repeats: give weights of about 1.",
        )
    return weights


def _check_vectors(y, arm):
    """Residuals (n, 3) as float64."""
    if y.ndim != 2 or y.shape[1] != 3:
        raise ValueError(
            f"y has shape {y.shape}; Cartesian residuals (n_samples, 3) in mm are needed."
        )
    y = y.astype(np.float64, copy=False)
    largest, limit = np.linalg.norm(y, axis=1).max(initial=0.0), _LARGEST_REACHES * reach_mm(arm)
    if largest > limit:
        raise ValueError(
            f"y holds a residual of {largest:.4g} mm, but the arm reaches {reach_mm(arm):.4g} mm: "
            "residuals in mm are needed."
        )
    return y


def _check_residuals(y, points, weights, codes, reach):
    """Refuse what is no residual, and warn of what is one in another frame."""
    used = weights > 0
    refuse_points(y[used], points[used], reach)
    if codes is None:
        refuse_large(y[used], reach)
        warn_of_another_frame(y[used], points[used], reach)
    else:  # offsets may be of any size
        refuse_large(centred(y, codes, weights)[used], reach)


def _check_lengths(lengths, codes, groups, kinematics):
    """Known lengths as (position, position, length, sd), positions by their index in `codes`."""
    lengths = listed("lengths", lengths)
    if not lengths:
        if codes is not None and not kinematics:
            warn_user(
                "Without the cause kinematics nothing holds the distances between positions with "
                "offsets: they may come out worse than without correction. Keep it among causes, "
                "give known lengths, or do not measure lengths with this model.",
            )
        return []
    if codes is None:
        raise ValueError(
            "lengths are for positions with offsets; residuals against a reference, or without "
            "groups, have no use for them."
        )
    labels = encode_groups(groups)[0].tolist()
    return [check_length(entry, labels) for entry in lengths]


def _check_offsets(offsets, y, weights, groups):
    """Index of each row's position where offsets are to be fitted, else None."""
    if groups is None:
        if offsets is True:
            raise ValueError("offsets=True needs groups: the position of each sample.")
        return None
    _, codes = encode_groups(groups, len(y))
    if offsets == "auto":
        share, of_most, by_chance = share_of_means(y, codes, weights)
        offsets = share < CENTRED
        if not offsets and by_chance < _BY_CHANCE:
            warn_user(
                f"The positions' mean residuals are {np.sqrt(share):.2g} times as large as those "
                "of independent rows of this scatter: y may be deviations from the means of more "
                "rows than these. No offsets are fitted; set offsets to True or False.",
            )
        elif not offsets and of_most < 0.1 * CENTRED:
            warn_user(
                "Most positions' mean residuals are zero, but not all: y looks like deviations "
                "from means of other rows than these. No offsets are fitted; set offsets to True "
                "or False.",
            )
    return codes if offsets else None


def check_turns(turns, n_rows, codes):
    """Residuals of the orientation (n, 3) in rad, or None where there are none."""
    if turns is None:
        return None
    turns = floats("orientation_residuals", turns)
    if turns.shape != (n_rows, 3):
        raise ValueError(
            f"orientation_residuals must be {n_rows} rotation vectors in rad, shape ({n_rows}, 3), "
            f"got {turns.shape}."
        )
    refuse_huge("orientation_residuals", turns)
    largest = np.linalg.norm(turns, axis=1).max()
    if largest > _LARGEST_TURN:
        raise ValueError(
            f"orientation_residuals reach {largest:.3g} rad: they must be small errors, what the "
            "calibrated arm shows against what was measured."
        )
    if codes is not None:
        raise ValueError(
            "orientation_residuals are for residuals against a reference: here positions have "
            "unknown offsets."
        )
    return turns


def check_poses(model, X):
    """Rows of X as a fitted `LinearModel` takes them.

    Parameters
    ----------
    model : ArmResidualRegressor
        Fitted.
    X : array-like of shape (n, n_features_in_)
        As for its `predict`.

    Returns
    -------
    ndarray of shape (n, n_features_in_)
        Angles in rad, then the extra columns.

    Raises
    ------
    sklearn.exceptions.NotFittedError
        If the model is not fitted.
    ValueError
        If X has another number of columns than in the fit, holds NaN or infinity, or has a tool
        that the training data did not have; or if the model's arm has been exchanged since.
    """
    check_is_fitted(model)
    linear = model.linear_model_
    if model.arm is not None and model.arm != linear.arm:
        raise ValueError(
            f"arm is {model.arm!r}, but the model was fitted with {linear.arm!r}: a fitted model "
            "is moved to another probe by with_arm, and to another table by a new fit."
        )
    X = check_features(model, X, dtype=np.float64, reset=False)
    n_joints = linear.arm.n_joints
    check_tools(linear.terms.extra, X[:, n_joints:])
    return _in_rad(X, n_joints, model.angle_unit)


def _in_rad(X, n_joints, angle_unit):
    """The same rows with their first columns, the angles, in rad."""
    angles = check_angles(X[:, :n_joints], n_joints, angle_unit)
    return angles if n_joints == X.shape[1] else np.hstack([angles, X[:, n_joints:]])
