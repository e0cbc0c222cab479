"""The whole correction as one estimator: the arm's linear model, a network, and guards on both."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from numbers import Integral, Real

import numpy as np
from sklearn.base import MultiOutputMixin, RegressorMixin, clone

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.correction._check import errors_left_out, shared_by_neighbours, verdict
from sklearn_raacmm.correction._guards import guarded
from sklearn_raacmm.correction._stages import (
    Stages,
    TrainingData,
    fit_network,
    left_by,
    network_input,
)
from sklearn_raacmm.error_model import (
    LEAST_POSITIONS,
    JointHarmonicRegressor,
    LinearOptions,
    check_fit,
    check_poses,
    check_turns,
    find_fading,
    fit_points_and_turns,
    predict_turns,
    warn_of_moved_seats,
    warn_where_unknown,
)
from sklearn_raacmm.network import RBFNetRegressor
from sklearn_raacmm.utils import (
    Interval,
    StrOptions,
    VersionedEstimator,
    centred,
    check_flags,
    encode_groups,
    fit_context,
    one_blas_thread,
    whole_fit,
)

# By the number of their stages.
MODELS = ("none", "harmonics", "harmonics+network")
# Offsets of new positions differ from those of the training positions, which the fit centred.
_CAP_OF_OFFSETS = 3.0
# For warnings: the line that calls `fit`, which three decorators wrap.
_CALLER = 5


class ArmResidualRegressor(MultiOutputMixin, RegressorMixin, VersionedEstimator):
    """Correct an arm by its linear error model and a network, as far as they have proved to help.

    :class:`JointHarmonicRegressor` takes what encoders, bearings, loads and leftovers of
    calibration do to the probe; :class:`RBFNetRegressor`, in the cylindrical frame of the probe's
    azimuth, what is smooth in the pose beyond that. Guards keep a correction from doing harm where
    there were no data.

    Subtract what `predict` returns from the measured point to correct it.

    Parameters
    ----------
    arm : Arm, default=None
        The calibrated arm. If None, the built-in six-joint arm CMM, ``Arm.from_name("aacmm6")``.

    angle_unit : {"rad", "deg"}, default="rad"
        Unit of the joint angles in `X`. Everything else is in mm and rad in either case.

    harmonics : JointHarmonicRegressor, default=None
        The options of the first stage; its `arm` and `angle_unit` are not used. Its `extra` says
        what the columns of `X` after the angles are: the network does not see these. None: its
        defaults.

    network : RBFNetRegressor, default=None
        The second stage, cloned. None: one without a constant, so that it vanishes away from its
        centres, ``RBFNetRegressor(degree=-1, max_centers=2000, random_state=0)``.

    joints : {"pose", "all"}, default="all"
        What the network sees: the pose of :class:`PoseFeatures`, or the angles of all joints.

    use : {"auto", "none", "harmonics", "harmonics+network"}, default="auto"
        How much of the model is used. "auto" lets the check decide where `groups` are given to
        `fit`, and takes all of it otherwise.

    n_folds : int, default=10
        Blocks of neighbouring positions that the check leaves out in turn, each position by itself
        if there are no more. Fewer take less time, and teach the check's models less than the final
        one will know.

    fade : float or "auto", default="auto"
        How each stage's correction is shrunk where its standard deviation is large, as
        :class:`JointHarmonicRegressor` explains it. 0: not at all.

    cap : float or None, default=None
        No correction is longer than this quantile of the lengths of the training residuals. Where
        positions have offsets of their own, residuals say nothing of the size of a correction: no
        longer than three times this quantile of the corrections of the training poses. None: no
        cap; fading does what it was for, at less cost.

    Attributes
    ----------
    linear_model_ : LinearModel
        The first stage as one value: columns, coefficients and their covariance.

    orientation_model_ : LinearModel or None
        That of points and orientations together, where orientations were given to `fit`.

    harmonics_, terms_ : structured ndarray
        The first stage's harmonics and other causes, as in :class:`JointHarmonicRegressor`.

    network_ : RBFNetRegressor or None
        The second, on radial, tangential and axial components in mm; None if it is not in use.

    use_ : str
        How much of the model `predict` uses.

    check_ : structured ndarray of shape (n_models,) or None
        For "none", "harmonics" and, if it was tried, "harmonics+network": `mean_mm`, the mean over
        positions of the mean deviation at positions of blocks left out; `gain_mm`, by how much that
        is less than without correction, and its standard error over positions `gain_se_mm`. None
        where no check was made.

    fadings_ : list of Fading
        How each stage fades: `factor`, `size_mm` and `known_mm`.

    fade_ : float
        The factor of the standard deviation in use.

    residual_rms_mm_ : float
        Root mean square length of the training residuals.

    cap_mm_ : float
        Longest correction; infinite without a cap.

    pose_weight_ : ndarray of shape (n_samples,)
        What the loss of the first stage left of the weight of each training pose: 0 for outliers,
        and for rows of weight 0.

    arm_ : Arm
        The arm in use.

    n_features_in_ : int
        Number of joints, and of extra columns.

    See Also
    --------
    JointHarmonicRegressor : The first stage alone.
    CylindricalResidualTarget : The frame of the second.

    Notes
    -----
    The check goes from no correction over the linear model to that with a network, and takes a
    model if its gain over the last one taken exceeds the standard error of that gain, and a
    thousandth. Blocks are found by k-means among the positions' mean points: a whole region is left
    out, which asks for more than an unseen position among known ones. The linear models without a
    block keep the prior variances and the noise of all poses, and choose their harmonics anew; the
    networks keep the widths and the ridge, which take most of the time to find. Poses count by
    `pose_weight_`: one slipped pose says nothing of the others.

    No network is tried where neighbouring poses do not share what the linear model leaves. With
    fewer than four positions a check says little: no network is used, and the linear model only if
    it helped at each of them.

    Examples
    --------
    >>> from sklearn_raacmm import ArmResidualRegressor
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> test = make_single_point(n_positions=8, n_poses=30, random_state=1)
    >>> model = ArmResidualRegressor(test.arm, joints="pose")
    >>> _ = model.fit(test.data, test.target, groups=test.groups)
    >>> bool(model.check_["mean_mm"][0] < 0.1)  # simulated, uncorrected
    True
    >>> corrected = test.points - model.predict(test.data)
    """

    _parameter_constraints: dict = {
        "arm": [Arm, None],
        "angle_unit": [StrOptions({"rad", "deg"})],
        "harmonics": [JointHarmonicRegressor, None],
        "network": [RBFNetRegressor, None],
        "joints": [StrOptions({"pose", "all"})],
        "use": [StrOptions({"auto", *MODELS})],
        "n_folds": [Interval(Integral, 2, None, closed="left")],
        "fade": [Interval(Real, 0, None, closed="left"), StrOptions({"auto"})],
        "cap": [Interval(Real, 0, 1, closed="right"), None],
    }

    def __init__(
        self,
        arm=None,
        *,
        angle_unit="rad",
        harmonics=None,
        network=None,
        joints="all",
        use="auto",
        n_folds=10,
        fade="auto",
        cap=None,
    ):
        self.arm = arm
        self.angle_unit = angle_unit
        self.harmonics = harmonics
        self.network = network
        self.joints = joints
        self.use = use
        self.n_folds = n_folds
        self.fade = fade
        self.cap = cap

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
        """Check the model against no correction, and fit it.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_joints + n_extra)
            Joint angles, in the unit of `angle_unit`; then the columns that the first stage's
            `extra` names.

        y : array-like of shape (n_samples, 3)
            Cartesian residuals in mm, measured minus reference, in the arm's base frame.

        sample_weight : array-like of shape (n_samples,), default=None
            Weights.

        groups : array-like of shape (n_samples,), default=None
            Label of the position of each sample: for the check, and for the positions' offsets
            where y are deviations from their means (see :class:`JointHarmonicRegressor`).

        lengths : iterable of (label, label, length, standard deviation), default=()
            Known distances between two positions, mm, for the first stage (see
            :meth:`JointHarmonicRegressor.fit`).

        orientation_residuals : array-like of shape (n_samples, 3), default=None
            Residuals of the orientation, rotation vectors in rad, for the first stage (see
            :meth:`JointHarmonicRegressor.fit`).

        Returns
        -------
        self : object
            Fitted estimator.

        Raises
        ------
        ValueError
            As :class:`JointHarmonicRegressor`.

        Warns
        -----
        UserWarning
            As :class:`JointHarmonicRegressor`.
        """
        first = JointHarmonicRegressor() if self.harmonics is None else self.harmonics
        arm, *checked = check_fit(self, X, y, sample_weight, groups, lengths, linear=first)
        X, y, weights, codes, _ = checked
        turns = check_turns(orientation_residuals, len(y), codes)
        positions = np.arange(len(X)) if groups is None else encode_groups(groups)[1]
        fitted, self.orientation_model_ = fit_points_and_turns(
            arm, checked, LinearOptions.of(first), positions, turns, self.n_folds
        )
        linear, pose_weight, left_out = fitted
        if codes is not None:
            left, noise = y - linear.predict(X)[0], linear.noise_variance
            warn_of_moved_seats(left, X[:, : arm.n_joints], weights, groups, noise, _CALLER)
        robust = weights * pose_weight
        kept = robust > 0
        inputs = network_input(arm, X, self.joints)
        data = TrainingData(X, y, robust, codes, inputs).rows(kept)
        place = np.cumsum(kept) - 1  # of each row among those that are kept
        left_out = [(place[rows[kept[rows]]], rest) for rows, rest in left_out]
        few = groups is not None and len(np.unique(positions[kept])) < LEAST_POSITIONS
        n_stages = MODELS.index(self.use) if self.use != "auto" else 1 if few else 2
        if n_stages == 2 and self.use == "auto":
            left = centred(left_by(linear, data), data.codes, data.weights)
            n_stages = 1 + shared_by_neighbours(data.network.features, left, data.weights)[1]
        stages = Stages(linear, None, self.joints)
        if n_stages == 2:
            stages = fit_network(self._new_network(), linear, data, self.joints)
        self.fadings_ = self._fadings(stages, data)
        self.residual_rms_mm_ = self.fadings_[0].size_mm
        self.cap_mm_ = self._longest(stages, data, n_stages)
        self.check_ = None
        if groups is not None and self.use == "auto" and left_out:
            places = np.unique(positions[kept], return_inverse=True)[1].ravel()
            errors = self._errors(stages, data, places, left_out, range(n_stages + 1))
            self.check_, n_stages = verdict(errors, MODELS[: n_stages + 1], True, everywhere=few)
        self.use_ = MODELS[n_stages]
        self.linear_model_ = linear
        self.network_ = stages.network if n_stages == 2 else None
        self.pose_weight_ = pose_weight

    def _new_network(self, tuned=None):
        """Network to be fitted, with the widths and the ridge of one that is `tuned`."""
        network = self.network
        if network is None:
            # Fading asks for a standard deviation at every pose: a network has it sooner than a
            # process with a centre at every row.
            network = RBFNetRegressor(degree=-1, max_centers=2000, random_state=0)
        if tuned is not None:
            # Most of the time of a network is the search for these: that is done once.
            network = clone(network).set_params(
                kernel=tuned.kernel_, length_scale=tuned.length_scale_, alpha=tuned.alpha_
            )
        return network

    def _errors(self, stages, data, positions, left_out, n_models):
        """Mean deviation of each position, left out, by each number of stages."""
        blocks = [rows for rows, _ in left_out if len(rows)]
        models = [model for rows, model in left_out if len(rows)]
        network = None if stages.network is None else self._new_network(stages.network)

        def fit(number, rest):
            if network is None:
                return Stages(models[number], None, self.joints)
            return fit_network(network, models[number], rest, self.joints)

        def guard(parts, n_rows):
            return guarded(parts, self.fadings_, self.cap_mm_, n_rows)[0]

        return errors_left_out(fit, data, positions, blocks, list(n_models), guard)

    def _fadings(self, stages, data):
        """How each stage fades."""
        stds = [std for _, std in stages.parts(data.angles, True, data.network)]
        # A network shrinks what it knows little of by itself: it fades beyond its training poses.
        known = ("auto", 1.0)[: len(stds)]
        widening = (stages.linear.std_scale, None)[: len(stds)]
        rest = data.weights, data.codes, self.fade
        return [
            find_fading(data.y, s, *rest, known=k, widening=w)
            for s, k, w in zip(stds, known, widening, strict=True)
        ]

    def _longest(self, stages, data, n_stages):
        """Longest correction, mm."""
        if self.cap is None:
            return np.inf
        of_most = {"q": self.cap, "weights": data.weights, "method": "inverted_cdf"}
        cap = np.quantile(np.linalg.norm(data.y, axis=1), **of_most)
        if data.codes is not None and n_stages:
            parts = stages.parts(data.angles, False, data.network)[:n_stages]
            own = np.linalg.norm(sum(value for value, _ in parts), axis=1)
            cap = max(cap, _CAP_OF_OFFSETS * np.quantile(own, **of_most))
        return float(cap)

    @property
    def harmonics_(self):
        return self.linear_model_.harmonic_table()

    @property
    def terms_(self):
        return self.linear_model_.term_table()

    @property
    def fade_(self):
        return self.fadings_[0].factor

    @property
    def arm_(self):
        return self.linear_model_.arm

    def predict(self, X, return_std=False, with_noise=False):
        """Predict residuals.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_joints + n_extra)
            Joint angles, in the unit of `angle_unit`; then the columns that the first stage's
            `extra` names.

        return_std : bool, default=False
            Also return the standard deviation of the correction before the guards.

        with_noise : bool, default=False
            Add the noise of a measured coordinate to it.

        Returns
        -------
        residuals : ndarray of shape (n_samples, 3)
            dx, dy and dz in mm: subtract them from the measured points.

        std : ndarray of shape (n_samples, 3)
            Standard deviations in mm, where asked for, as :meth:`JointHarmonicRegressor.predict`
            has them; the two stages' variances are added, which is too much where one makes up for
            the other.

        Warns
        -----
        UserWarning
            If less than a tenth is left of most of the corrections.
        """
        X = check_poses(self, X)
        check_flags(return_std=return_std, with_noise=with_noise)
        mean, _, parts = self._guarded(X, return_std)
        if parts and self.fadings_[0].factor > 0:
            warn_where_unknown(self.fadings_[0].share(parts[0][1]), stacklevel=2)
        if not return_std:
            return mean
        variance = sum((np.square(std) for _, std in parts), np.zeros(mean.shape))
        return mean, self.linear_model_.widened(np.sqrt(variance), with_noise)

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
            Rotation vectors in rad, as :meth:`JointHarmonicRegressor.predict_orientation` has them,
            by the first stage: 0 where it is not in use.

        std : ndarray of shape (n_samples, 3)
            Standard deviations in rad, where asked for.
        """
        mean, std, share = predict_turns(self, X, return_std, with_noise)
        if self.use_ == "none":
            mean = np.zeros_like(mean)
        else:
            warn_where_unknown(share, stacklevel=2)
        return (mean, std) if return_std else mean

    def fading(self, X):
        """Share of the correction that the guards leave at each pose.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_joints + n_extra)
            Joint angles, in the unit of `angle_unit`; then the columns that the first stage's
            `extra` names.

        Returns
        -------
        share : ndarray of shape (n_samples,)
            The smallest share of a stage that its fading leaves: 1 where nothing is faded, towards
            0 where nothing is known.
        """
        X = check_poses(self, X)
        return self._guarded(X, False)[1]

    def _guarded(self, X, return_std):
        """Guarded correction, the share of it that is left, and the stages' parts."""
        n_stages = MODELS.index(self.use_)
        if not n_stages:
            return np.zeros((len(X), 3)), np.ones(len(X)), []
        stages = Stages(self.linear_model_, self.network_, self.joints)
        fades = self.fadings_[0].factor > 0
        parts = stages.parts(X, return_std or fades)
        return *guarded(parts, self.fadings_, self.cap_mm_, len(X)), parts

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.target_tags.single_output = False
        tags.regressor_tags.poor_score = True
        return tags
