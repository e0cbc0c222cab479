"""The whole correction as one estimator: the arm's linear model, a network, and guards on both."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from copy import copy
from functools import partial
from numbers import Integral, Real

import numpy as np
from sklearn.base import MultiOutputMixin, RegressorMixin, clone
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.arm import Arm, check_angles, points_of
from sklearn_raacmm.correction._check import (
    FADES,
    blocks_of_positions,
    errors_left_out,
    verdict,
)
from sklearn_raacmm.correction._guards import Guard
from sklearn_raacmm.correction._stages import Stages, TrainingData, fit_stages, network_input
from sklearn_raacmm.error_model import JointHarmonicRegressor, LinearOptions, check_fit, quantile
from sklearn_raacmm.network import RBFNetRegressor
from sklearn_raacmm.utils import (
    Interval,
    StrOptions,
    VersionedEstimator,
    check_features,
    encode_groups,
    fit_context,
    one_blas_thread,
)

# By the number of their stages.
MODELS = ("none", "harmonics", "harmonics+network")
# Offsets of new positions differ from those of the training positions, which the fit centred.
_CAP_OF_OFFSETS = 3.0


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

    harmonics : JointHarmonicRegressor, default=None
        The first stage, cloned and given `arm`. None: its defaults.

    network : RBFNetRegressor, default=None
        The second stage, cloned. None: one without a constant, so that it vanishes away from its
        centres, ``RBFNetRegressor(degree=-1, random_state=0)``.

    features : {"pose", "all"}, default="all"
        What the network sees: the pose of :class:`PoseFeatures`, or the angles of all joints.

    use : {"auto", "none", "harmonics", "harmonics+network"}, default="auto"
        How much of the model is used. "auto" lets the check decide where `groups` are given to
        `fit`, and takes all of it otherwise.

    n_folds : int, default=10
        Blocks of neighbouring positions that the check leaves out in turn, each position by itself
        if there are no more. Fewer take less time, and teach the check's models less than the final
        one will know.

    fade : float or "auto", default="auto"
        Shrink each stage's correction by ``r^2 / (r^2 + (fade * s)^2)``, with s its posterior
        standard deviation at this pose and r the root mean square of the training residuals, both
        as lengths of vectors: nearly 1 where the data know, towards 0 away from them. 0: not at
        all. "auto" lets the check decide where it is made, for s supposes independent errors and
        real ones are not: the strongest fading whose mean deviation at the positions left out is at
        most 5 % (1 % where positions have offsets) above the least; 1 otherwise.

    cap : float or None, default=0.99
        No correction is longer than this quantile of the lengths of the training residuals. Where
        positions have offsets of their own, residuals say nothing of the size of a correction: no
        longer than three times this quantile of the corrections of the training poses. None: no
        cap.

    Attributes
    ----------
    linear_model_ : LinearModel
        The first stage as one value: columns, coefficients and their covariance.

    harmonics_, terms_ : structured ndarray
        The first stage's harmonics and other causes, as in :class:`JointHarmonicRegressor`.

    network_ : RBFNetRegressor or None
        The second, on radial, tangential and axial components in mm; None if it is not in use.

    use_ : str
        How much of the model `predict` uses.

    check_ : structured ndarray of shape (n_models,) or None
        For "none", "harmonics" and "harmonics+network" (or "none" and the one that `use` names):
        `fade`, the factor that suits it; `mean_mm`, the mean over positions of the mean deviation
        at positions of blocks left out; `gain_mm`, by how much that is less than without
        correction, and its standard error over positions `gain_se_mm`. None where no check was
        made.

    fade_ : float
        The factor of the standard deviation in use.

    residual_rms_mm_ : float
        Root mean square length of the training residuals.

    cap_mm_ : float
        Longest correction.

    pose_weight_ : ndarray of shape (n_samples,)
        What the loss of the first stage left of the weight of each training pose: 0 for outliers,
        and for rows of weight 0.

    arm_ : Arm
        The arm in use.

    n_features_in_ : int
        Number of joints.

    See Also
    --------
    JointHarmonicRegressor : The first stage alone.
    CylindricalResidualTarget : The frame of the second.

    Notes
    -----
    The check takes the richest model whose gain over each simpler one exceeds the standard error of
    that gain, and a thousandth. Its networks have the widths of the one of all poses, which take
    most of the time to find. Blocks are found by k-means among the positions' mean points: a whole
    region is left out, which asks for more than an unseen position among known ones.

    Examples
    --------
    >>> from sklearn_raacmm import ArmResidualRegressor
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> test = make_single_point(n_positions=8, n_poses=30, random_state=1)
    >>> model = ArmResidualRegressor(test.arm, features="pose")
    >>> _ = model.fit(test.data, test.target, groups=test.groups)
    >>> bool(model.check_["mean_mm"][0] < 0.1)  # simulated, uncorrected
    True
    >>> corrected = test.points - model.predict(test.data)
    """

    _parameter_constraints: dict = {
        "arm": [Arm, None],
        "harmonics": [JointHarmonicRegressor, None],
        "network": [RBFNetRegressor, None],
        "features": [StrOptions({"pose", "all"})],
        "use": [StrOptions({"auto", *MODELS})],
        "n_folds": [Interval(Integral, 2, None, closed="left")],
        "fade": [Interval(Real, 0, None, closed="left"), StrOptions({"auto"})],
        "cap": [Interval(Real, 0, 1, closed="right"), None],
    }

    def __init__(
        self,
        arm=None,
        *,
        harmonics=None,
        network=None,
        features="all",
        use="auto",
        n_folds=10,
        fade="auto",
        cap=0.99,
    ):
        self.arm = arm
        self.harmonics = harmonics
        self.network = network
        self.features = features
        self.use = use
        self.n_folds = n_folds
        self.fade = fade
        self.cap = cap

    @one_blas_thread
    @fit_context(prefer_skip_nested_validation=True)
    def fit(self, X, y, *, sample_weight=None, groups=None, lengths=()):
        """Check the model against no correction, and fit it.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_joints)
            Joint angles in rad.

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

        Returns
        -------
        self : object
            Fitted estimator.

        Raises
        ------
        ValueError
            As :class:`JointHarmonicRegressor`.
        """
        fitted = copy(self)  # a fit that is interrupted leaves this estimator as it was
        first = JointHarmonicRegressor() if self.harmonics is None else self.harmonics
        arm, X, y, weights, codes, lengths = check_fit(
            fitted, X, y, sample_weight, groups, lengths, linear=first
        )
        inputs = network_input(arm, X, self.features)
        data = TrainingData(X, y, weights, codes, inputs).rows(weights > 0)
        n_stages = 2 if self.use == "auto" else MODELS.index(self.use)
        fit = partial(fit_stages, arm, lengths=lengths, options=LinearOptions.of(first))
        fit = partial(fit, features=self.features)
        stages = fit(data, network=self._new_network(n_stages))
        fade = 1.0 if self.fade == "auto" else float(self.fade)
        fitted.check_ = None
        if groups is not None and n_stages and "auto" in (self.use, self.fade):
            positions = encode_groups(groups)[1][weights > 0]
            positions = np.unique(positions, return_inverse=True)[1].ravel()
            checked = self._check(fit, data, positions, stages, n_stages)
            if checked is not None:
                fitted.check_, n_stages, fade = checked
        if n_stages < 2:
            stages = stages.without_network()
        fitted.use_ = MODELS[n_stages]
        fitted.linear_model_, fitted.network_ = stages.linear, stages.network
        fitted.pose_weight_ = np.zeros(len(X))
        fitted.pose_weight_[weights > 0] = stages.pose_weight
        guard = self._guard(stages, data, n_stages)(fade)
        fitted.residual_rms_mm_, fitted.fade_, fitted.cap_mm_ = (
            guard.size_mm,
            guard.fade,
            guard.cap_mm,
        )
        self.__dict__ = fitted.__dict__
        return self

    def _new_network(self, n_stages, tuned=None):
        """Network to be fitted, or None; with the widths of one that is `tuned`."""
        if n_stages < 2:
            return None
        network = self.network
        if network is None:
            network = RBFNetRegressor(degree=-1, random_state=0)
        if tuned is not None:
            network = clone(network).set_params(
                kernel=tuned.kernel_, length_scale=tuned.length_scale_
            )
        return network

    def _check(self, fit, data, positions, stages, n_stages):
        """Table of the check, number of stages to use, and fading; None where none can be made."""
        if positions.max() < 2:
            return None
        points = points_of(stages.linear.arm, data.angles)
        blocks = blocks_of_positions(points, positions, data.weights, self.n_folds)
        if blocks is None:
            return None
        counts = [0, 1, 2] if self.use == "auto" else [0, n_stages]
        fades = FADES if self.fade == "auto" else (float(self.fade),)
        # Most of the time of a network is the search for its widths: that is done once.
        network = self._new_network(n_stages, stages.network)

        def fit_rest(rest):
            part = fit(rest, network=network)
            return part, self._guard(part, rest, n_stages)

        errors = errors_left_out(fit_rest, data, positions, blocks, counts, fades)
        models = [MODELS[n] for n in counts]
        offsets = data.codes is not None
        table, chosen = verdict(errors, models, fades, offsets, choose=self.use == "auto")
        return table, counts[chosen], float(table["fade"][chosen])

    def _guard(self, stages, data, n_stages):
        """Guard by the size of the residuals, as a function of the fading."""
        weights = data.weights * stages.pose_weight  # outliers do not say how long one may be
        size = np.linalg.norm(data.y, axis=1)
        rms = float(np.sqrt(np.average(np.square(size), weights=weights)))
        cap = np.inf
        if self.cap is not None:
            cap = quantile(size, self.cap, weights)
            if data.codes is not None and n_stages:
                parts = stages.parts(data.angles, False, data.network)[:n_stages]
                own = np.linalg.norm(sum(value for value, _ in parts), axis=1)
                cap = max(cap, _CAP_OF_OFFSETS * quantile(own, self.cap, weights))
        return partial(Guard, rms, cap_mm=cap)

    @property
    def harmonics_(self):
        return self.linear_model_.harmonic_table()

    @property
    def terms_(self):
        return self.linear_model_.term_table()

    @property
    def arm_(self):
        return self.linear_model_.arm

    def predict(self, X, return_std=False):
        """Predict residuals.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_joints)
            Joint angles in rad.

        return_std : bool, default=False
            Also return the standard deviation of the model before the guards, without noise.

        Returns
        -------
        residuals : ndarray of shape (n_samples, 3)
            dx, dy and dz in mm: subtract them from the measured points.

        std : ndarray of shape (n_samples, 3)
            Standard deviations in mm, where asked for; the two stages' variances are added, which
            is too much where one makes up for the other.
        """
        check_is_fitted(self)
        X = check_features(self, X, dtype=np.float64, reset=False)
        check_angles(X, X.shape[1], "rad")  # warns of degrees
        stages = Stages(self.linear_model_, None, self.network_, self.features)
        fades = self.fade_ > 0
        parts = stages.parts(X, return_std or fades)[: MODELS.index(self.use_)]
        guard = Guard(self.residual_rms_mm_, self.fade_, self.cap_mm_)
        mean = guard.apply(parts, len(X))
        if not return_std:
            return mean
        return mean, np.sqrt(sum((np.square(std) for _, std in parts), np.zeros(mean.shape)))

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.target_tags.single_output = False
        tags.regressor_tags.poor_score = True
        return tags
