"""The errors of an arm, cause by cause, as one estimator that knows how far it can be trusted."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import warnings
from collections.abc import Callable, Iterable, Sequence
from copy import copy
from numbers import Integral, Real
from operator import attrgetter
from typing import Any, Literal, Self, overload

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils import check_random_state, check_scalar
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.error_model._checks import check_fit, check_poses, poses_of, with_references
from sklearn_raacmm.error_model._columns import CAUSES, Terms, columns_of
from sklearn_raacmm.error_model._fit import LEAST_POSITIONS, fit_rows, offered_harmonics
from sklearn_raacmm.error_model._left_out import (
    Fading,
    Judgement,
    centre_beside_table,
    find_fading,
    judge,
    leave_out,
    share_near_and_far,
    warn_where_unknown,
    with_interval_scales,
    with_students_quantile,
)
from sklearn_raacmm.error_model._linear_model import LinearModel
from sklearn_raacmm.measurements import PointCorrectionMixin
from sklearn_raacmm.utils import (
    Finding,
    Floats,
    check_flags,
    is_dask,
    many_without_weight,
    one_blas_thread,
    param_checks,
    whole_fit,
)


class ArmResidualRegressor(PointCorrectionMixin):
    r"""Linear model of what the arm itself does to its probe, with guards against doing harm.

    An encoder's error is a periodic function of its own angle,

    .. math:: \delta\theta_j = \sum_k a_{jk} \cos k\theta_j + b_{jk} \sin k\theta_j,

    and reaches the probe through the arm's Jacobian: one pair of numbers serves x, y and z at every
    pose. Gravity, kinematics (what calibration left) and wobble of the axes are further columns.

    Take it for residuals of a calibrated arm, and subtract what `predict` returns from the measured
    point. You may need `groups` in `fit`, and `extra` where temperatures, directions or loads were
    recorded. The correction is 0 where it did not help at positions that were left out.

    Parameters
    ----------
    arm : Arm, default=None
        The calibrated arm. If None, the built-in six-joint arm CMM, ``Arm.from_name("aacmm6")``.
    angle_unit : {"rad", "deg"}, default="rad"
        Unit of the joint angles in `X`.
    extra : list of str, default=()
        What the columns of `X` after the angles are, in any unit: "temperature" of the arm or
        "temperature J" near joint J (from 1); "time"; "direction J", from which joint J came (1
        from smaller angles, -1 from larger ones); "payload"; "base height", where what it stands on
        gives way more the higher it stands; "force x", "force y", "force z" on the probe in the
        base frame.
    orders : int, array-like of int, or one array-like of int per joint, default=400
        Highest order of the harmonics offered, for every joint, up to 1000: strain-wave gears show
        at multiples of their ratio. A joint is offered at most as many orders as it has different
        angles; where these do not repeat, all above 72, too. A list offers these orders only. One
        turn of a slide is twice its travel, and waves of 4 mm and more are offered.
    causes : list of str or callable, default=("gravity", "kinematics", "wobble")
        Which of these causes are in the model, and functions that are causes: see
        `sklearn_raacmm.error_model.Column`.
    offsets : bool or "auto", default="auto"
        Whether each position (`groups` of `fit`) has an unknown constant offset of any size. True:
        every position has such an offset: choose it where `y` are deviations from the position's
        own mean. False: no position has one. "auto": True where the means of `y` over the positions
        are zero; else the evidence finds how large the offsets are.
    fade : float or "auto", default="auto"
        Shrink the correction by ``r^2 / (r^2 + fade^2 s^2)``, with s the length of its posterior
        standard deviation at this pose and r the root mean square of the training residuals. 0: not
        at all. "auto": 1, or less where there are four positions or more.

    Attributes
    ----------
    linear_model_ : LinearModel
        Columns, coefficients and their covariance.
    harmonics_ : structured ndarray of shape (n_chosen,)
        The harmonics found, largest first: `joint` from 1, `order`, `amplitude_arcsec`,
        `phase_deg` (the angle error is ``amplitude * cos(order * theta - phase)``), `cos_arcsec`
        and `sin_arcsec` with standard deviations, and `log_bayes_factor` (of the log evidence).
    terms_ : structured ndarray of shape (n_terms,)
        The other causes: `family`, `name`, `value`, `sd`, in arc seconds; for lengths in the length
        that one arc second spans at the arm's reach, for loads under their torque at that reach.
    prior_sd_ : dict
        Standard deviation of the coefficients of each family in these units.
    noise_sd_ : float
        Standard deviation of a coordinate about the model, mm.
    offsets_ : bool
        Whether offsets were fitted.
    n_determined_ : float
        Effective number of coefficients that the data determine.
    coef_ : ndarray of shape (n_columns,)
        Cosine and sine of each of `column_harmonics_`, then the values of `terms_`.
    column_harmonics_ : ndarray of shape (n_chosen, 2)
        Joint from 1 and order of each.
    fading_ : Fading
        The share of the correction that is used: `most` at positions left out; how it fades.
    helps_ : bool
        Whether any of the correction is used: whether it helped at positions left out.
    judgement_ : Judgement or None
        The numbers from which `helps_` follows. None where nothing was left out.
    findings_ : tuple of Finding
        What the fit noticed in the data.
    pose_weight_ : ndarray of shape (n_samples,)
        Weight of each training pose in the robust fit [1]_: 0 for outliers.
    arm_ : Arm
        The arm in use.

    See Also
    --------
    learn_correction : Calibrates an arm, fits this model, and judges both.

    Notes
    -----
    Coefficients have normal priors, one variance a family, found by maximising the marginal
    likelihood. An order k joins where it raises the logarithm of this likelihood by more than
    ``2 log(k)``. Intervals are widened by errors at positions left out.

    A single-point test shows no common scale: without known lengths the scale of `arm` stays.

    References
    ----------
    .. [1] A. E. Beaton, J. W. Tukey, "The fitting of power series", Technometrics 16, 1974.

    Examples
    --------
    An eccentric encoder at joint 2, 6 arc seconds, and gear teeth at joint 4, 17 to the turn:

    >>> import numpy as np
    >>> from sklearn_raacmm import Arm, ArmResidualRegressor
    >>> arm = Arm.from_name("aacmm6")
    >>> rng = np.random.default_rng(0)
    >>> theta = rng.uniform(-2, 2, (300, 6))
    >>> error = np.zeros_like(theta)
    >>> error[:, 1] = 6 * np.cos(theta[:, 1] - 0.5)
    >>> error[:, 3] = 4 * np.sin(17 * theta[:, 3])
    >>> error *= np.pi / 180 / 3600
    >>> y = np.einsum("nij,nj->ni", arm.jacobian(theta), error)
    >>> y += rng.normal(scale=0.003, size=y.shape)
    >>> model = ArmResidualRegressor(arm, causes=[]).fit(theta, y)
    >>> model.harmonics_[["joint", "order"]][:2].tolist()
    [(2, 1), (4, 17)]
    >>> model.harmonics_["amplitude_arcsec"][:2].round(1).tolist()
    [6.1, 4.0]
    """

    # What `learn_correction` says of fits of some of its rows: where gravity points, as the `up` of
    # `Terms`, where a fit of all rows knows it; whether more than robust weights is asked for.
    _vertical: Any = None
    _judged: bool = True

    # With metadata routing on, groups are asked for without a word.
    __metadata_request__fit = {"groups": True}

    _parameter_constraints: dict = {
        "arm": [Arm, None],
        "angle_unit": [param_checks.StrOptions({"rad", "deg"})],
        "extra": ["array-like"],
        "orders": [param_checks.Interval(Integral, 0, 1000, closed="both"), "array-like"],
        "causes": ["array-like"],
        "offsets": ["boolean", param_checks.StrOptions({"auto"})],
        "fade": [
            param_checks.Interval(Real, 0, None, closed="left"),
            param_checks.StrOptions({"auto"}),
        ],
    }

    def __init__(
        self,
        arm: Arm | None = None,
        *,
        angle_unit: str = "rad",
        extra: Sequence[str] = (),
        orders: ArrayLike = 400,
        causes: Sequence[str | Callable[..., object]] = CAUSES,
        offsets: bool | str = "auto",
        fade: float | str = "auto",
    ) -> None:
        self.arm = arm
        self.angle_unit = angle_unit
        self.extra = extra
        self.orders = orders
        self.causes = causes
        self.offsets = offsets
        self.fade = fade

    @one_blas_thread
    @whole_fit(prefer_skip_nested_validation=True)
    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        *,
        sample_weight: ArrayLike | None = None,
        groups: ArrayLike | bool | None = None,
        lengths: Iterable[Sequence[object]] = (),
        probes: ArrayLike | None = None,
        accept: str | Sequence[str] = (),
        features: Iterable[Sequence[object]] = (),
    ) -> Self:
        """Choose the harmonics, fit all coefficients, and judge the result where it was left out.

        Parameters
        ----------
        X : array-like or dask array of shape (n_samples, n_joints + n_extra)
            Joint angles, in the unit of `angle_unit`; then the columns that `extra` names. Of dask
            arrays the sums over rows are made by the workers.
        y : array-like or dask array of shape (n_samples, 3)
            Cartesian residuals in mm, measured minus reference, in the arm's base frame.
        sample_weight : array-like of shape (n_samples,), default=None
            Weights; an integer weight is worth that many repeats of the row. Rows of weight 0
            change nothing.
        groups : array-like of shape (n_samples,) or False, default=None
            Label of the position of each sample: for the judgement, and for the offsets. None:
            rows are of one position if the arm's point less y, the point that their residual is
            from, is the same; a finding says how many positions there are. False: each row is taken
            for itself. Known `lengths` need the labels.
        lengths : iterable of (label, label, length, standard deviation), default=()
            Known distances between two positions, mm, as in :func:`calibrate`: where positions have
            offsets, only they tell the model of what happens between positions.
        probes : array-like of shape (n_samples, 3), default=None
            Vector of the probe of each row in the last frame, mm, where several took turns:
            ``result.arms[label].probe`` of a calibration with `tools`. The causes are then learnt
            from all of them; `predict` is for the probe of `arm`, and `with_arm` for others.
        accept : str or list of str, default=()
            Codes of findings, such as "sign-of-residuals", with which the model is fitted all the
            same.
        features : iterable of (label, kind) or (label, kind, size, standard deviation), default=()
            What was touched under a label of `groups`, as in :func:`calibrate`: "plane", "sphere"
            or "cone", which others are. The sizes are those of the sphere on which the centre of
            the probe was, mm. What touches of a plane or a sphere say is taken from the points of
            the arm, not from `y`.

        Returns
        -------
        self : object
            Fitted estimator.

        Raises
        ------
        ValueError
            If shapes, labels, weights, causes or lengths do not fit together, something is NaN or
            infinite, the model has no columns at all, or ``offsets=True`` comes without `groups`;
            if `y` are the probe's points, or half of them longer than a twentieth of the arm's
            reach; FindingError, if something has to be put right before, such as the sign or the
            unit of `y`, and is not accepted.

        Warns
        -----
        FindingWarning
            Of what is found in the data, such as an arm that is not calibrated; see `findings_`.
            Rows in which the arm stood still are merged to one pose.
        """
        arrays = X, y, sample_weight, groups, probes
        if by_dask := any(map(is_dask, arrays)):
            from dask.base import compute

            arrays = compute(*arrays, traverse=False)
        X, y, sample_weight, groups, probes = arrays
        rows, given = check_fit(self, X, y, sample_weight, groups, lengths, probes, features)
        rows = rows._replace(by_dask=by_dask)
        positions = np.arange(len(rows.y)) if given is None else given
        arm, used = rows.arm, rows.weights > 0
        dwells, rows = poses_of(rows.at(used), self.extra)
        positions = np.unique(positions[used][dwells.first], return_inverse=True)[1].ravel()
        values = rows.X[:, arm.n_joints :][:, : len(self.extra)]
        extra = with_references(tuple(self.extra), values, rows.weights)
        offered = offered_harmonics(arm.phases(rows.X[:, : arm.n_joints]), self.orders, arm)
        gravity, kinematics, wobble = (name in self.causes for name in CAUSES)
        own = tuple(filter(callable, self.causes))
        terms = Terms(offered, gravity, kinematics, wobble, extra, own=own)
        with_field = isinstance(self.orders, Integral)
        known = given is None or self.offsets is False  # or nobody says which rows are of one
        of_constants = None if known else positions
        columns = columns_of(arm, terms)
        fitted = fit_rows(rows, of_constants, columns, with_field, self._vertical)
        # Constants may be errors of the arm that no cause explains: intervals are as wide as these.
        with_constants = fitted.rows
        if fitted.rows.codes is None:
            with_constants = with_constants._replace(y=rows.y)
        rows = fitted.rows
        left_out = leave_out(fitted, positions) if self._judged else None
        model = with_interval_scales(fitted.model, left_out, with_constants, positions)
        robust = rows.weights * fitted.pose_weight
        centre = centre_beside_table(fitted.rows)
        widening = model.std_scale if model.n_positions >= LEAST_POSITIONS else np.inf
        fading = find_fading(rows.y, robust, self.fade, widening, centre)
        self.judgement_: Judgement | None = None
        if given is not None and left_out is not None:
            judged = rows.y, *left_out[:2], fading, robust, centre, positions
            fading, self.judgement_ = judge(*judged)
            fading = share_near_and_far(fading, fitted, left_out, positions, centre)
            shares = fading.found(left_out[1])
            if fading.most > 0 and shares.min() < 1:
                of_shares = left_out, with_constants, positions, shares[:, None]
                model = with_interval_scales(model, *of_shares)
        if left_out is not None:
            model = with_students_quantile(model)
        self.fading_: Fading = fading
        self.linear_model_: LinearModel = model
        self.pose_weight_: np.ndarray = np.zeros(len(used))
        self.pose_weight_[used] = fitted.pose_weight[dwells.pose]
        for finding in many_without_weight(fitted.pose_weight):
            finding.report()
        return self

    # The fitted numbers in readable form; all of them are those of `linear_model_`.

    @property
    def harmonics_(self) -> np.ndarray:
        return self.linear_model_.harmonic_table()

    @property
    def terms_(self) -> np.ndarray:
        return self.linear_model_.term_table()

    @property
    def column_harmonics_(self) -> np.ndarray:
        return np.add(self.linear_model_.terms.harmonics, (1, 0))

    coef_: Any = property(attrgetter("linear_model_.coef"))
    prior_sd_: Any = property(attrgetter("linear_model_.prior_sd"))
    n_determined_: Any = property(attrgetter("linear_model_.n_determined"))
    offsets_: Any = property(attrgetter("linear_model_.offsets"))

    @property
    def noise_sd_(self) -> float:
        return self.linear_model_.noise_sd

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
    ) -> tuple[Floats, Floats]: ...
    @overload
    def predict(
        self, X: ArrayLike, *, return_cov: Literal[True], with_noise: bool = False,
        with_unseen: bool = True,
    ) -> tuple[Floats, Floats]: ...  # fmt: skip
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
        >>> from sklearn_raacmm import ArmResidualRegressor
        >>> from sklearn_raacmm.datasets import make_single_point
        >>> test = make_single_point(6, 40)  # simulated
        >>> model = ArmResidualRegressor(test.arm, orders=2)
        >>> model = model.fit(test.data, test.target, groups=test.groups)
        >>> mean, std = model.predict(test.data, return_std=True)
        >>> mean.shape, std.shape
        ((240, 3), (240, 3))
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
            std = model.std_scale * std
            if with_noise:
                noise = model.noise_scale * model.noise_sd * model.noise_ratio(X)
                std = np.hypot(std, noise)
        return (mean, np.maximum(std, least)) if return_std else mean

    def _points_of(self, X):
        """Where the arm says that its probe is, (n, 3) in mm."""
        return self.arm_.points_at(check_poses(self, X)[:, : self.arm_.n_joints])

    def with_arm(self, arm: Arm, *, stated: bool = False) -> Self:
        """Move the fitted model to another probe.

        Each cause is multiplied by the Jacobian of the new probe. A registration through the
        correction finds its vector: :func:`calibrate` with ``correction=model, free=["probe"]``.

        Parameters
        ----------
        arm : Arm
            The table that the model was fitted with, and the new probe; where the arm is mounted
            anew, another `up`, too.
        stated : bool, default=False
            Whether the vector is that of a drawing or of another instrument, and not found by
            poses: how the table has the last frame turned is then in doubt, and so in `std`.

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
        >>> y = residuals(arm) + rng.normal(scale=0.001, size=(200, 3))
        >>> model = ArmResidualRegressor(arm, orders=2).fit(angles, y)
        >>> longer = arm.replace(probe=(0, 0, 400))
        >>> left = residuals(longer) - model.with_arm(longer).predict(angles)
        >>> bool(np.linalg.norm(left) < 0.05 * np.linalg.norm(residuals(longer)))
        True
        """
        check_is_fitted(self)
        Arm.check(arm)
        old = self.linear_model_
        moved = copy(self)
        moved.arm, moved.linear_model_ = arm, old.moved(arm, stated)
        moved.fading_ = self.fading_.moved(old.arm, arm)
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
        >>> test = make_single_point(6, 25)  # simulated
        >>> model = ArmResidualRegressor(test.arm, orders=4).fit(test.data, test.target)
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
            Poses to begin at, in the unit that the model takes, such as those of
            :meth:`Arm.angles_for`; then the extra columns. Of all the angles that reach a point
            those near the start are taken, within ``arm_.limits`` where the arm has some.
        orientations : array-like of shape (n, 3, 3), default=None
            Rotation matrix that the arm's last frame is to have in its base. It is corrected, too:
            predictions at probes of other lengths say how much the last link is turned. None: any.

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
                return shift, in_rad.fading(rows)[:, None] * linear.turns(rows)

        with Finding.collected():  # of the starts, which have been checked in the model's unit
            angles = self.arm_.angles_for(points, X[:, :n], orientations, correction=correction)
        return self.arm_.in_unit(angles, self.angle_unit)

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

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.single_output = False
        tags.regressor_tags.poor_score = True
        return tags
