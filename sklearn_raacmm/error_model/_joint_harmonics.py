"""Errors of encoders, bearings and loads, found as a linear model through the arm's Jacobian."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from numbers import Integral, Real

import numpy as np
from sklearn.base import MultiOutputMixin, RegressorMixin

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.error_model._fading import find_fading, warn_where_unknown
from sklearn_raacmm.error_model._fit_checks import check_fit, check_turns
from sklearn_raacmm.error_model._linear_fit import LinearOptions
from sklearn_raacmm.error_model._moved_seats import warn_of_moved_seats
from sklearn_raacmm.error_model._points_and_turns import fit_points_and_turns, predict_turns
from sklearn_raacmm.error_model._poses import check_poses
from sklearn_raacmm.utils import (
    Interval,
    StrOptions,
    VersionedEstimator,
    check_flags,
    encode_groups,
    fit_context,
    one_blas_thread,
    whole_fit,
)

# Of a harmonic, in arc seconds: a thousandth of what an encoder resolves, and more than a turn.
_PRIOR_BOUNDS = 1e-6, 2e6
# For warnings: the line that calls `fit`, which three decorators wrap.
_CALLER = 5


class JointHarmonicRegressor(MultiOutputMixin, RegressorMixin, VersionedEstimator):
    r"""Linear model of what the arm itself does to its probe, joint by joint.

    An encoder's error is a periodic function of its own angle,

    .. math:: \delta\theta_j = \sum_k a_{jk} \cos k\theta_j + b_{jk} \sin k\theta_j,

    and reaches the probe through the arm's Jacobian: one pair of numbers serves x, y and z, at
    every pose. Which orders k are there (an eccentric disc gives 1 and 2, gears give others) is
    found, not assumed. Beside the harmonics the model holds, each optional,

    - gravity: every link and joint yields about its three axes in proportion to the torque of each
      load beyond it, from the arm's geometry;
    - kinematics: small changes of the arm's static parameters, which calibration had to guess while
      it took the other errors for noise;
    - wobble: every axis tilts once and twice a turn about the two directions across it.

    Subtract what `predict` returns from the measured point to correct it.

    Parameters
    ----------
    arm : Arm, default=None
        The calibrated arm. If None, the built-in six-joint arm CMM, ``Arm.from_name("aacmm6")``.

    angle_unit : {"rad", "deg"}, default="rad"
        Unit of the joint angles in `X`. Everything else is in mm and rad in either case.

    extra : list of str, default=()
        What the columns of `X` after the angles are, one name for each: other causes of errors that
        were written down with the angles. Each goes through the arm's geometry and is judged by the
        evidence, as the other causes are.

        - "temperature", of the whole arm, or "temperature J", near joint J (from 1): lengths grow
          and zero offsets drift in proportion to it.
        - "direction J": the direction from which joint J came, 1 from smaller angles and -1 from
          larger ones: its backlash.
        - "payload": a weight at the probe. "force x", "force y", "force z": a force on the probe in
          the base frame, such as the probing force. All frames yield in proportion to the torque.
        - "tool": the number of the probe, where several are in use: each has offsets of its own.

        Numbers count from their mean over the training data, in whatever unit they are in.

    max_order : int, default=400
        Highest order of the harmonics offered, for every joint: strain-wave gears show at multiples
        of their ratio. Orders above 72 are taken only where they explain much, or where they are
        multiples of others that do. A joint is offered no more orders than it shows different
        angles. 0 offers none.

    orders : array-like of int, or one array-like of int per joint, default=None
        Offer these orders only, for all joints or for each, in place of those up to `max_order`.

    gear_ratio : float or array-like of shape (n_joints,), default=None
        Gear ratio of all joints or of each, where it is known; 0 where it is not. Its multiples up
        to four are offered in addition, as orders that are as likely as low ones.

    gravity, kinematics, wobble : bool, default=True
        Which of the other causes are in the model.

    prior_sd : float or "auto", default="auto"
        Standard deviation that the cosine and sine of a harmonic have before any data are seen, in
        arc seconds, from 1e-6 to 2e6. "auto" lets the data decide, as always for the other
        causes.

    offsets : bool or "auto", default="auto"
        Whether each position (`groups` of `fit`) has an unknown constant offset. It has where `y`
        are deviations from the position's own mean, as in a single-point test; it has not where
        `y` was measured against a tracker. "auto" finds out: the positions' mean residuals are
        zero, or not.

    loss : {"tukey", "squared"}, default="tukey"
        "tukey": where poses lie farther off than 5.5 standard deviations, all are weighed by
        Tukey's biweight, which gives those none, and the model is fitted again. "squared": least
        squares, which a slipped probe pulls along.

    fade : float or "auto", default="auto"
        Shrink the correction by ``r^2 / (r^2 + fade^2 max(0, s^2 - t^2))``, with s its posterior
        standard deviation at this pose and r the root mean square of the training residuals, both
        as lengths of vectors: nearly 1 where the data know, towards 0 away from them. 0: not at
        all. "auto": 1, or where positions have offsets half of the factor by which errors at
        positions left out widen s, up to 1. There t is twice the deviation that 99 % of the
        training poses stay below; elsewhere 0.

    Attributes
    ----------
    linear_model_ : LinearModel
        The fitted numbers as one value: columns, coefficients and their covariance. The attributes
        below show what is in it.

    orientation_model_ : LinearModel or None
        That of points and orientations together, where orientations were given to `fit`.

    harmonics_ : structured ndarray of shape (n_chosen,)
        The harmonics found, largest first: `joint` from 1, `order`, `amplitude_arcsec`,
        `phase_deg` (the angle error is ``amplitude * cos(order * theta - phase)``), `cos_arcsec`
        and `sin_arcsec` with their standard deviations, and `log_bayes_factor`, by how much each
        raises the log evidence beside all others. Parts of a smooth function are among them; theirs
        is about 0 each.

    terms_ : structured ndarray of shape (n_terms,)
        The other causes: `family`, `name`, `value`, `sd`. In arc seconds; for lengths in the length
        that one arc second spans at the stretched arm's reach; for loads in arc seconds under the
        torque of the load at that reach.

    prior_sd_ : dict
        Standard deviation of the coefficients of each family in these units.

    noise_sd_ : float
        Standard deviation of a coordinate about the model, mm.

    offsets_ : bool
        Whether offsets were fitted.

    n_determined_ : float
        Effective number of coefficients that the data determine.

    coef_ : ndarray of shape (n_columns,)
        Coefficients in the order of the model's columns: cosine and sine of each of
        `column_harmonics_`, then those of `terms_`.

    column_harmonics_ : ndarray of shape (n_chosen, 2)
        Joint from 1 and order of the harmonics in that order.

    fading_ : Fading
        How corrections fade: `factor`, `size_mm` (r) and `known_mm` (t).

    pose_weight_ : ndarray of shape (n_samples,)
        What the loss left of the weight of each training pose: 0 for outliers.

    arm_ : Arm
        The arm in use.

    n_features_in_ : int
        Number of joints, and of extra columns.

    feature_names_in_ : ndarray of shape (`n_features_in_`,)
        Names of the columns of `X`, where they are all text.

    See Also
    --------
    RBFNetRegressor : For what is smooth in the pose and not in this model.

    Notes
    -----
    Coefficients have normal priors of mean zero, one variance a family, found with the noise by
    maximising the marginal likelihood (MacKay's fixed point). Harmonics are chosen by orthogonal
    least squares, a pair at a time: the one that raises the marginal likelihood most, as long as
    the rise is more than the logarithm of the number of candidates. Where the data ask for it, all
    orders up to 48 that are not chosen are there, too, with one small variance that falls with the
    order (`prior_sd_` then has the entry "smooth"): each joint's error is a smooth function of its
    angle, of which little is known where there are no poses. The model has no memory of the
    number of poses but their normal equations.

    Offsets are exact fixed effects: means over the position are taken out of the columns, too. A
    common scale of all lengths then leaves no trace in the data, so that without known lengths the
    scale of the model is set to that of the calibrated arm: over the training positions, corrected
    distances are as long as uncorrected ones on the average (an inner constraint, as geodesists
    have it in free networks). On nine simulated arms this took 63 % off the errors of 500 mm
    gauges, where leaving the scale to the prior made them larger. With ``kinematics=False`` no
    column takes up what calibration left, the other causes strain the volume in its place, and
    holding the scale is no cure: `fit` warns. Known lengths are observations of their own, beside
    the noise of the two mean points.

    The scale of Tukey's biweight is the median distance; all poses count fully where none is far
    off [1]_. On simulated arms with 4 % slipped poses it was as good as without them, and never
    worse on clean ones, nor on two Pandas, one of which holds outliers.

    The posterior's standard deviations suppose that the model is complete. Of ten blocks of
    neighbouring positions, left out in turn, the errors show how much larger they have to be: they
    are compared with ``sqrt(a n^2 + b s^2)``, n the noise and s the posterior's deviation, as a
    Student variable, and a, b and its degrees of freedom have the highest posterior. With fewer
    than four positions there is nothing to compare with.

    The harmonic form is that of encoder eccentricity; the composition of the model is our own.

    References
    ----------
    .. [1] A. E. Beaton, J. W. Tukey, "The fitting of power series, meaning polynomials, illustrated
       on band-spectroscopic data", Technometrics 16(2), 1974, 147-185.

    Examples
    --------
    An eccentric encoder at joint 2, 6 arc seconds, and gear teeth at joint 4, 17 to the turn:

    >>> import numpy as np
    >>> from sklearn_raacmm import Arm, JointHarmonicRegressor
    >>> arm = Arm.from_name("aacmm6")
    >>> rng = np.random.default_rng(0)
    >>> theta = rng.uniform(-2, 2, (300, 6))
    >>> error = np.zeros_like(theta)
    >>> error[:, 1] = 6 * np.cos(theta[:, 1] - 0.5)
    >>> error[:, 3] = 4 * np.sin(17 * theta[:, 3])
    >>> error *= np.pi / 180 / 3600
    >>> y = np.einsum("nij,nj->ni", arm.jacobian(theta), error)
    >>> y += rng.normal(scale=0.003, size=y.shape)
    >>> model = JointHarmonicRegressor(arm, gravity=False, kinematics=False, wobble=False)
    >>> model.fit(theta, y).harmonics_[["joint", "order"]].tolist()
    [(2, 1), (4, 17)]
    >>> model.harmonics_["amplitude_arcsec"].round(1).tolist()
    [6.1, 4.0]
    """

    _parameter_constraints: dict = {
        "arm": [Arm, None],
        "angle_unit": [StrOptions({"rad", "deg"})],
        "extra": ["array-like"],
        "max_order": [Interval(Integral, 0, 1000, closed="both")],
        "orders": ["array-like", None],
        "gear_ratio": [Interval(Real, 0, None, closed="left"), "array-like", None],
        "gravity": ["boolean"],
        "kinematics": ["boolean"],
        "wobble": ["boolean"],
        "prior_sd": [Interval(Real, *_PRIOR_BOUNDS, closed="both"), StrOptions({"auto"})],
        "offsets": ["boolean", StrOptions({"auto"})],
        "loss": [StrOptions({"squared", "tukey"})],
        "fade": [Interval(Real, 0, None, closed="left"), StrOptions({"auto"})],
    }

    def __init__(
        self,
        arm=None,
        *,
        angle_unit="rad",
        extra=(),
        max_order=400,
        orders=None,
        gear_ratio=None,
        gravity=True,
        kinematics=True,
        wobble=True,
        prior_sd="auto",
        offsets="auto",
        loss="tukey",
        fade="auto",
    ):
        self.arm = arm
        self.angle_unit = angle_unit
        self.extra = extra
        self.max_order = max_order
        self.orders = orders
        self.gear_ratio = gear_ratio
        self.gravity = gravity
        self.kinematics = kinematics
        self.wobble = wobble
        self.prior_sd = prior_sd
        self.offsets = offsets
        self.loss = loss
        self.fade = fade

    @one_blas_thread
    @fit_context(prefer_skip_nested_validation=True)
    @whole_fit
    def fit(
        self,
        X,
        y,
        *,
        sample_weight=None,
        groups=None,
        lengths=(),
        orientation_residuals=None,
    ):
        """Choose the harmonics and fit all coefficients.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_joints + n_extra)
            Joint angles, in the unit of `angle_unit`; then the columns that `extra` names.

        y : array-like of shape (n_samples, 3)
            Cartesian residuals in mm, measured minus reference, in the arm's base frame.

        sample_weight : array-like of shape (n_samples,), default=None
            Weights; an integer weight is worth that many repeats of the row.

        groups : array-like of shape (n_samples,), default=None
            Label of the position of each sample, for the offsets.

        lengths : iterable of (label, label, length, standard deviation), default=()
            Known distances between two positions, mm, as in :func:`calibrate`: where positions have
            offsets, only they tell the model of what happens between positions.

        orientation_residuals : array-like of shape (n_samples, 3), default=None
            How far the orientation that the arm shows is turned from the measured one: rotation
            vectors in rad, in the arm's base frame, as
            :meth:`CalibrationResult.orientation_residuals` gives them. The same causes move the
            probe and turn the last link: a second model is fitted to both, each weighed by the
            noise that it shows. Points are predicted by it, too, if it is clearly better for them
            at positions left out.

        Returns
        -------
        self : object
            Fitted estimator.

        Raises
        ------
        ValueError
            If X has not one column per joint and extra name, or y not three, something is NaN or
            infinite, a weight is negative or all are 0, the model has no columns at all, or
            ``offsets=True`` comes without `groups`; if y are the probe's points, or half of them
            longer than a twentieth of the arm's reach; if lengths name unknown positions, are not
            positive, or come without offsets; if orientations come with offsets, or are no small
            rotation vectors.

        Warns
        -----
        UserWarning
            If the angles are most likely in the other unit: larger than two turns in rad, or all
            within one turn of radians in degrees; if ``kinematics=False`` and positions have
            offsets, but no `lengths` are given; if ``offsets="auto"`` finds none although the
            positions' means are smaller than chance makes them; if the weights add up to less than
            a tenth or more than a hundred times the number of rows; if nearly all of `y` is one
            motion of the base: the reference is then most likely in another frame; if what the
            model leaves at a position with an offset steps in the order of its rows, as it does
            where a socket has moved during the test (about 12 poses or more are needed to tell).
        """
        arm, *data = check_fit(self, X, y, sample_weight, groups, lengths, linear=self)
        X, y, weights, codes, _ = data
        options = LinearOptions.of(self)
        turns = check_turns(orientation_residuals, len(y), codes)
        positions = np.arange(len(y)) if groups is None else encode_groups(groups)[1]
        fitted, both = fit_points_and_turns(arm, data, options, positions, turns)
        self.orientation_model_ = both
        self.linear_model_, self.pose_weight_ = fitted.model, fitted.pose_weight
        mean, std = fitted.model.predict(X, return_std=True)
        if codes is not None:
            noise = fitted.model.noise_variance
            warn_of_moved_seats(y - mean, X[:, : arm.n_joints], weights, groups, noise, _CALLER)
        used, widening = weights * self.pose_weight_, fitted.model.std_scale
        self.fading_ = find_fading(y, std, used, codes, self.fade, widening=widening)

    # The fitted numbers in readable form; all of them are those of `linear_model_`.

    @property
    def harmonics_(self):
        return self.linear_model_.harmonic_table()

    @property
    def terms_(self):
        return self.linear_model_.term_table()

    @property
    def column_harmonics_(self):
        return np.add(self.linear_model_.terms.harmonics, (1, 0))

    @property
    def coef_(self):
        return self.linear_model_.coef

    @property
    def coef_sd_(self):
        return self.linear_model_.coef_sd

    @property
    def prior_sd_(self):
        return self.linear_model_.prior_sd

    @property
    def noise_sd_(self):
        return self.linear_model_.noise_sd

    @property
    def n_determined_(self):
        return self.linear_model_.n_determined

    @property
    def offsets_(self):
        return self.linear_model_.offsets

    @property
    def arm_(self):
        return self.linear_model_.arm

    def predict(self, X, return_std=False, with_noise=False):
        """Predict residuals.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_joints + n_extra)
            Joint angles, in the unit of `angle_unit`; then the columns that `extra` names.

        return_std : bool, default=False
            Also return the standard deviation of the correction before it fades.

        with_noise : bool, default=False
            Add the noise of a measured coordinate to the standard deviation: of the residual that
            a new measurement shows, rather than of the correction.

        Returns
        -------
        residuals : ndarray of shape (n_samples, 3)
            dx, dy and dz in mm: subtract them from the measured points.

        std : ndarray of shape (n_samples, 3)
            Standard deviations in mm, where asked for: 1.96 of them make an interval of 95 % at
            positions that were left out of the fit, as far as these could be tried. Far from the
            training poses they grow. Where positions have offsets they are those of what such a
            test can show: a motion of the base is left out.

        Raises
        ------
        sklearn.exceptions.NotFittedError
            If the model is not fitted.
        ValueError
            If X has another number of columns than in `fit`, holds NaN or infinity, or has a tool
            that the training data did not have.

        Warns
        -----
        UserWarning
            If the angles are most likely in the other unit: larger than two turns in rad, or all
            within one turn of radians in degrees; if most of the corrections
            are reduced to less than a tenth.
        """
        check_flags(return_std=return_std, with_noise=with_noise)
        X = check_poses(self, X)
        fades = self.fading_.factor > 0
        mean, std = self.linear_model_.predict(X, return_std or fades)
        if fades:
            share = self.fading_.share(std)
            warn_where_unknown(share, stacklevel=2)
            mean = share[:, None] * mean
        return (mean, self.linear_model_.widened(std, with_noise)) if return_std else mean

    def predict_orientation(self, X, return_std=False, with_noise=False):
        """Predict how far the last link is turned from where the arm shows it.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_joints + n_extra)
            As for `predict`.

        return_std : bool, default=False
            Also return standard deviations.

        with_noise : bool, default=False
            Add the noise of a measured component to them, where orientations were in the fit.

        Returns
        -------
        turns : ndarray of shape (n_samples, 3)
            Rotation vectors in rad, in the arm's base frame: with R the matrix of one, ``R.T``
            times the orientation that the arm shows is the corrected one. Faded as the correction
            of the points is.

        std : ndarray of shape (n_samples, 3)
            Standard deviations in rad, where asked for.

        Notes
        -----
        A model that was fitted to points only knows of the orientation what the same causes do to
        it. It does not know what no point shows, such as the zero angle of a last joint whose axis
        goes through the probe.
        """
        mean, std, share = predict_turns(self, X, return_std, with_noise)
        warn_where_unknown(share, stacklevel=2)
        return (mean, std) if return_std else mean

    def fading(self, X):
        """Share of the correction that `predict` returns at each pose.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_joints + n_extra)
            Joint angles, in the unit of `angle_unit`; then the columns that `extra` names.

        Returns
        -------
        share : ndarray of shape (n_samples,)
            1 where nothing is faded, towards 0 where nothing is known.
        """
        X = check_poses(self, X)
        return self.fading_.share(self.linear_model_.predict(X, return_std=True)[1])

    def distance_std(self, X1, X2):
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
        return self.linear_model_.std_scale * self.linear_model_.distance_std(X1, X2)

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.target_tags.single_output = False
        tags.regressor_tags.poor_score = True
        return tags
