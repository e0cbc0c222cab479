"""What a fitted model of an arm's residuals does with measured points: correct and score."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.utils import Finding, Floats, Groups, VersionedRegressor, check_weights, floats

# Reference points that are the same to so many digits of a mm are those of one position; points of
# the arm that are the same to so many are one pose.
_DIGITS, _OFF_THE_DIGITS, _POSE_DIGITS = 3, 0.3137, 6


class PointCorrectionMixin(VersionedRegressor):
    """`correct` and `score` of a regressor that predicts residuals of an arm's points.

    The estimator has `_points_of`, the arm's points at X or None, and says in `by_position_` or
    `offsets_` whether the residuals of its fit are known up to one constant at each position.
    """

    # With metadata routing on, groups are asked for without a word.
    __metadata_request__score = {"groups": True}

    if TYPE_CHECKING:  # what the estimator has
        predict: Any

        def _points_of(self, X: ArrayLike) -> Floats | None: ...

    @overload
    def correct(
        self,
        X: ArrayLike,
        points: ArrayLike | None = None,
        *,
        return_std: Literal[True],
        **predict_params: Any,
    ) -> tuple[Floats, Floats]: ...
    @overload
    def correct(
        self,
        X: ArrayLike,
        points: ArrayLike | None = None,
        *,
        return_cov: Literal[True],
        **predict_params: Any,
    ) -> tuple[Floats, Floats]: ...
    @overload
    def correct(
        self, X: ArrayLike, points: ArrayLike | None = None, **predict_params: Literal[False]
    ) -> Floats: ...
    def correct(
        self, X: ArrayLike, points: ArrayLike | None = None, **predict_params: Any
    ) -> Floats | tuple[Floats, Floats]:
        """Correct measured points: subtract the predicted residuals.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            As in `fit`.
        points : array-like of shape (n_samples, 3), default=None
            Measured points in the arm's base frame, mm. None: where the arm says that its probe
            is, if the model has an arm.
        **predict_params : dict
            As in `predict`.

        Returns
        -------
        points : ndarray of shape (n_samples, 3)
            Corrected points, mm; with ``return_std=True`` also their standard deviations.

        Raises
        ------
        ValueError
            If `points` are not one for each row, or missing where there is no arm.

        Examples
        --------
        >>> from sklearn_raacmm import ArmResidualRegressor
        >>> from sklearn_raacmm.datasets import make_single_point
        >>> test = make_single_point(5, 40, machine="gravity", random_state=0)  # simulated
        >>> model = ArmResidualRegressor(test.arm, orders=4)
        >>> model = model.fit(test.data, test.target, groups=test.groups)
        >>> model.correct(test.data, test.points).shape
        (200, 3)
        """
        points = self._points_of(X) if points is None else points
        if points is None:
            raise ValueError("points must be given where azimuth is not the method of an arm.")
        points = floats("points", points, 3)
        predicted = self.predict(X, **predict_params)
        mean, *deviations = predicted if isinstance(predicted, tuple) else (predicted,)
        if points.shape != mean.shape:
            raise ValueError(
                f"points has shape {points.shape}, but predictions {mean.shape}: one point is "
                "needed for each row of X."
            )
        return (points - mean, *deviations) if deviations else points - mean

    def score(
        self,
        X: ArrayLike,
        y: ArrayLike,
        groups: ArrayLike | None = None,
        sample_weight: ArrayLike | None = None,
    ) -> float:
        """Score predictions: R2, of deviations within positions where only these are known.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            As in `fit`.
        y : array-like of shape (n_samples, 3), (n_samples, 1) or (n_samples,)
            Residuals in mm.
        groups : array-like of shape (n_samples,), default=None
            Label of the position of each row. None: where the model has an arm, rows are of one
            position if the arm's point less y, the point that their residual is from, is the same.
        sample_weight : array-like of shape (n_samples,), default=None
            Weight of each row.

        Returns
        -------
        score : float
            In a single-point test the share of the sum of squared deviations from positions' means
            that the predictions take away. Without positions, and where the means are not small,
            R2 as of any regressor of scikit-learn.

        Raises
        ------
        ValueError
            If the model was fitted on deviations from positions' means, and the positions of these
            rows are unknown.
        """
        points = self._points_of(X) if groups is None else None
        if points is not None:
            groups = positions_of(points, floats("y", y, 3))
        if groups is not None:
            return score_within(y, self.predict(X), groups, sample_weight)
        if getattr(self, "by_position_", False) or getattr(self, "offsets_", False):
            raise ValueError(
                "This model was fitted on deviations from positions' means, which plain R2 "
                "misjudges, and score got no groups: take "
                "scoring=sklearn_raacmm.metrics.repeatability_scorer(X, groups)."
            )
        return super().score(X, y, sample_weight)


def score_within(y, prediction, groups, sample_weight=None):
    """R2 of deviations within positions; plain R2 where the means of positions are not small."""
    from sklearn.metrics import r2_score  # here: predicting spares the time of importing it

    y, prediction = floats("y", y, -1), floats("prediction", prediction, -1)
    if y.shape != prediction.shape:
        raise ValueError(f"y has shape {y.shape}, but the prediction {prediction.shape}.")
    codes = Groups.encoded(groups, len(y))[1]
    weights = check_weights(sample_weight, y)
    if not Groups(codes).are_deviations(y, weights):
        return r2_score(y, prediction, sample_weight=weights)
    parts = (Groups(codes).centred(values, weights) for values in (y, prediction))
    return r2_score(*parts, sample_weight=weights, multioutput="variance_weighted")


def positions_of(points: np.ndarray, y: np.ndarray) -> np.ndarray | None:
    """Positions (n,) of residuals y (n, 3), mm: the points that they are from coincide.

    None where most poses are a position of their own, as against a tracker, or where y are from
    points of another arm than that whose probe is at `points` (n, 3), mm.
    """
    # Certificates have whole digits: from this share of the last one on nothing is cut in two.
    cells = np.floor((points - y) * 10**_DIGITS + _OFF_THE_DIGITS)
    labels, codes = np.unique(cells, axis=0, return_inverse=True)
    n_poses = len(np.unique(np.round(points, _POSE_DIGITS), axis=0))
    return codes.ravel() if 2 * len(labels) <= n_poses else None


def found_positions(
    points: np.ndarray, y: np.ndarray, weights: np.ndarray | None = None
) -> np.ndarray | None:
    """The same for a fit that was given no groups, with a finding that says how many they are.

    Rows of weight 0 have no part in it: they are put to the first position.
    """
    used = np.ones(len(y), dtype=bool) if weights is None else weights > 0
    found = positions_of(points[used], y[used])
    if found is None:
        return None
    n = found.max() + 1
    said = (
        f"{n} positions were found: the points that the {len(found)} rows of y are from coincide."
    )
    advice = "Give groups to name them; groups=False takes each row for itself."
    Finding("positions-found", said, advice, "note").report()
    codes = np.zeros(len(y), dtype=int)
    codes[used] = found
    return codes
