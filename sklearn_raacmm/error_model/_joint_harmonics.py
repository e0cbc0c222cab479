"""Errors of encoders, bearings and loads, found as a linear model through the arm's Jacobian."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from numbers import Integral, Real

import numpy as np
from scipy.linalg import solve_triangular
from sklearn.base import MultiOutputMixin, RegressorMixin
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.arm import Arm, check_angles, points_of
from sklearn_raacmm.error_model._block_selection import select_blocks
from sklearn_raacmm.error_model._columns import (
    FAMILIES,
    HARMONIC,
    Terms,
    scale_direction,
    term_columns,
    term_names,
)
from sklearn_raacmm.error_model._fit_checks import check_fit
from sklearn_raacmm.error_model._normal_equations import (
    length_equations,
    mean_columns,
    normal_equations,
)
from sklearn_raacmm.utils import (
    Interval,
    StrOptions,
    VersionedEstimator,
    centred,
    check_features,
    chunks,
    fit_context,
    group_means,
    one_blas_thread,
)

# Poses predicted at a time.
_CHUNK = 2048
# Farther off than this, in standard deviations of a coordinate, a pose has no weight: of normal
# errors in space one in 200 000 is. The median distance of such errors; rounds; when to stop.
_OUTLIER = 5.5
_MEDIAN_OF_CHI3 = 1.5382
_ROBUST_ROUNDS = 4
_SETTLED_WEIGHT = 0.05

_HARMONIC_DTYPE = np.dtype(
    [
        ("joint", "i4"),
        ("order", "i4"),
        ("amplitude_arcsec", "f8"),
        ("phase_deg", "f8"),
        ("cos_arcsec", "f8"),
        ("sin_arcsec", "f8"),
        ("cos_sd_arcsec", "f8"),
        ("sin_sd_arcsec", "f8"),
        ("log_bayes_factor", "f8"),
    ]
)


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

    n_harmonics : int, default=72
        Highest order offered, for every joint. A higher one costs time, hardly accuracy: what a
        harmonic has to explain to be taken grows with the number offered.

    gravity, kinematics, wobble : bool, default=True
        Which of the other causes are in the model.

    prior_sd : float or "auto", default="auto"
        Standard deviation that the cosine and sine of a harmonic have before any data are seen, in
        arc seconds. "auto" lets the data decide, as always for the other causes.

    offsets : bool or "auto", default="auto"
        Whether each position (`groups` of `fit`) has an unknown constant offset. It has where `y`
        are deviations from the position's own mean, as in a single-point test; it has not where
        `y` was measured against a tracker. "auto" finds out: the positions' mean residuals are
        zero, or not.

    loss : {"tukey", "squared"}, default="tukey"
        "tukey": where poses lie farther off than 5.5 standard deviations, all are weighed by
        Tukey's biweight, which gives those none, and the model is fitted again. "squared": least
        squares, which a slipped probe pulls along.

    Attributes
    ----------
    harmonics_ : structured ndarray of shape (n_chosen,)
        The harmonics found, largest first: `joint` from 1, `order`, `amplitude_arcsec`,
        `phase_deg` (the angle error is ``amplitude * cos(order * theta - phase)``), `cos_arcsec`
        and `sin_arcsec` with their standard deviations, and `log_bayes_factor`, by how much each
        raised the log evidence when it joined.

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

    pose_weight_ : ndarray of shape (n_samples,)
        What the loss left of the weight of each training pose: 0 for outliers.

    arm_ : Arm
        The arm in use.

    n_features_in_ : int
        Number of joints.

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
    the rise is more than the logarithm of the number of candidates. The model has no memory of the
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

    Standard deviations suppose independent noise. Where a smooth error is left they are too small.

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
        "n_harmonics": [Interval(Integral, 0, 1000, closed="both")],
        "gravity": ["boolean"],
        "kinematics": ["boolean"],
        "wobble": ["boolean"],
        "prior_sd": [Interval(Real, 0, None, closed="neither"), StrOptions({"auto"})],
        "offsets": ["boolean", StrOptions({"auto"})],
        "loss": [StrOptions({"squared", "tukey"})],
    }

    def __init__(
        self,
        arm=None,
        *,
        n_harmonics=72,
        gravity=True,
        kinematics=True,
        wobble=True,
        prior_sd="auto",
        offsets="auto",
        loss="tukey",
    ):
        self.arm = arm
        self.n_harmonics = n_harmonics
        self.gravity = gravity
        self.kinematics = kinematics
        self.wobble = wobble
        self.prior_sd = prior_sd
        self.offsets = offsets
        self.loss = loss

    @one_blas_thread
    @fit_context(prefer_skip_nested_validation=True)
    def fit(self, X, y, *, sample_weight=None, groups=None, lengths=()):
        """Choose the harmonics and fit all coefficients.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_joints)
            Joint angles in rad.

        y : array-like of shape (n_samples, 3)
            Cartesian residuals in mm, measured minus reference, in the arm's base frame.

        sample_weight : array-like of shape (n_samples,), default=None
            Weights; an integer weight is worth that many repeats of the row.

        groups : array-like of shape (n_samples,), default=None
            Label of the position of each sample, for the offsets.

        lengths : iterable of (label, label, length, standard deviation), default=()
            Known distances between two positions, mm, as in :func:`calibrate`: where positions have
            offsets, only they tell the model of what happens between positions.

        Returns
        -------
        self : object
            Fitted estimator.

        Raises
        ------
        ValueError
            If X has not one column per joint or y not three, something is NaN or infinite, a weight
            is negative or all are 0, the model has no columns at all, or ``offsets=True`` comes
            without `groups`; if y are the probe's points; if lengths name unknown positions, are
            not positive, or come without offsets.

        Warns
        -----
        UserWarning
            If angles are larger than two turns: most likely degrees; if ``kinematics=False`` and
            positions have offsets, but no `lengths` are given.
        """
        self.arm_, *data = check_fit(self, X, y, sample_weight, groups, lengths, linear=self)
        self._fit(*data, None)
        return self

    def _fit(self, X, y, weights, codes, lengths, smooth):
        """Fit, and fit again without what is too far off."""
        factor = np.ones(len(y))
        for rounds_left in range(_ROBUST_ROUNDS, -1, -1):
            self._fit_weighted(X, y, weights * factor, codes, lengths, smooth)
            if self.loss == "squared" or not rounds_left:
                break
            left = y - self._predict(X)[0]
            distance = np.linalg.norm(centred(left, codes, weights * factor), axis=1)
            scale = quantile(distance, 0.5, weights) / _MEDIAN_OF_CHI3
            share = np.square(distance / max(_OUTLIER * scale, 1e-300))
            new = np.square(np.maximum(1 - share, 0.0))
            far = np.any((share >= 1) & (weights > 0))
            settled = np.abs(new - factor).max() < _SETTLED_WEIGHT
            if not scale > 0 or settled or (rounds_left == _ROBUST_ROUNDS and not far):
                break
            factor = new
        self.pose_weight_ = factor

    def _fit_weighted(self, X, y, weights, codes, lengths, smooth):
        kept = weights > 0
        X, y, weights = X[kept], y[kept], weights[kept]
        self.offsets_ = codes is not None
        if codes is not None:
            present, codes = np.unique(codes[kept], return_inverse=True)
            codes = codes.ravel()
            place = {code: i for i, code in enumerate(present.tolist())}
            lengths = [
                (place[i], place[j], *rest) for i, j, *rest in lengths if i in place and j in place
            ]
        n_joints = self.arm_.n_joints
        offered = np.array(
            [(j, k) for j in range(n_joints) for k in range(1, self.n_harmonics + 1)], dtype=int
        ).reshape(-1, 2)
        terms = Terms(offered, self.gravity, self.kinematics, self.wobble)
        names, of_term = term_names(self.arm_, terms)
        if not len(offered) and not names:
            raise ValueError(
                "The model has no columns: n_harmonics is 0 and gravity, kinematics and wobble are "
                "all False."
            )
        equations = normal_equations(self.arm_, X, y, weights, codes, terms, smooth)
        n_pairs = len(offered)
        blocks = [np.array([2 * i, 2 * i + 1]) for i in range(n_pairs)]
        families = np.unique(of_term)
        blocks += [2 * n_pairs + np.flatnonzero(of_term == f) for f in families]
        family = np.r_[np.full(n_pairs, HARMONIC), families]
        prior_variance = np.full(len(FAMILIES), np.nan)
        if not isinstance(self.prior_sd, str):
            prior_variance[HARMONIC] = self.prior_sd**2
        found = select_blocks(
            equations.gram,
            equations.moment,
            equations.square,
            equations.n_observations,
            blocks,
            family,
            np.arange(len(blocks)) >= n_pairs,
            prior_variance,
            length_equations(self.arm_, X, weights, codes, terms, lengths) if lengths else None,
        )
        self._unpack(found, offered)
        if self.offsets_ and self.kinematics and not lengths:
            self._keep_scale(X, weights, codes)
        self._tabulate(found, offered, names, of_term)

    def _keep_scale(self, X, weights, codes):
        """Leave the distances between positions as the calibration has them, on the average.

        Positions with offsets do not show a common scale of all lengths, and whatever the prior
        makes of it would be an error in proportion to every length.
        """
        points = group_means(points_of(self.arm_, X), codes, weights)
        spread = points - points.mean(axis=0)
        size = np.square(spread).sum()
        if not size > 0:
            return
        columns = mean_columns(self.arm_, X, weights, codes, self._terms())
        scale_of = np.einsum("gc,gcp->p", spread, columns) / size
        unit = scale_direction(self.arm_, self._terms())
        self.coef_ = self.coef_ - unit * (scale_of @ self.coef_)
        self._half = self._half - np.outer(unit, scale_of @ self._half)

    def _unpack(self, found, offered):
        """Posterior with columns in the order harmonics, other terms."""
        order = np.argsort(found.columns, kind="stable")
        chosen = np.sort(np.array(found.blocks, dtype=int))
        self.column_harmonics_ = offered[chosen[chosen < len(offered)]] + [1, 0]
        self.coef_ = found.coef[order]
        identity = np.eye(len(order))
        # covariance = half @ half.T, rows in the order of coef_
        self._half = solve_triangular(found.root, identity, check_finite=False)[order]

    def _tabulate(self, found, offered, names, of_term):
        """Give the posterior its readable form."""
        chosen = np.array(found.blocks, dtype=int)
        chosen = chosen[chosen < len(offered)]
        sorted_pairs = np.sort(chosen)
        self.covariance_sd_ = np.sqrt(np.square(self._half).sum(axis=1))
        self.noise_sd_ = float(np.sqrt(found.noise_variance))
        self.n_determined_ = float(found.n_determined)
        present = {HARMONIC, *of_term.tolist()} if len(offered) else set(of_term.tolist())
        self.prior_sd_ = {
            FAMILIES[f]: float(np.sqrt(found.prior_variance[f])) for f in sorted(present)
        }
        n = 2 * len(chosen)
        pairs, sds = self.coef_[:n].reshape(-1, 2), self.covariance_sd_[:n].reshape(-1, 2)
        gain_of = dict(zip(chosen.tolist(), found.gains, strict=True))
        table = np.empty(len(chosen), dtype=_HARMONIC_DTYPE)
        table["joint"], table["order"] = self.column_harmonics_.T
        table["amplitude_arcsec"] = np.hypot(pairs[:, 0], pairs[:, 1])
        table["phase_deg"] = np.rad2deg(np.arctan2(pairs[:, 1], pairs[:, 0]))
        table["cos_arcsec"], table["sin_arcsec"] = pairs.T
        table["cos_sd_arcsec"], table["sin_sd_arcsec"] = sds.T
        table["log_bayes_factor"] = [gain_of[b] for b in sorted_pairs.tolist()]
        self.harmonics_ = table[np.argsort(-table["amplitude_arcsec"], kind="stable")]
        width = max([len(name) for name in names], default=1)
        others = [("family", "U10"), ("name", f"U{width}"), ("value", "f8"), ("sd", "f8")]
        self.terms_ = np.empty(len(names), dtype=others)
        self.terms_["family"] = [FAMILIES[f] for f in of_term]
        self.terms_["name"] = names
        self.terms_["value"], self.terms_["sd"] = self.coef_[n:], self.covariance_sd_[n:]

    def _terms(self):
        pairs = self.column_harmonics_ - [1, 0]
        return Terms(pairs, self.gravity, self.kinematics, self.wobble)

    def predict(self, X, return_std=False):
        """Predict residuals.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_joints)
            Joint angles in rad.

        return_std : bool, default=False
            Also return the standard deviation of the prediction, without noise.

        Returns
        -------
        residuals : ndarray of shape (n_samples, 3)
            dx, dy and dz in mm: subtract them from the measured points.

        std : ndarray of shape (n_samples, 3)
            Their posterior standard deviations in mm, where asked for. Far from the training poses
            they grow, to at most those of the priors.

        Raises
        ------
        sklearn.exceptions.NotFittedError
            If the model is not fitted.
        ValueError
            If X has another number of columns than the arm has joints, or holds NaN or infinity.

        Warns
        -----
        UserWarning
            If angles are larger than two turns: most likely degrees.
        """
        check_is_fitted(self)
        X = check_features(self, X, dtype=np.float64, reset=False)
        check_angles(X, X.shape[1], "rad")  # warns of degrees
        mean, std = self._predict(X, return_std)
        return (mean, std) if return_std else mean

    def _predict(self, X, return_std=False):
        terms = self._terms()
        mean, std = np.empty((len(X), 3)), np.empty((len(X), 3))
        for rows in chunks(len(X), _CHUNK):
            columns = term_columns(self.arm_, X[rows], terms)
            mean[rows] = columns @ self.coef_
            if return_std:
                std[rows] = np.sqrt(np.square(columns @ self._half).sum(axis=2))
        return mean, std

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.target_tags.single_output = False
        tags.regressor_tags.poor_score = True
        return tags


def quantile(values, share, weights):
    """Least of the values below or at which lies this share of the weights."""
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(below, share * below[-1] * (1 - 1e-12))]])
