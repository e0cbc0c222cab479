"""Radial basis function network regression with centres chosen by orthogonal least squares."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable, Sequence
from numbers import Integral, Real
from typing import Any, Literal, Self, overload

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag
from sklearn.utils import check_random_state, check_scalar

from sklearn_raacmm.network._fit import fit_outputs, reweigh
from sklearn_raacmm.network._kernels import KERNELS, Kernel
from sklearn_raacmm.network._posterior import Network, pack, predict_mean
from sklearn_raacmm.network._read import check_parameters, read_data
from sklearn_raacmm.network._rows import distinct_rows
from sklearn_raacmm.utils import (
    Floats,
    VersionedRegressor,
    check_features,
    check_flags,
    check_shapes,
    one_blas_thread,
    param_checks,
    whole_fit,
)

Interval, StrOptions = param_checks.Interval, param_checks.StrOptions
# Attributes that not every fit has.
_SOMETIMES = ("log_marginal_likelihood_value_", "row_weight_")


def _each_output(find: Callable[[Network], np.ndarray]) -> Any:
    """An attribute: what a function of each network gives, in the order of the outputs."""
    return property(lambda self: self._shaped([find(network) for network in self.networks_]).T)


def _each_network(name: str) -> Any:
    """An attribute of the only network, or an array of those of each output's."""

    def find(self):
        found = [getattr(network, name) for network in self.networks_]
        return np.array(found) if found[1:] else found[0]

    return property(find)


class RBFNetRegressor(VersionedRegressor):
    r"""Radial basis function network with centres chosen by orthogonal least squares.

    A smooth function of a few features, from up to a million noisy rows: a Gaussian process whose
    structure is chosen by evidence, compressed to few centres,

    .. math:: f(x) = p(x) + \sum_{j=1}^{k} w_j\, \varphi\bigl(\|(x - c_j) / \ell\|\bigr).

    The order of rows does not matter; an integer weight is so many repeats.

    Parameters
    ----------
    n_centers : int, float or "auto", default="auto"
        Number of centres of each output, or of all together with `shared`; or below 1 the share of
        the variance that they may leave [1]_. "auto": about as good as the process; more than
        300 where these are worth 2 % of the noise.

    kernel : str, callable or list of these, default="auto"
        Function of the scaled distance r: "gaussian", :math:`e^{-r^2/2}`; "matern52",
        :math:`(1 + \sqrt 5 r + 5r^2/3) e^{-\sqrt 5 r}`; "matern32",
        :math:`(1 + \sqrt 3 r) e^{-\sqrt 3 r}`; "matern12", :math:`e^{-r}`, of gradient 0 at its
        centre. "auto": the most probable, with a given `length_scale` "gaussian"; likewise of a
        list. Functions of your own: see ``sklearn_raacmm.network.radial``.

    length_scale : {"auto", "isotropic"} or float or array-like, default="auto"
        Width, in the units of X: a number, or one for each feature; infinity leaves a feature out.
        "auto" finds one for each feature, "isotropic" one for all, in standard deviations.

    alpha : float or array-like of shape (n_outputs,) or "auto", default="auto"
        Ridge, in units of the sum of sample weights: noise variance over signal variance. "auto"
        maximises the marginal likelihood [2]_, as the widths do, less a price for every feature
        used. 0 is plain least squares, for a given number of centres.

    degree : {-1, 0, 1} or "auto", default="auto"
        Degree of the polynomial p, -1 for none. "auto" is a constant, or a linear model alone where
        that is more probable.

    max_centers : int, default=None
        Most centres that a fit takes. None: 2000, or all of up to 10 000 rows.

    shared : bool or "scaled", default=False
        Whether outputs share a network, by the trace of the error reduction in units of `y`, where
        large numbers count most (True), or of standard deviations ("scaled").

    loss : {"auto", "squared", "tukey"}, default="auto"
        "tukey": rows more than 5.5 standard deviations off get no weight, by the biweight [3]_.
        "auto" takes this where it makes the rows more probable than least squares does, for at most
        an eighth of the rows. It needs widths or ridge to be found, and at most 100 000 rows.

    inputs : {"auto", "raw", "ranks"}, default="auto"
        What radial functions see: "raw", the features; "ranks", for few or uneven values: the share
        of the training rows below a value and half of those that have it, which is the unit of the
        widths. "auto": the more probable.

    random_state : int, RandomState instance or None, default=None
        Draws rows for the search of widths, and candidates for centres.

    Attributes
    ----------
    networks_ : tuple of Network
        A network for each output, or one for all.

    centers_ : ndarray of shape (n_centers, n_features)
        Centres, in the order of selection, of one network after another.

    center_indices_ : ndarray of shape (n_centers,)
        Rows of the centres in X. Of candidates that explain the same, to 1e-9, the first in the
        order of their features is taken.

    coef_ : ndarray of shape (n_centers,) or (n_outputs, n_centers)
        Weights; 0 at the centres of other outputs.

    intercept_ : float or ndarray of shape (n_outputs,)
        Constant term.

    linear_coef_ : ndarray of shape (n_features,) or (n_outputs, n_features)
        Linear term.

    kernel_, inputs_, length_scale_, alpha_ : str, str, ndarray of shape (n_features,) and float
        Kernel, inputs, widths and ridge, as given or found by `fit`; of several networks arrays
        with an entry or row for each.

    noise_variance_, signal_variance_, group_std_ : float or ndarray of shape (n_outputs,)
        Variance of the noise of one observation, and variance of the function, in squared units of
        `y`; standard deviation of the groups' constants, in units of `y`.

    log_marginal_likelihood_value_ : float
        Of the rows on which `fit` compared kernels and widths, in nats, over all outputs.

    error_reduction_ : ndarray of shape (n_centers,)
        Share of the variance by which a centre lowered the objective.

    criterion_path_ : ndarray of shape (n_tried,)
        Share of the objective that is left after 1, 2 and more centres.

    n_iter_ : int
        Number of centres tried.

    stop_reason_ : str
        Why there are no more centres: "n_centers", "max_centers", "criterion", "all rows", or
        "dependent" and "rank", where all other columns are combinations of the chosen columns.

    row_weight_ : ndarray of shape (n_samples,)
        Factor of the weight of each row by a robust loss.

    See Also
    --------
    sklearn.gaussian_process.GaussianProcessRegressor : A centre at every sample.

    References
    ----------
    .. [1] S. Chen, C. F. N. Cowan, P. M. Grant, "Orthogonal least squares learning algorithm for
       radial basis function networks", IEEE Trans. Neural Networks 2(2), 1991, 302-309.
    .. [2] C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning", 2006.
    .. [3] A. E. Beaton, J. W. Tukey, "The fitting of power series", Technometrics 16, 1974.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_raacmm import RBFNetRegressor
    >>> rng = np.random.default_rng(0)
    >>> X = rng.uniform(-3, 3, size=(200, 1))
    >>> y = np.sin(2 * X[:, 0]) + 0.1 * rng.standard_normal(200)
    >>> model = RBFNetRegressor(random_state=0).fit(X, y)
    >>> len(model.centers_) < 20
    True
    >>> mean, std = model.predict([[0.5]], return_std=True)
    >>> bool(abs(mean[0] - np.sin(1.0)) < 2 * std[0])
    True
    >>> bool(abs(model.predict_gradient([[0.5]])[0, 0] - 2 * np.cos(1.0)) < 0.2)
    True
    """

    _parameter_constraints: dict = {
        "n_centers": [
            Interval(Integral, 1, None, closed="left"),
            Interval(Real, 0, 1, closed="neither"),
            StrOptions({"auto"}),
        ],
        "kernel": [StrOptions({"auto", *KERNELS}), callable, list, tuple],
        "length_scale": [
            Interval(Real, 0, None, closed="neither"),
            StrOptions({"auto", "isotropic"}),
            "array-like",
        ],
        "alpha": [Interval(Real, 0, None, closed="left"), StrOptions({"auto"}), "array-like"],
        "degree": [Interval(Integral, -1, 1, closed="both"), StrOptions({"auto"})],
        "max_centers": [Interval(Integral, 1, None, closed="left"), None],
        "shared": ["boolean", StrOptions({"scaled"})],
        "loss": [StrOptions({"auto", "squared", "tukey"})],
        "inputs": [StrOptions({"auto", "raw", "ranks"})],
        "random_state": ["random_state"],
    }

    n_features_in_: int
    _flat: bool  # y had one dimension

    def __init__(
        self,
        n_centers: int | float | str = "auto",
        *,
        kernel: str | Callable | Sequence[Kernel] = "auto",
        length_scale: ArrayLike | str = "auto",
        alpha: float | str = "auto",
        degree: int | str = "auto",
        max_centers: int | None = None,
        shared: bool | str = False,
        loss: str = "auto",
        inputs: str = "auto",
        random_state: int | np.random.RandomState | None = None,
    ) -> None:
        self.n_centers = n_centers
        self.kernel = kernel
        self.length_scale = length_scale
        self.alpha = alpha
        self.degree = degree
        self.max_centers = max_centers
        self.shared = shared
        self.loss = loss
        self.inputs = inputs
        self.random_state = random_state

    @one_blas_thread
    @whole_fit(prefer_skip_nested_validation=True)
    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        sample_weight: ArrayLike | None = None,
        groups: ArrayLike | None = None,
    ) -> Self:
        """Choose structure, widths, ridge and centres, and fit the weights.

        Parameters
        ----------
        X : array-like or dask array of shape (n_samples, n_features)
            Training rows.

        y : array-like of shape (n_samples,) or (n_samples, n_outputs)
            Targets.

        sample_weight : array-like of shape (n_samples,), default=None
            Weights; an integer weight is worth that many repeats of the row.

        groups : array-like of shape (n_samples,), default=None
            Label of each row's group, for targets known up to one constant a group, such as
            residuals from the mean point of a position. The variance of these constants is found
            with the widths. Of four groups and more the function is used as far as it shows when
            each of them is left out, and not at all where noise alone is as probable. Where groups'
            mean targets are not small beside the scatter within, they are a part of the function,
            and labels change nothing.

        Returns
        -------
        self : object
            Fitted estimator.

        Raises
        ------
        ValueError
            If X or y hold NaN, infinity, or numbers whose squares underflow; if a weight is
            negative or all are 0; if a feature whose width is to be found has numbers 3e6 spreads
            apart; if `length_scale` does not fit X, or is so narrow or wide that double precision
            does not resolve the kernel; if `alpha` is 0 and `n_centers` is to be found; if `groups`
            has missing labels, or X more than 100 000 rows with them.

        Warns
        -----
        UserWarning
            If more centres are asked for than there are distinct candidates: all are taken then.
        ConvergenceWarning
            If a limit that was not set by a parameter decided: the default number of centres, the
            rank of their factor, or the least width.
        """
        for name in _SOMETIMES:
            self.__dict__.pop(name, None)
        source = read_data(self, X, y, sample_weight, groups)
        self._fit_weighted(source)
        if self.loss != "squared":
            reweigh(self, source)
        self._packed = self.networks_, pack(self.networks_)  # or the first `predict` would keep it
        return self

    def _fit_weighted(self, source, networks=(), refit=0):
        """Fit by least squares with given weights; see `search` for refits."""
        rng = check_random_state(self.random_state)
        rows, elsewhere = distinct_rows(source, self.n_features_in_, rng)
        q = rows.Y.shape[1]
        kernels, width, alpha = check_parameters(self, rows.X, q)
        state, found = rng.get_state(), []
        for i, of in enumerate([np.arange(q)] if self.shared else np.arange(q)[:, None]):
            rng.set_state(state)  # each as if it were alone
            ridge = None if alpha is None else alpha[of]
            before = (networks[i], refit) if networks else ()
            given = kernels, width, ridge, rng
            found.append(fit_outputs(self, rows, elsewhere, of, *given, *before))
        fits, values = zip(*found, strict=True)
        networks, centers, reductions, paths, reasons = zip(*fits, strict=True)
        if values[0] is not None:
            self.log_marginal_likelihood_value_: float = sum(values)
        self.networks_: tuple[Network, ...] = networks
        self.center_indices_: np.ndarray = rows.first[np.concatenate(centers)]
        self.error_reduction_: np.ndarray = np.concatenate(reductions)
        self.criterion_path_: np.ndarray = np.concatenate(paths)
        self.stop_reason_ = ", ".join(reasons)
        self.n_iter_: int = sum(max(map(len, pair)) for pair in zip(centers, paths, strict=True))

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[False] = False) -> Floats: ...
    @overload
    def predict(
        self,
        X: ArrayLike,
        return_std: Literal[True],
        *,
        with_noise: bool = True,
        with_outliers: bool = True,
    ) -> tuple[Floats, Floats]: ...
    @overload
    def predict(
        self,
        X: ArrayLike,
        *,
        return_cov: Literal[True],
        with_noise: bool = True,
        with_outliers: bool = True,
    ) -> tuple[Floats, Floats]: ...
    def predict(
        self,
        X: ArrayLike,
        return_std: bool = False,
        return_cov: bool = False,
        with_noise: bool = True,
        with_outliers: bool = True,
    ) -> Floats | tuple[Floats, Floats]:
        """Predict targets.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Rows.

        return_std, return_cov : bool, default=False
            Also return one of these: the standard deviation, or the covariance at these rows, of
            the Gaussian process whose posterior mean the network approximates. Away from the data
            they grow to those that the process has without data.

        with_noise : bool, default=True
            Whether they are of new observations; else they are of the mean.

        with_outliers : bool, default=True
            Whether these include outliers like those of the fit.

        Returns
        -------
        y : ndarray of shape (n_samples,) or (n_samples, n_outputs)
            Predicted mean.

        y_std : ndarray of the same shape
            Where asked for.

        y_cov : ndarray of shape (n_samples, n_samples) or (n_samples, n_samples, n_outputs)
            Where asked for.

        Raises
        ------
        ValueError
            If the model is not fitted; if X has another number of features than in fit, or holds
            NaN or infinity; if both the standard deviation and the covariance are asked for.
        """
        check_flags(return_std=return_std, return_cov=return_cov)
        of = {"with_noise": with_noise, "with_outliers": with_outliers}
        check_flags(**of)
        if return_std and return_cov:
            raise ValueError("Ask for one of return_std and return_cov, not for both.")
        X = check_features(self, X, dtype=np.float64, reset=False)
        packed = vars(self).get("_packed")
        if packed is None or packed[0] is not self.networks_:
            packed = self._packed = self.networks_, pack(self.networks_)
        mean = predict_mean(packed[1], X)
        mean = mean[:, 0] if self._flat else mean
        if return_cov:
            return mean, self._shaped([part.covariance(X, **of) for part in self.networks_])
        if return_std:
            return mean, self._shaped([part.std(X, **of) for part in self.networks_])
        return mean

    def sample_y(
        self,
        X: ArrayLike,
        n_samples: int = 1,
        random_state: int | np.random.RandomState | None = 0,
        with_noise: bool = True,
    ) -> Floats:
        """Draw targets from the posterior of the Gaussian process that the network approximates.

        Parameters
        ----------
        X : array-like of shape (n_rows, n_features)
            Rows, at which values are drawn jointly: in time cubic in their number.

        n_samples : int, default=1
            Number of draws.

        random_state : int, RandomState instance or None, default=0
            Of the draws.

        with_noise : bool, default=True
            Whether to draw new observations, or values of the function.

        Returns
        -------
        ndarray of shape (n_rows, n_samples) or (n_rows, n_outputs, n_samples)
            Outputs are drawn independently of each other.

        Raises
        ------
        ValueError
            If the model is not fitted; if X has another number of features than in fit, or holds
            NaN or infinity; if the noise variance is infinite, as it is after a fit to one
            observation.

        Examples
        --------
        >>> import numpy as np
        >>> from sklearn_raacmm import RBFNetRegressor
        >>> X = np.linspace(0, 6, 50)[:, None]
        >>> model = RBFNetRegressor().fit(X, np.sin(X[:, 0]))
        >>> model.sample_y([[1.0], [2.0]], n_samples=3).shape
        (2, 3)
        """
        X = check_features(self, X, dtype=np.float64, reset=False)
        n_samples = check_scalar(n_samples, "n_samples", Integral, min_val=1)
        rng = check_random_state(random_state)
        parts = [network.sample(X, n_samples, rng, with_noise) for network in self.networks_]
        return self._shaped(parts, axis=1)

    def predict_gradient(self, X: ArrayLike) -> Floats:
        """Derivatives of the prediction by the features, in closed form.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Rows.

        Returns
        -------
        gradient : ndarray of shape (n_samples, n_features) or (n_samples, n_outputs, n_features)
            Of the mean, in units of y per unit of X.

        Raises
        ------
        ValueError
            If the model is not fitted; if X has another number of features than in fit, or holds
            NaN or infinity.
        """
        X = check_features(self, X, dtype=np.float64, reset=False)
        return self._shaped([network.gradient(X) for network in self.networks_], axis=1)

    def _shaped(self, parts, axis=-1):
        """Values of the networks' outputs, in the order of the targets' columns, as y had them."""
        order = np.argsort(np.concatenate([network.outputs for network in self.networks_]))
        values = np.take(np.concatenate(parts, axis=axis), order, axis=axis)
        return values.take(0, axis=axis) if self._flat else values

    kernel_: str | Callable | np.ndarray = _each_network("kernel")
    inputs_: str | np.ndarray = _each_network("inputs")
    length_scale_: np.ndarray = _each_network("length_scale")

    @property
    def centers_(self) -> np.ndarray:
        return np.concatenate([network.centers for network in self.networks_])

    @property
    def coef_(self) -> np.ndarray:
        coef = block_diag(*(network.coef for network in self.networks_))
        return self._shaped([coef]).T

    linear_coef_: np.ndarray = _each_output(lambda network: network.polynomial[1:])
    intercept_: np.ndarray = _each_output(lambda network: network.polynomial[0])
    alpha_: np.ndarray = _each_output(lambda network: network.alpha * network.weight_unit)
    noise_variance_: np.ndarray = _each_output(lambda network: network.noise_variance)
    signal_variance_: np.ndarray = _each_output(lambda network: network.signal_variance)
    group_std_: np.ndarray = _each_output(
        lambda network: np.sqrt(network.ratio * network.noise_variance)
    )

    def __getstate__(self) -> dict[str, object]:
        # Without what `predict` keeps from one call to the next.
        return {name: value for name, value in super().__getstate__().items() if name != "_packed"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        if "networks_" in vars(self):
            if not all(isinstance(network, Network) for network in self.networks_):
                raise ValueError("The file is damaged: networks_ holds something else.")
            outputs = np.concatenate([network.outputs for network in self.networks_])
            if not np.array_equal(np.sort(outputs), np.arange(len(outputs))):
                raise ValueError(
                    f"The file is damaged: its networks predict the outputs {outputs.tolist()}."
                )
            sizes = {"k": len(self.centers_)}
            check_shapes(type(self).__name__, vars(self), {"center_indices_": ("k",)}, sizes)
