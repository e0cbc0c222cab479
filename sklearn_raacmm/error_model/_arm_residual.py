"""The errors of an arm, cause by cause, as one estimator that knows how far it can be trusted."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterable, Sequence
from dataclasses import replace
from numbers import Integral, Real
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.error_model._checks import (
    check_fit,
    poses_of,
)
from sklearn_raacmm.error_model._columns import CAUSES, Terms
from sklearn_raacmm.error_model._extra import with_references
from sklearn_raacmm.error_model._fading import find_fading, judge
from sklearn_raacmm.error_model._in_use import FittedArmModel
from sklearn_raacmm.error_model._left_out import leave_out, with_honest_intervals
from sklearn_raacmm.error_model._structures import offered_harmonics
from sklearn_raacmm.error_model._vertical import fit_with_vertical
from sklearn_raacmm.utils import (
    MultiOutputMixin,
    RegressorMixin,
    VersionedEstimator,
    listed,
    many_without_weight,
    one_blas_thread,
    param_checks,
    report_findings,
    whole_fit,
)


class ArmResidualRegressor(FittedArmModel, MultiOutputMixin, RegressorMixin, VersionedEstimator):
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
        from smaller angles, -1 from larger ones); "payload"; "force x", "force y", "force z" on the
        probe in the base frame.
    orders : int, array-like of int, or one array-like of int per joint, default=400
        Highest order of the harmonics offered, for every joint, up to 1000: strain-wave gears show
        at multiples of their ratio. A joint is offered no more orders than it shows different
        angles, but all above 72 where these are scattered. A list offers these orders only.
    causes : list of str, default=("gravity", "kinematics", "wobble")
        Which of these causes are in the model.
    offsets : bool or "auto", default="auto"
        Whether each position (`groups` of `fit`) has an unknown constant offset of any size. True:
        every position has one, as where `y` are deviations from the position's own mean. False: no
        position has one. "auto": True where the means of `y` over the positions are zero; else the
        evidence finds how large the offsets are.
    fade : float or "auto", default="auto"
        Shrink the correction by ``r^2 / (r^2 + fade^2 s^2)``, with s the length of its posterior
        standard deviation at this pose and r the root mean square of the training residuals. 0: not
        at all. "auto": 1, or less where four positions or more have offsets.

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
        causes: Sequence[str] = CAUSES,
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
        lengths: Iterable[Sequence[Any]] = (),
        probes: ArrayLike | None = None,
    ) -> Self:
        """Choose the harmonics, fit all coefficients, and judge the result where it was left out.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_joints + n_extra)
            Joint angles, in the unit of `angle_unit`; then the columns that `extra` names.
        y : array-like of shape (n_samples, 3)
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
            reach.

        Warns
        -----
        FindingWarning
            Of what is found in the data, such as a wrong sign or unit of `y`, an arm that is not
            calibrated, or a reference in another frame; see `findings_`. Rows in which the arm
            stood still are merged to one pose.
        """
        lengths = listed("lengths", lengths)
        rows, given = check_fit(self, X, y, sample_weight, groups, lengths, probes)
        positions = np.arange(len(rows.y)) if given is None else given
        arm, used = rows.arm, rows.weights > 0
        dwells, rows = poses_of(rows.at(used), self.extra)
        positions = np.unique(positions[used][dwells.first], return_inverse=True)[1].ravel()
        values = rows.X[:, arm.n_joints :][:, : len(self.extra)]
        extra = with_references(tuple(self.extra), values, rows.weights)
        offered = offered_harmonics(rows.X[:, : arm.n_joints], self.orders)
        gravity, kinematics, wobble = (name in self.causes for name in CAUSES)
        terms = Terms(offered, gravity, kinematics, wobble, extra)
        with_field = isinstance(self.orders, Integral)
        known = given is None or self.offsets is False  # or nobody says which rows are of one
        of_constants = None if known else positions
        fitted, terms = fit_with_vertical(rows, of_constants, terms, with_field)
        # Constants may be errors of the arm that no cause explains: intervals are as wide as these.
        with_constants = rows if fitted.rows.codes is None else fitted.rows
        rows = fitted.rows
        left_out = leave_out(fitted, terms, positions, rows.weights)
        model = with_honest_intervals(fitted.model, left_out, with_constants, positions)
        robust = rows.weights * fitted.pose_weight
        fading = find_fading(rows.y, robust, rows.codes, self.fade, model.std_scale)
        self.judgement_ = None
        if given is not None and left_out is not None:
            judged = *left_out[:2], fading, robust, rows.codes, positions
            fading, self.judgement_ = judge(rows.y, *judged)
            if 0 < fading.most < 1:
                of_share = left_out, with_constants, positions, fading.most
                model = with_honest_intervals(model, *of_share)
        self.fading_ = fading
        model = replace(model, n_positions=float(positions.max() + 1))
        self.linear_model_ = model
        self.pose_weight_: np.ndarray = np.zeros(len(used))
        self.pose_weight_[used] = fitted.pose_weight[dwells.pose]
        report_findings(many_without_weight(fitted.pose_weight))
        return self

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.single_output = False
        tags.regressor_tags.poor_score = True
        return tags
