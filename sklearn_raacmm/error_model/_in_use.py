"""A fitted model of an arm in use: its predictions, its tables, moved to a probe, the inverse."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import warnings
from copy import copy
from numbers import Integral
from typing import Any, Literal, Self, overload

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils import check_random_state, check_scalar
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.arm import Arm, angles_for, check_arm
from sklearn_raacmm.error_model._checks import check_poses
from sklearn_raacmm.error_model._fading import Fading, Judgement, warn_where_unknown
from sklearn_raacmm.error_model._linear_model import LinearModel
from sklearn_raacmm.error_model._moved import moved_fading, moved_model, turns_of
from sklearn_raacmm.residuals import PointCorrectionMixin
from sklearn_raacmm.utils import Floats, Pair, check_flags


class FittedArmModel(PointCorrectionMixin):
    """What a fitted `ArmResidualRegressor` knows and can do."""

    arm: Arm | None
    angle_unit: str
    linear_model_: LinearModel
    fading_: Fading
    judgement_: Judgement | None

    # The fitted numbers in readable form; all of them are those of `linear_model_`.

    @property
    def harmonics_(self) -> Any:
        return self.linear_model_.harmonic_table()

    @property
    def terms_(self) -> Any:
        return self.linear_model_.term_table()

    @property
    def column_harmonics_(self) -> Any:
        return np.add(self.linear_model_.terms.harmonics, (1, 0))

    @property
    def coef_(self) -> Any:
        return self.linear_model_.coef

    @property
    def prior_sd_(self) -> Any:
        return self.linear_model_.prior_sd

    @property
    def noise_sd_(self) -> float:
        return self.linear_model_.noise_sd

    @property
    def n_determined_(self) -> Any:
        return self.linear_model_.n_determined

    @property
    def offsets_(self) -> Any:
        return self.linear_model_.offsets

    @property
    def helps_(self) -> bool:
        return self.fading_.most > 0

    @property
    def arm_(self) -> Arm:
        return self.linear_model_.arm

    @overload
    def predict(
        self, X: ArrayLike, return_std: Literal[False] = False, with_noise: bool = False
    ) -> Floats: ...
    @overload
    def predict(
        self, X: ArrayLike, return_std: Literal[True], with_noise: bool = False
    ) -> Pair: ...
    @overload
    def predict(
        self, X: ArrayLike, *, return_cov: Literal[True], with_noise: bool = False,
        with_unseen: bool = True,
    ) -> Pair: ...  # fmt: skip
    def predict(
        self,
        X: ArrayLike,
        return_std: bool = False,
        with_noise: bool = False,
        *,
        return_cov: bool = False,
        with_unseen: bool = True,
    ) -> Any:
        """Predict residuals.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_joints + n_extra)
            Joint angles, in the unit of `angle_unit`; then the columns that `extra` names.
        return_std : bool, default=False
            Also return the standard deviation of the correction before it fades.
        with_noise : bool, default=False
            Add the noise of a measured coordinate to it: of the residual that a new measurement
            shows, rather than of the correction.
        return_cov : bool, default=False
            Instead of standard deviations, return the covariance of all coordinates of all poses.
        with_unseen : bool, default=True
            Whether the covariance contains what a single-point test cannot show, but a motion of
            the base: how the arm gives way as a function of the place. False: for deviations within
            a position.

        Returns
        -------
        residuals : ndarray of shape (n_samples, 3)
            dx, dy and dz in mm: subtract them from the measured points.
        std : ndarray of shape (n_samples, 3)
            In mm, where asked for: 1.96 of them make an interval of 95 % at positions that were
            left out of the fit. Where positions have offsets, without a motion of the base.
        covariance : ndarray of shape (3 n_samples, 3 n_samples)
            In mm^2, where asked for: x, y and z of the first pose, then of the next. With g the
            derivatives of a length by these coordinates, ``g @ covariance @ g`` is its variance.

        Raises
        ------
        sklearn.exceptions.NotFittedError
            If the model is not fitted.
        ValueError
            If X does not fit the model, or holds NaN or infinity; if `arm` is not the one that the
            model was fitted with: `with_arm` moves it; if `return_std` and `return_cov` are both
            asked for.

        Warns
        -----
        UserWarning
            If the angles are most likely in the other unit, or most of the corrections are reduced
            to less than a tenth.

        Examples
        --------
        For what knows one target only, a coordinate of a fitted model is a regressor. MAPIE's
        ``SplitConformalRegressor(Coordinate(model, 0), prefit=True)`` takes it, too.

        >>> from sklearn.base import BaseEstimator, RegressorMixin
        >>> from sklearn.dummy import DummyRegressor
        >>> from sklearn.ensemble import StackingRegressor
        >>> from sklearn_raacmm import ArmResidualRegressor
        >>> from sklearn_raacmm.datasets import make_single_point
        >>> class Coordinate(RegressorMixin, BaseEstimator):
        ...     fitted_ = True
        ...     def __init__(self, model, axis):
        ...         self.model, self.axis = model, axis
        ...     def fit(self, X, y):
        ...         return self
        ...     def predict(self, X):
        ...         return self.model.predict(X)[:, self.axis]
        ...     def __sklearn_is_fitted__(self):
        ...         return True
        >>> test = make_single_point(6, 40)  # simulated
        >>> X, y, first = test.data, test.target, test.groups < 4
        >>> model = ArmResidualRegressor(test.arm, orders=2)
        >>> model = model.fit(X[first], y[first], groups=test.groups[first])
        >>> parts = [("arm", Coordinate(model, 0)), ("mean", DummyRegressor().fit(X, y[:, 0]))]
        >>> stack = StackingRegressor(parts, cv="prefit").fit(X[~first], y[~first, 0])
        >>> stack.predict(X).shape
        (240,)
        """
        check_flags(
            return_std=return_std,
            with_noise=with_noise,
            return_cov=return_cov,
            with_unseen=with_unseen,
        )
        if return_std and return_cov:
            raise ValueError("return_std and return_cov cannot both be True: ask for one of them.")
        X = check_poses(self, X)
        model, fading = self.linear_model_, self.fading_
        mean, std, doubt = model.predict_with_doubt(X, return_std, fading.factor > 0)
        share = fading.share(np.zeros(len(X)) if doubt is None else doubt)
        warn_where_unknown(share, fading.most)
        mean = share[:, None] * mean
        if return_cov:
            return mean, model.joint_covariance(X, with_noise, with_unseen)
        # Without a correction the errors are at least those that the residuals had.
        least = 0.0 if self.helps_ else fading.size_mm / np.sqrt(3)
        if return_std:
            std = model.widened(std, X if with_noise else None)
        return (mean, np.maximum(std, least)) if return_std else mean

    def _points_of(self, X):
        """Where the arm says that its probe is, (n, 3) in mm."""
        return self.arm_.forward(check_poses(self, X)[:, : self.arm_.n_joints])

    def _knows_deviations_only(self):
        return self.offsets_

    def with_arm(self, arm: Arm) -> Self:
        """Move the fitted model to another probe.

        A correction of the joints belongs to every probe: each cause is multiplied by the Jacobian
        of the new one. Find its vector by a registration through the correction: :func:`calibrate`
        with ``correction=model, free=["probe"]`` moves the model by itself.

        Parameters
        ----------
        arm : Arm
            The table that the model was fitted with, and the new probe; where the arm is mounted
            anew, another `up`, too.

        Returns
        -------
        model : object of the same class
            This one is left as it is.

        Raises
        ------
        sklearn.exceptions.NotFittedError
            If the model is not fitted.
        ValueError
            If the table is another one.

        Examples
        --------
        >>> import numpy as np
        >>> from sklearn_raacmm import Arm, ArmResidualRegressor
        >>> arm = Arm.from_name("aacmm6")
        >>> rng = np.random.default_rng(0)
        >>> angles = rng.uniform(-2, 2, (200, 6))
        >>> def residuals(arm):  # encoder 5 is eccentric
        ...     return arm.jacobian(angles)[:, :, 4] * 1e-4 * np.cos(angles[:, 4:5])
        >>> y = residuals(arm) + rng.normal(scale=0.002, size=(200, 3))
        >>> model = ArmResidualRegressor(arm, orders=2).fit(angles, y)
        >>> longer = arm.replace(probe=(0, 0, 400))
        >>> left = residuals(longer) - model.with_arm(longer).predict(angles)
        >>> bool(np.linalg.norm(left) < 0.05 * np.linalg.norm(residuals(longer)))
        True
        """
        check_is_fitted(self)
        check_arm(arm)
        old = self.linear_model_
        moved = copy(self)
        moved.arm, moved.linear_model_ = arm, moved_model(old, arm)
        moved.fading_ = moved_fading(self.fading_, old.arm, arm)
        return moved

    def sample_y(
        self,
        X: ArrayLike,
        n_samples: int = 1,
        random_state: int | np.random.RandomState | None = None,
        *,
        with_noise: bool = False,
        with_unseen: bool = True,
    ) -> Floats:
        """Draw corrections of all poses together, as the posterior has them.

        Compute a result, such as a diameter or a flatness, from the corrected points of each of 200
        draws. The standard deviation of these 200 results is the standard deviation of the result.

        Parameters
        ----------
        X : array-like of shape (n_poses, n_joints + n_extra)
            As for `predict`.
        n_samples : int, default=1
            Number of draws.
        random_state : int, RandomState instance or None, default=None
            Draws the numbers.
        with_noise : bool, default=False
        with_unseen : bool, default=True
            See `predict`; the noise is independent from pose to pose.

        Returns
        -------
        residuals : ndarray of shape (n_poses, 3, n_samples)
            In mm, about what `predict` returns.

        Examples
        --------
        >>> from sklearn_raacmm import ArmResidualRegressor
        >>> from sklearn_raacmm.datasets import make_single_point
        >>> test = make_single_point(n_positions=6, n_poses=25, random_state=1)  # simulated
        >>> model = ArmResidualRegressor(test.arm, orders=4)
        >>> model = model.fit(test.data, test.target, groups=test.groups)
        >>> model.sample_y(test.data[:10], 200, random_state=0).shape
        (10, 3, 200)
        """
        check_flags(with_noise=with_noise, with_unseen=with_unseen)
        check_scalar(n_samples, "n_samples", Integral, min_val=1)
        linear, rng = self.linear_model_, check_random_state(random_state)
        X = check_poses(self, X)
        root = linear.root_at(X, with_unseen)
        draws = root @ rng.normal(size=(root.shape[1], n_samples))
        if with_noise:
            noise = linear.noise_root(X)
            noise = noise @ rng.normal(size=(len(X), noise.shape[2], n_samples))
            draws += linear.noise_scale * linear.noise_sd * noise.reshape(draws.shape)
        return self.predict(X)[:, :, None] + draws.reshape(-1, 3, n_samples)

    def angles_for(
        self, points: ArrayLike, start: ArrayLike, orientations: ArrayLike | None = None
    ) -> Floats:
        """Joint angles that bring the corrected probe to wanted points, by Newton's method.

        Parameters
        ----------
        points : array-like of shape (n, 3)
            In the arm's base frame, mm.
        start : array-like of shape (n, n_joints + n_extra) or (1, n_joints + n_extra)
            Poses to begin at, in the unit that the model takes, such as those of a program that
            knows nothing of the correction (:meth:`Arm.angles_for`); then the extra columns. Of all
            the angles that reach a point those near the start are taken, within ``arm_.limits``
            where the arm has some.
        orientations : array-like of shape (n, 3, 3), default=None
            Rotation matrix that the arm's last frame is to have in its base. It is corrected, too,
            as far as the model knows: what it predicts at probes of other lengths says how much the
            last link is turned. None: any.

        Returns
        -------
        angles : ndarray of shape (n, n_joints)
            In the unit that the model takes: ``model.correct`` of them are the points to 1e-6 mm.
            NaN where there are none.

        Raises
        ------
        ValueError
            If shapes do not fit, something is not a finite number, or an orientation no rotation.

        Warns
        -----
        UserWarning
            If points are not reached: how many, the first of them, and how near the probe came.

        Examples
        --------
        >>> import numpy as np
        >>> from sklearn_raacmm import Arm, ArmResidualRegressor
        >>> arm = Arm.from_name("ur10")
        >>> angles = np.random.default_rng(0).uniform(-2, 2, (200, 6))
        >>> model = ArmResidualRegressor(arm, orders=2)
        >>> model = model.fit(angles, arm.jacobian(angles)[:, :, 1] * 1e-4)
        >>> wanted = arm.forward(angles[:5])
        >>> found = model.angles_for(wanted, angles[:5])
        >>> bool(np.abs(model.correct(found) - wanted).max() < 1e-6)
        True
        """
        X = check_poses(self, np.asarray(start, dtype=float))
        in_rad = copy(self)
        in_rad.angle_unit = "rad"
        n, linear = self.arm_.n_joints, self.linear_model_

        def correction(angles, rows):
            extra = X[rows if len(X) > 1 else np.zeros_like(rows), n:]
            rows = np.hstack([angles, extra])
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)
                shift = in_rad.predict(rows)
                if orientations is None:
                    return shift, None
                return shift, in_rad.fading(rows)[:, None] * turns_of(linear, rows)

        angles = angles_for(self.arm_, points, X[:, :n], orientations, correction)
        return np.rad2deg(angles) if self.angle_unit == "deg" else angles

    def fading(self, X: ArrayLike) -> Floats:
        """Share of the correction that `predict` returns at each pose.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_joints + n_extra)
            As for `predict`.

        Returns
        -------
        share : ndarray of shape (n_samples,)
            1 where nothing is faded, towards 0 where nothing is known.
        """
        X = check_poses(self, X)
        return self.fading_.share(self.linear_model_.predict_with_doubt(X)[2])

    def distance_std(self, X1: ArrayLike, X2: ArrayLike) -> Floats:
        """Standard deviation of corrected lengths between two poses each, without noise.

        Parameters
        ----------
        X1, X2 : array-like of shape (n_samples, n_joints + n_extra)
            As for `predict`, at the two ends.

        Returns
        -------
        std : ndarray of shape (n_samples,)
            In mm, before the correction fades.

        Raises
        ------
        ValueError
            If X1 and X2 have different numbers of rows, or as in `predict`.
        """
        X1, X2 = check_poses(self, X1), check_poses(self, X2)
        if len(X1) != len(X2):
            raise ValueError(f"X1 has {len(X1)} poses and X2 has {len(X2)}: lengths need pairs.")
        return self.linear_model_.distance_std(X1, X2)
