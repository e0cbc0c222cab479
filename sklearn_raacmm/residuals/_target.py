"""The frame in which the arm's residual is a function of its shape alone, at every azimuth."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, Self, overload

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import issparse
from sklearn import get_config
from sklearn.base import clone
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils import _safe_indexing, check_array, check_consistent_length, get_tags
from sklearn.utils.metadata_routing import MetadataRouter, MethodMapping, process_routing
from sklearn.utils.validation import check_is_fitted, has_fit_parameter, validate_data

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.measurements import (
    PointCorrectionMixin,
    check_targets,
    find_dwells,
    found_positions,
)
from sklearn_raacmm.residuals._cylindrical import (
    direction_of,
    ends_in_direction,
    std_to_cartesian,
    to_cartesian,
    to_cylindrical,
    without_direction,
)
from sklearn_raacmm.utils import (
    Finding,
    Floats,
    Groups,
    check_weights,
    floats,
    is_plain,
    last_step_of,
    one_warning,
    param_checks,
    refuse_disguised,
    whole_fit,
)

# Distances from the base axis that differ by less than this part are of one position.
_SAME_LEVER = 0.1


class CylindricalResidualTarget(PointCorrectionMixin):
    """Meta-estimator to regress on residuals in the cylindrical frame of the probe.

    The Cartesian residual of the probe point, measured minus reference, is turned into radial,
    tangential and axial components before the wrapped regressor sees it, and predictions are turned
    back: a :class:`~sklearn.compose.TransformedTargetRegressor` whose function depends on the
    probe's azimuth. Subtract what `predict` returns from the measured point.

    Parameters
    ----------
    regressor : object, default=None
        Regressor for the three components, cloned before fitting. If None,
        :class:`~sklearn.linear_model.LinearRegression`. A scaler of the features goes inside it.
    azimuth : "appended", callable or None, default="appended"
        Where the azimuth of the probe comes from.

        - "appended": the last two columns of `X` are its direction, cosine and sine, as
          ``PoseFeatures(arm, append_azimuth=True)`` leaves them. They are not passed on to the
          regressor. Their norm is checked, so that a scaler put in between raises.
        - callable: ``azimuth(X)`` returns it in rad, shape (n_samples,); usually ``arm.azimuth``,
          with `X` the joint angles in rad. A lambda cannot be saved.
        - None: no rotation, the Cartesian residual is learnt directly, for comparison.

    Attributes
    ----------
    regressor_ : object
        Fitted regressor, on radial, tangential and axial residuals in mm.
    by_position_ : bool
        Whether `fit` was given positions whose residuals are known up to one constant each.
    n_features_in_ : int
        Number of columns of `X` seen during fit, the appended direction included.
    feature_names_in_ : ndarray of shape (`n_features_in_`,)
        Names of the columns of `X`, where they are all text.

    Notes
    -----
    It serves as the last step of a pipeline and outermost, on joint angles: the page "Residuals and
    frames" of the documentation shows both forms. With groups they give the same predictions.
    Without, the outermost form finds the positions; the pipeline, which knows no arm, asks for
    them.

    A single-point test shows the residuals of a position up to one constant, and `groups` says
    which rows are of one position. A regressor whose `fit` takes groups is handed them, with
    metadata routing off or on, if there are more positions than features:
    :class:`~sklearn_raacmm.RBFNetRegressor` then predicts no more than shows at positions left out.
    Others are fitted as without labels. Residuals whose means at the positions are not small are
    known in full, as those against a tracker, and have no constants.

    A target of one dimension or one column has no direction and passes through unrotated; so
    does one of more than three columns if no azimuth is known.

    The model is equation (7) of Gao et al. (2020), doi 10.1177/1729881420925638, (radial,
    tangential, axial) = f(pose), with the rotation of equations (10) to (14).

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_raacmm import CylindricalResidualTarget
    >>> phi = np.linspace(0, 6, 50)
    >>> reach = np.linspace(300, 900, 50)
    >>> X = np.stack([reach, np.cos(phi), np.sin(phi)], axis=1)
    >>> y = 0.1 * np.stack([np.cos(phi), np.sin(phi), np.zeros(50)], axis=1)
    >>> model = CylindricalResidualTarget().fit(X, y)
    >>> model.regressor_.intercept_.round(6) + 0.0
    array([0.1, 0. , 0. ])
    """

    # With metadata routing on, groups are asked for without a word.
    __metadata_request__fit = {"groups": True}

    _parameter_constraints: dict = {
        "regressor": [param_checks.HasMethods(["fit", "predict"]), None],
        "azimuth": [param_checks.StrOptions({"appended"}), callable, None],
    }

    def __init__(
        self, regressor: object = None, *, azimuth: str | Callable[..., object] | None = "appended"
    ) -> None:
        self.regressor = regressor
        self.azimuth = azimuth

    @whole_fit(prefer_skip_nested_validation=False)
    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        groups: ArrayLike | bool | None = None,
        *,
        accept: str | Sequence[str] = (),
        **fit_params: Any,
    ) -> Self:
        """Fit the regressor on the residuals in the cylindrical frame.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Whatever the regressor takes, with the azimuth's direction in the two last columns if
            ``azimuth="appended"``.
        y : array-like of shape (n_samples, 3), (n_samples, 1) or (n_samples,)
            Cartesian residuals in mm, measured minus reference.
        groups : array-like of shape (n_samples,) or False, default=None
            Label of the position of each row, where residuals are known up to one constant at each
            position. ``regressor__groups`` is another name of it, for a search with metadata
            routing off, which keeps `groups` for its splitter. None: where `azimuth` is the method
            of an arm, rows are of one position if the arm's point less y is the same, and a finding
            says how many there are; elsewhere a finding asks for them where y show positions.
            False: each row is taken for itself.
        accept : str or list of str, default=()
            Codes of findings, such as "another-frame", with which the model is fitted all the same.
        **fit_params : dict
            Passed to the regressor's `fit`, such as `sample_weight`; routed by request if metadata
            routing is enabled.

        Returns
        -------
        self : object

        Raises
        ------
        ValueError
            If `y` has the wrong number of columns, or are points and no residuals in mm; if a
            sample weight is negative; if the last two columns of `X` are not a direction where they
            should be; if the azimuth is not one number per row; if something is not finite;
            FindingError, if a motion of the arm's base explains nearly all of `y`, and is not
            accepted.
        """
        X = _with_shape(X)
        validate_data(self, X, y, skip_check_array=True)
        target = floats("y", y, finite=True)
        check_consistent_length(X, target)
        groups = fit_params.pop("regressor__groups", groups)
        unasked = groups is None
        self._rotates = target.ndim == 2 and target.shape[1] == 3 and self.azimuth is not None
        if groups is False:
            groups = None
        elif groups is None and self._rotates and (arm := self._arm()) is not None:
            groups = found_positions(arm.forward(X), target)
        codes = None if groups is None else Groups.encoded(groups, len(target))[1]
        for name, value in fit_params.items():  # of which some regressors take the root
            if name.rpartition("__")[2] == "sample_weight":
                check_weights(value, target, name)
        n_targets = 1 if target.ndim == 1 else target.shape[1]
        self._drops_direction = self.azimuth == "appended" and (
            self._rotates or ends_in_direction(X)
        )
        if n_targets == 2 or (n_targets > 3 and (callable(self.azimuth) or self._drops_direction)):
            raise ValueError(
                f"y has {n_targets} columns, but a residual has 3 (dx, dy, dz in mm), or 1 to pass "
                "through unrotated."
            )
        if self._rotates:
            X, target, groups, codes, fit_params = _poses(X, target, groups, codes, fit_params)
        features, direction = self._split(X)
        if self._rotates:
            for finding in self._findings(X, target, codes, direction, unasked):
                finding.report()
            target = to_cylindrical(target, direction)
        if get_config()["enable_metadata_routing"]:
            fit_params = dict(process_routing(self, "fit", **fit_params).regressor.fit)
        self.regressor_: Any = clone(self._get_regressor())
        self.by_position_: bool = False
        try:
            if codes is not None:
                fit_params = self._by_position(features, target, groups, codes, fit_params)
            self.regressor_.fit(features, target, **fit_params)
        except ValueError as error:
            # What scikit-learn raises of a wrong parameter is a TypeError, too.
            of_parameter = isinstance(error, TypeError) or target.ndim == 1
            if of_parameter or get_tags(self.regressor_).target_tags.multi_output:
                raise
            raise ValueError(
                f"{type(self.regressor_).__name__} learns one target at a time, but y has "
                f"{n_targets} columns: wrap the last estimator of it in "
                f"sklearn.multioutput.MultiOutputRegressor. ({error})"
            ) from error
        return self

    def _findings(self, X, y, codes, direction, unasked):
        """What residuals (n, 3) show of themselves, and of positions that nobody named."""
        weights, arm = np.ones(len(y)), self._arm()
        angles = None if arm is None else arm.check_angles(X, "rad")
        offsets = codes is not None and Groups(codes).are_deviations(y, weights)
        yield from check_targets(y, weights, arm, angles, codes, offsets)
        if unasked and arm is None:
            yield from _shown_positions(direction, to_cylindrical(y, direction)[:, 1])

    def _by_position(self, features, y, groups, codes, fit_params):
        """The regressor's parameters in `fit`, with groups where it takes them."""
        from sklearn.model_selection._search import BaseSearchCV  # here: predicting spares the time

        last, prefix = last_step_of(self.regressor_)
        knows = has_fit_parameter(last, "groups")
        if get_config()["enable_metadata_routing"]:  # by request, under names without a prefix
            prefix = ""
            if knows:
                last.set_fit_request(groups=True)
        weights = check_weights(fit_params.get(f"{prefix}sample_weight"), y.reshape(len(y), -1))
        self.by_position_ = Groups(codes).are_deviations(y, weights)
        if knows and self.by_position_:
            # With no more positions than features a linear function of these imitates any
            # constants: what is learnt besides them went wrong by up to a third at places far from
            # all positions (``benchmarks/bench_chain.py``, ten positions, all joints).
            knows = codes.max() >= _n_features_of(self.regressor_, features, y)
        if knows or isinstance(last, BaseSearchCV):  # a search only splits by them
            fit_params = {f"{prefix}groups": groups} | fit_params
        return fit_params

    @overload
    def predict(
        self, X: ArrayLike, *, return_std: Literal[True], **options: Any
    ) -> tuple[Floats, Floats]: ...
    @overload
    def predict(self, X: ArrayLike, **options: Literal[False]) -> Floats: ...
    @one_warning
    def predict(self, X: ArrayLike, **predict_params: Any) -> Floats | tuple[Floats, Floats]:
        """Predict Cartesian residuals, to be subtracted from the measured points.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            As in `fit`.
        **predict_params : dict
            Passed to the regressor's `predict`, such as ``return_std=True``; routed by request if
            metadata routing is enabled.

        Returns
        -------
        residuals : ndarray of shape (n_samples, 3)
            dx, dy and dz in mm; of the shape of the training target if that was not rotated.
        std : ndarray of shape (n_samples, 3)
            Standard deviation of dx, dy and dz in mm; only with ``return_std=True``. Variances
            are rotated as those of independent radial, tangential and axial components, which is
            how scikit-learn's Gaussian process predicts them.
        """
        if "regressor_" not in vars(self):
            check_is_fitted(self)  # which takes as long as the prediction of one row
        if predict_params.get("return_cov"):
            raise ValueError(
                "return_cov=True is not supported: a covariance between rows would have to be "
                "turned by two azimuths at once. Use return_std=True."
            )
        if not is_plain(self, X):
            X = _with_shape(X)
            if np.ndim(X) == 1:
                check_array(X, estimator=self)  # for its sentence on how to reshape
            validate_data(self, X, reset=False, skip_check_array=True)
        features, direction = self._split(X)
        regressor = self.regressor_
        if get_config()["enable_metadata_routing"]:
            predict_params = process_routing(self, "predict", **predict_params).regressor.predict
        elif type(regressor) is Pipeline:
            # Its own predict asks all steps for their tags first, which takes as long as the rest.
            features, regressor = _before_last(regressor, features)
        prediction = regressor.predict(features, **predict_params)
        if not self._rotates:
            return prediction
        if not isinstance(prediction, tuple):
            return to_cartesian(prediction, direction)
        mean, std = prediction
        return to_cartesian(mean, direction), std_to_cartesian(std, direction)

    def _points_of(self, X):
        """Where the arm says that its probe is, (n, 3) in mm; None where there is no arm."""
        check_is_fitted(self)
        arm = self._arm()
        return None if arm is None or not self._rotates else arm.forward(X)

    def _arm(self):
        """The arm whose method gives the azimuth, or None."""
        method = getattr(self.azimuth, "__func__", None)
        return getattr(self.azimuth, "__self__", None) if method is Arm.azimuth else None

    def _split(self, X):
        """Split X into the regressor's features and the azimuth's direction (cos, sin), if any."""
        if self._drops_direction:
            return without_direction(X)
        if self._rotates and callable(self.azimuth):
            return X, direction_of(self.azimuth(X), X.shape[:1])
        return X, None

    def _get_regressor(self):
        if isinstance(self.regressor, type):
            raise TypeError(
                f"regressor must be an estimator instance, got the class {self.regressor.__name__}."
            )
        if self.regressor is not None:
            return self.regressor
        routing = get_config()["enable_metadata_routing"]
        from sklearn.linear_model import LinearRegression  # here: predicting spares the time

        regressor = LinearRegression()
        return regressor.set_fit_request(sample_weight=True) if routing else regressor

    def get_metadata_routing(self) -> Any:
        """Route `fit` and `predict` to the regressor; `groups` are our own, and requested."""
        methods = MethodMapping().add(caller="fit", callee="fit")
        methods.add(caller="predict", callee="predict")
        # Without the self-request a pipeline that ends here could not score with routing on.
        router = MetadataRouter(owner=self).add_self_request(self)
        return router.add(regressor=self._get_regressor(), method_mapping=methods)

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        inner = get_tags(self._get_regressor())
        tags.regressor_tags.poor_score = True
        tags.input_tags.sparse = inner.input_tags.sparse
        tags.target_tags.multi_output = inner.target_tags.multi_output
        return tags


def _shown_positions(direction: Sequence[np.ndarray], tangential: np.ndarray) -> Iterator[Finding]:
    """Finding of positions where no arm is known, and no groups were given.

    Within a position tangential residuals (n,), mm, are the distance of its point from the base
    axis times the change of the azimuth, of which `direction` is the cosine and the sine. Rows of
    one position come one after another, or are neighbours by azimuth.
    """
    azimuth, n = np.arctan2(direction[1], direction[0]), len(tangential)
    n_found = n
    for order in (np.arange(n), np.argsort(azimuth)):
        with np.errstate(invalid="ignore", divide="ignore"):
            lever = np.diff(tangential[order]) / np.diff(azimuth[order])
            alike = (lever[:-1] > 0) & (np.abs(lever[1:] / lever[:-1] - 1) < _SAME_LEVER)
        joined = np.r_[alike, False] | np.r_[False, alike] if n > 1 else alike
        n_found = min(n_found, n - int(joined.sum()))
    if 2 * n_found <= n:
        said = (
            f"No groups were given, but the {n} rows of y deviate from at most {n_found} "
            "positions: their tangential part goes with the azimuth."
        )
        advice = "Give groups, the position of each row; groups=False takes each for itself."
        yield Finding("positions-found", said, advice)


def _poses(X, y, groups, codes, fit_params):
    """The same with each pose once at which a logger wrote many rows."""
    rows = None if issparse(X) else np.asarray(X)
    # What is no table of numbers is left to the regressor.
    if rows is None or rows.ndim != 2 or rows.dtype.kind != "f" or not np.isfinite(rows).all():
        return X, y, groups, codes, fit_params
    dwells = find_dwells(rows, codes, copies_count=True)
    if not dwells.merges:
        return X, y, groups, codes, fit_params
    for finding in dwells.findings():
        finding.report()
    of_rows = [n for n, v in fit_params.items() if np.ndim(v) and len(v) == len(rows)]
    merged = {name: dwells.mean(np.asarray(fit_params[name])) for name in of_rows}
    groups, codes = (v if v is None else _safe_indexing(v, dwells.first) for v in (groups, codes))
    return _safe_indexing(X, dwells.first), dwells.mean(y), groups, codes, fit_params | merged


def _with_shape(X):
    """X as it is, but a list as an array; one without rows is refused."""
    refuse_disguised("X", X)
    X = X if hasattr(X, "shape") else np.asarray(X)
    if X.shape[:1] == (0,):
        raise ValueError(f"X has no rows, got shape {X.shape}.")
    return X


# -- a regressor that may be a pipeline: what learns, and what comes before it ---------------------


def _n_features_of(regressor, X, y):
    """Count the features that reach the last step."""
    while isinstance(regressor, Pipeline):
        if len(regressor.steps) > 1:
            X = clone(regressor[:-1]).fit_transform(X, y)
        regressor = regressor.steps[-1][1]
    return np.shape(X)[1]


def _before_last(pipeline, X):
    """Walk through a fitted pipeline once: what reaches its last step, and this step.

    By `Pipeline.predict` and the scaler's own checks one row takes 2.2 and 1.9 times as long.
    """
    while type(pipeline) is Pipeline:
        for _, step in pipeline.steps[:-1]:
            if step is None or isinstance(step, str):  # "passthrough"
                continue
            if (
                type(step) is StandardScaler
                and "_sklearn_output_config" not in vars(step)
                and get_config()["transform_output"] == "default"
                and is_plain(step, X)
                and np.isfinite(X).all()
            ):  # which would find nothing to say about X
                X = X - step.mean_ if step.with_mean else X
                X = X / step.scale_ if step.with_std else X
            else:
                X = step.transform(X)
        pipeline = pipeline.steps[-1][1]
    return X, pipeline
