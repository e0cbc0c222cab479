"""The whole correction as one estimator: the arm's linear model, a network, and guards on both."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from numbers import Integral, Real

import numpy as np
from sklearn.base import MultiOutputMixin, RegressorMixin, clone
from sklearn.cluster import KMeans
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.arm import Arm, check_angles, dh_theta, frame_columns, points_of, probe_of
from sklearn_raacmm.error_model import JointHarmonicRegressor, Smooth, check_fit, quantile
from sklearn_raacmm.network import RBFNetRegressor, kernel_matrix, psd_inverse_root
from sklearn_raacmm.residuals import pose_columns, std_to_cartesian, to_cartesian, to_cylindrical
from sklearn_raacmm.utils import (
    Interval,
    StrOptions,
    VersionedEstimator,
    centred,
    check_features,
    encode_groups,
    fit_context,
    group_means,
    one_blas_thread,
)

MODELS = ("none", "harmonics", "harmonics+network")
# What fade="auto" chooses from.
_FADES = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0)
# How much larger the mean deviation of a stronger fading may be. Where positions have offsets,
# fading also shrinks their part of the correction, by another factor at every pose: there it has to
# cost next to nothing.
_FADE_COST, _FADE_COST_OF_OFFSETS = 1.05, 1.01
# Offsets of new positions differ from those of the training positions, which the fit centred.
_CAP_OF_OFFSETS = 3.0
_CHECK_DTYPE = np.dtype(
    [
        ("model", "U17"),
        ("fade", "f8"),
        ("mean_mm", "f8"),
        ("gain_mm", "f8"),
        ("gain_se_mm", "f8"),
    ]
)


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

    joint : bool, default=False
        Fit the first stage a second time with the smooth error that the network found as part of
        the noise (generalised least squares), and the network again on what is then left. False:
        the network on what is left, and no more. With thousands of poses on a UR10 the joint fit
        was 2 % better at unseen goals; with hundreds on a Panda it was 19 % worse, for the network
        then takes noise for structure, and the first stage believes it.

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
    harmonics_ : JointHarmonicRegressor
        The first stage.

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
        "joint": ["boolean"],
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
        joint=False,
        use="auto",
        n_folds=10,
        fade="auto",
        cap=0.99,
    ):
        self.arm = arm
        self.harmonics = harmonics
        self.network = network
        self.features = features
        self.joint = joint
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
        first = JointHarmonicRegressor() if self.harmonics is None else self.harmonics
        self.arm_, X, y, weights, codes, lengths = check_fit(
            self, X, y, sample_weight, groups, lengths, linear=first
        )
        kept = weights > 0
        X, y, weights = X[kept], y[kept], weights[kept]
        codes = None if codes is None else codes[kept]
        self.check_ = None
        self.use_ = MODELS[-1] if self.use == "auto" else self.use
        self.fade_ = 1.0 if self.fade == "auto" else float(self.fade)
        richest = self.use_
        self._fit(X, y, weights, codes, lengths, richest)
        if groups is not None and self.use != "none" and "auto" in (self.use, self.fade):
            positions = np.unique(encode_groups(groups)[1][kept], return_inverse=True)[1].ravel()
            if positions.max() > 1:
                self._check(X, y, weights, positions, codes, lengths)
        if self.use_ != richest:
            self._fit(X, y, weights, codes, lengths, self.use_)
        return self

    def _fit(self, X, y, weights, codes, lengths, use, tuned=None):
        """Fit the stages in use; the network with the widths of one that is `tuned`."""
        first = JointHarmonicRegressor() if self.harmonics is None else self.harmonics
        self.harmonics_ = clone(first).set_params(arm=self.arm_)
        self.harmonics_.n_features_in_, self.harmonics_.arm_ = X.shape[1], self.arm_
        self.harmonics_._fit(X, y, weights, codes, lengths, None)
        # Outliers teach neither the network nor how long a correction may be.
        weights = weights * self.harmonics_.pose_weight_
        self.network_ = None
        if use == MODELS[-1]:
            self._fit_network(X, y, weights, codes, lengths, tuned)
        size = np.linalg.norm(y, axis=1)
        self.residual_rms_mm_ = float(np.sqrt(np.average(np.square(size), weights=weights)))
        self.cap_mm_ = np.inf
        if self.cap is not None:
            self.cap_mm_ = quantile(size, self.cap, weights)
            if codes is not None:
                own = np.linalg.norm(sum(v for v, _ in self._parts(X, use, False)), axis=1)
                own = _CAP_OF_OFFSETS * quantile(own, self.cap, weights)
                self.cap_mm_ = max(self.cap_mm_, own)

    def _fit_network(self, X, y, weights, codes, lengths, tuned):
        network = RBFNetRegressor(degree=-1, random_state=0) if self.network is None else None
        network = clone(self.network) if network is None else network
        if tuned is not None:
            network.set_params(kernel=tuned.kernel_, length_scale=tuned.length_scale_)
        F, direction = self._features(X)
        left = y - centred(self.harmonics_._predict(X)[0], codes, weights)
        self.network_ = network.fit(F, to_cylindrical(left, direction), weights)
        if not self.joint or not len(network.centers_):
            return
        if np.any(network.linear_coef_):
            return  # not a smooth error with a covariance
        self.harmonics_._fit(X, y, weights, codes, lengths, self._smooth())
        left = y - centred(self.harmonics_._predict(X)[0], codes, weights)
        if codes is not None:
            # What the network says of each position's mean, which the residuals have lost.
            mean = to_cartesian(network.predict(F), direction)
            left = left + mean - centred(mean, codes, weights)
        alpha = network.alpha_ if np.ndim(network.alpha_) == 0 else "auto"
        again = clone(network).set_params(length_scale=network.length_scale_, alpha=alpha)
        self.network_ = again.fit(F, to_cylindrical(left, direction), weights)

    def _smooth(self):
        """The network's prior, as a smooth error for the first stage's normal equations."""
        network = self.network_
        centers = network.centers_ / network.length_scale_
        inverse = psd_inverse_root(kernel_matrix(centers, centers, network.kernel_)).T

        def basis(angles):
            F = self._features(angles)[0] / network.length_scale_
            return kernel_matrix(F, centers, network.kernel_) @ inverse

        alpha = np.broadcast_to(np.asarray(network.alpha_, dtype=float), 3).copy()
        alpha[alpha <= 0] = 1e-12
        return Smooth(basis, alpha)

    def _features(self, X):
        if self.features == "all":
            F, (x, y, _) = X, points_of(self.arm_, X).T
        else:
            frames = frame_columns(self.arm_, dh_theta(self.arm_, X))
            F = np.stack(pose_columns(self.arm_, X, frames), axis=1)
            x, y, _ = probe_of(self.arm_, frames)
        azimuth = np.arctan2(y, x)
        return F, (np.cos(azimuth), np.sin(azimuth))

    def _check(self, X, y, weights, positions, codes, lengths):
        """Mean deviations at positions left out in blocks, by every model and fading."""
        points = points_of(self.arm_, X)
        means = group_means(points, positions, weights)
        n_folds = min(self.n_folds, len(np.unique(means, axis=0)))
        if n_folds < 2:
            return  # all at one place: nothing to leave out
        blocks = KMeans(n_folds, n_init=4, random_state=0).fit_predict(means)[positions]
        fades = _FADES if self.fade == "auto" else (self.fade_,)
        models = MODELS if self.use == "auto" else ("none", self.use)
        left = np.tile(y, (len(models), len(fades), 1, 1))
        for block in np.unique(blocks):
            test = blocks == block
            fold = clone(self)
            fold.arm_ = self.arm_
            own = None if codes is None else codes[~test]
            rest = X[~test], y[~test], weights[~test], own, lengths
            # Most of the time of a network is the search for its widths: that is done once.
            fold._fit(*rest, models[-1], self.network_)
            for i, name in enumerate(models):
                parts = fold._parts(X[test], name)
                for j, fade in enumerate(fades):
                    left[i, j, test] -= fold._guarded(parts, fade)
        errors = np.empty((len(models), len(fades), len(means)))
        for i, j in np.ndindex(errors.shape[:2]):
            deviation = np.linalg.norm(centred(left[i, j], codes, weights), axis=1)
            errors[i, j] = group_means(deviation, positions, weights)
        # Of fadings nearly as good as the best the strongest: a premium on what the check, inside
        # the training region, cannot see.
        allowed = _FADE_COST if codes is None else _FADE_COST_OF_OFFSETS
        means = errors.mean(axis=2)
        cheap = means <= allowed * means.min(axis=1, keepdims=True)
        fading = [int(np.flatnonzero(row).max()) for row in cheap]
        errors = errors[np.arange(len(models)), fading]
        table = np.empty(len(models), dtype=_CHECK_DTYPE)
        table["model"], table["mean_mm"] = models, errors.mean(axis=1)
        table["fade"] = np.take(fades, fading)
        gains = errors[0] - errors
        table["gain_mm"] = gains.mean(axis=1)
        table["gain_se_mm"] = gains.std(axis=1, ddof=1) / np.sqrt(errors.shape[1])
        self.check_ = table
        chosen = 0
        if self.use != "auto":
            chosen = len(models) - 1
        else:
            for i in range(1, len(models)):
                if _clearly_better(errors[i], errors[chosen]):
                    chosen = i
        self.use_, self.fade_ = models[chosen], float(table["fade"][chosen])

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
        parts = self._parts(X, self.use_, return_std or self.fade_ > 0)
        mean = self._guarded(parts, self.fade_)
        return (mean, np.sqrt(sum(np.square(std) for _, std in parts))) if return_std else mean

    def _guarded(self, parts, fade):
        """Sum of the stages, faded and capped."""
        total = 0.0
        for value, std in parts:
            if not fade > 0:
                total = total + value
                continue
            doubt = np.square(fade * std).sum(axis=1, keepdims=True)
            # Wiener's factor for errors of this size known to this uncertainty. With the length of
            # the correction for their size it would not vanish far away, where both grow.
            size = self.residual_rms_mm_**2
            total = total + value * (size / np.maximum(size + doubt, 1e-300))
        length = np.linalg.norm(total, axis=1, keepdims=True)
        return total * np.minimum(1.0, self.cap_mm_ / np.maximum(length, 1e-300))

    def _parts(self, X, use, return_std=True):
        """Mean of each stage in use, and its standard deviation or None."""
        if use == "none":
            return [(np.zeros((len(X), 3)), np.zeros((len(X), 3)))]
        mean, std = self.harmonics_._predict(X, return_std)
        parts = [(mean, std if return_std else None)]
        if use == MODELS[-1]:
            F, direction = self._features(X)
            if return_std:
                value, std = self.network_.predict(F, return_std=True, with_noise=False)
                parts.append((to_cartesian(value, direction), std_to_cartesian(std, direction)))
            else:
                parts.append((to_cartesian(self.network_.predict(F), direction), None))
        return parts

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.target_tags.single_output = False
        tags.regressor_tags.poor_score = True
        return tags


def _clearly_better(errors, others):
    """Whether errors (n_positions,) are smaller by more than the standard error of the gain.

    And by a thousandth, for a network that does next to nothing is not worth its centres.
    """
    gain = others - errors
    return gain.mean() > max(gain.std(ddof=1) / np.sqrt(len(gain)), 1e-3 * others.mean())
