"""Radial basis function network regression with centres chosen by orthogonal least squares."""

from copy import copy
from functools import partial
from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular
from sklearn.base import MultiOutputMixin, RegressorMixin
from sklearn.utils import check_random_state

from sklearn_raacmm.network._candidates import Features
from sklearn_raacmm.network._center_choice import (
    MAX_CANDIDATES,
    CenterSettings,
    choose_centers,
    choose_size,
)
from sklearn_raacmm.network._kernels import KERNELS, kernel_matrix, psd_inverse_root, psd_root
from sklearn_raacmm.network._large_data import ArrayChunks, chunked_problem, dask_chunks, is_dask
from sklearn_raacmm.network._likelihood import Data
from sklearn_raacmm.network._nested_fits import (
    nested_least_squares,
    penalise,
    stack_triangles,
    triangle_of_block,
)
from sklearn_raacmm.network._parameters import (
    PER_OUTPUT,
    check_alpha,
    check_length_scale,
    check_resolved,
    leading_bits,
    refuse_tiny,
    relevance,
    warn_of_bound,
)
from sklearn_raacmm.network._robust_loss import MAX_FITS, NORMAL_SQUARE, SETTLED, biweights
from sklearn_raacmm.network._training_data import merge, prepare
from sklearn_raacmm.network._width_search import AUTO_KERNELS, SAMPLE_ROWS, search
from sklearn_raacmm.utils import (
    Interval,
    StrOptions,
    VersionedEstimator,
    check_data,
    check_features,
    check_fitted,
    check_shapes,
    check_weights,
    chunks,
    fit_context,
    one_blas_thread,
)

# Data of more rows are read in blocks, and repeated rows not merged.
IN_MEMORY_ROWS = 100_000
# Kernel values held at a time while predicting: they stay in a core's cache.
_CHUNK = 2**18
# Attributes that not every fit has.
_SOMETIMES = ("log_marginal_likelihood_value_", "row_weight_", "_posterior_")


class RBFNetRegressor(MultiOutputMixin, RegressorMixin, VersionedEstimator):
    r"""Radial basis function network with centres chosen by orthogonal least squares.

    The model is a polynomial of low degree plus a few radial functions at centres taken from the
    training rows,

    .. math:: f(x) = p(x) + \sum_{j=1}^{k} w_j\, \varphi\bigl(\|(x - c_j) / \ell\|\bigr),

    fitted by penalised least squares, :math:`\sum_i s_i |y_i - f(x_i)|^2 + \alpha\, w^\top K w`
    with K the kernel matrix of the centres. Centres are added one at a time, each the one that
    lowers this objective most (orthogonal least squares [1]_). By default the widths
    :math:`\ell` (one a feature) and the ridge :math:`\alpha` maximise the marginal likelihood
    of a Gaussian process [2]_ less a price for every feature that is used, and centres are added
    until the network is as good as that process. Where the data are no more probable than noise
    alone, the network is a constant.

    Parameters
    ----------
    n_centers : int or "auto", default="auto"
        Number of centres; all candidates, with a warning, where there are fewer. "auto" leaves it
        to `criterion`.

    kernel : str, default="auto"
        Radial function of the scaled distance r. "auto" takes "gaussian", or "matern52" or
        "matern32" for rougher functions where the data are clearly more probable with them; with
        a given `length_scale`, which is one kernel's, "gaussian".
        "gaussian", :math:`e^{-r^2/2}`; "matern32",
        :math:`(1 + \sqrt 3 r) e^{-\sqrt 3 r}`; "matern52",
        :math:`(1 + \sqrt 5 r + 5r^2/3) e^{-\sqrt 5 r}`; "rational_quadratic",
        :math:`1 / (1 + r^2/2)`; "inverse_multiquadric", :math:`1 / \sqrt{1 + r^2}`.

    length_scale : {"auto", "isotropic"} or float or array-like, default="auto"
        Width of the radial functions, in the units of X: one number, or one for each feature,
        shape (n_features,); infinity leaves a feature out.
        "auto" finds one for each feature, "isotropic" one for all, in units of each feature's
        standard deviation.

    alpha : float or array-like of shape (n_outputs,) or "auto", default="auto"
        Ridge, of all outputs or of each, in units of the sum of sample weights. 0 is plain least
        squares. In terms of a Gaussian process it is the noise variance over the signal variance.

    degree : {-1, 0, 1}, default=0
        Degree of the unpenalised polynomial: none, a constant, or linear in the features.

    criterion : str, default="auto"
        How "auto" finds the number of centres:

        - "posterior": stop as soon as what further centres could still gain, summed over all
          samples, is below `tol` times the noise variance times the effective number of
          parameters of the network that has all candidates: leaving them out then costs about
          `tol` of the error that noise causes anyway. Needs `alpha` > 0.
        - "gcv": least generalised cross-validation score along the path, parameters counted
          1.5-fold.
        - "error_reduction": stop when the unexplained share of the targets' variance is at most
          `tol` (Chen's criterion).
        - "mse": stop when the mean squared residual, in the squared units of y, is at most `tol`.
        - "auto": "posterior" where it applies, else "gcv".

    tol : float, default=0.02
        See `criterion`.

    max_centers : int, default=None
        Most centres that "auto" may take. None: 2000 (500 for "gcv"), with a warning where they
        did not suffice.

    max_candidates : int, default=None
        Most distinct training rows, drawn at random, that may become centres. None: all, or
        10 000 where there are more.

    loss : {"squared", "tukey"}, default="squared"
        "tukey": where rows lie farther off than 5.5 standard deviations, all are weighed by Tukey's
        biweight [3]_, which gives those none, and the network is fitted again, at most six times.
        Where none does, it is the network of "squared". All rows are held in memory.

    selection : {"ols", "newrb"}, default="ols"
        "newrb" chooses as MATLAB's function of this name does: targets are neither centred nor
        scaled, several outputs count by the sum of their squared error-reduction ratios, and the
        polynomial enters the last fit only. See the notes.

    refine : bool, default=False
        After the forward pass exchange centres, one for a better one, until nothing improves. A
        given number of centres is then used better, at up to several times the cost.

    random_state : int, RandomState instance or None, default=None
        Draws the candidates, and the rows on which kernel, widths and ridge are found: the search
        starts on 300 rows. With up to 300 rows it has no effect.

    Attributes
    ----------
    centers_ : ndarray of shape (n_centers, n_features)
        Centres, in the order of selection.

    center_indices_ : ndarray of shape (n_centers,)
        Their rows in X.

    coef_ : ndarray of shape (n_centers,) or (n_outputs, n_centers)
        Weights, in the units of y.

    intercept_ : float or ndarray of shape (n_outputs,)
        Constant term.

    linear_coef_ : ndarray of shape (n_features,) or (n_outputs, n_features)
        Linear term; zero unless `degree` is 1.

    kernel_ : str
        Name of the radial function, chosen or given.

    length_scale_ : ndarray of shape (n_features,)
        Width of every feature; infinite for a feature that is ignored: it did not vary, or the
        function's slope along it cannot be told from 0.

    alpha_ : float or ndarray of shape (n_outputs,)
        Ridge of every output. Outputs share widths and centres, but not their noise.

    noise_variance_, signal_variance_ : float or ndarray of shape (n_outputs,)
        Of the Gaussian process whose posterior the network approximates, in squared units of y;
        the noise is that of an observation of mean weight, and infinite where the polynomial has as
        many parameters as there are observations.

    relevance_ : ndarray of shape (n_features,)
        How steep the modelled function is along each feature, per standard deviation of the
        feature: the slope's prior standard deviation, as a share of the sum over features. 0 for a
        feature that is ignored; all 0 where nothing but noise was found.

    log_marginal_likelihood_value_ : float
        Logarithm of the marginal likelihood, summed over outputs, of the up to 1000 rows on which
        kernels were compared. Only where kernel, widths or ridge were searched for.

    error_reduction_ : ndarray of shape (n_centers,)
        Share of the targets' variance (about the polynomial, averaged over outputs) by which each
        centre lowered the objective.

    criterion_path_ : ndarray of shape (n_tried,)
        The criterion after 1, 2, ... centres. Empty where `n_centers` is given.

    stop_reason_ : str
        Why no more centres were tried: "n_centers", "max_centers", "criterion", "dependent" (every
        other candidate is a combination of the chosen ones to working precision) or "rank" (the
        same, but only as far as a factor of limited rank tells the candidates apart).

    row_weight_ : ndarray of shape (n_samples,)
        With ``loss="tukey"``: the factor of each row's weight, 0 for an outlier.

    n_iter_ : int
        Number of centres tried.

    n_features_in_ : int
        Number of features seen during fit.

    feature_names_in_ : ndarray of shape (`n_features_in_`,)
        Names of features seen during fit, where X had string names.

    See Also
    --------
    sklearn.gaussian_process.GaussianProcessRegressor : The same posterior mean with a centre at
        every sample; cubic in their number.
    scipy.interpolate.RBFInterpolator : Radial functions at every sample.

    Notes
    -----
    The model is a function of the weighted data: rows of weight 0 are dropped, repeated rows are
    merged, and rows are sorted, so that neither row order nor writing a row twice instead of
    doubling its weight matters. Of weights only the ratios count for what is found by itself.

    More than 100 000 rows are read in blocks, also from a memory-mapped file, in time linear in
    their number and in memory that does not depend on it: centres and the rows that decide on the
    widths then come from a sample, drawn by a hash of the rows' content, and repeated rows are
    merged in that sample only. `fit` takes dask arrays, too; each chunk is worked on where it is.

    To repeat MATLAB's ``newrb(P, T, goal, spread, MN)`` use ``RBFNetRegressor(MN,
    length_scale=spread / sqrt(2 * log(2)), alpha=0, selection="newrb")``, with
    ``n_centers="auto", max_centers=MN, criterion="mse", tol=goal`` where the goal is to stop it.

    References
    ----------
    .. [1] S. Chen, C. F. N. Cowan, P. M. Grant, "Orthogonal least squares learning algorithm for
       radial basis function networks", IEEE Transactions on Neural Networks 2(2), 1991, 302-309.
    .. [2] C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning", MIT Press
       2006, chapter 8.
    .. [3] A. E. Beaton, J. W. Tukey, "The fitting of power series, meaning polynomials, illustrated
       on band-spectroscopic data", Technometrics 16 (1974), 147-185.

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
    """

    _parameter_constraints: dict = {
        "n_centers": [Interval(Integral, 1, None, closed="left"), StrOptions({"auto"})],
        "kernel": [StrOptions({"auto", *KERNELS})],
        "length_scale": [
            Interval(Real, 0, None, closed="neither"),
            StrOptions({"auto", "isotropic"}),
            "array-like",
        ],
        "alpha": [Interval(Real, 0, None, closed="left"), StrOptions({"auto"}), "array-like"],
        "degree": [Interval(Integral, -1, 1, closed="both")],
        "criterion": [StrOptions({"auto", "posterior", "gcv", "error_reduction", "mse"})],
        "tol": [Interval(Real, 0, None, closed="left")],
        "max_centers": [Interval(Integral, 1, None, closed="left"), None],
        "max_candidates": [Interval(Integral, 1, None, closed="left"), None],
        "loss": [StrOptions({"squared", "tukey"})],
        "selection": [StrOptions({"ols", "newrb"})],
        "refine": ["boolean"],
        "random_state": ["random_state"],
    }

    def __init__(
        self,
        n_centers: int | str | None = "auto",
        *,
        kernel="auto",
        length_scale: ArrayLike | str = "auto",
        alpha: float | str = "auto",
        degree=0,
        criterion="auto",
        tol=0.02,
        max_centers=None,
        max_candidates=None,
        loss="squared",
        selection="ols",
        refine=False,
        random_state=None,
    ):
        self.n_centers = n_centers
        self.kernel = kernel
        self.length_scale = length_scale
        self.alpha = alpha
        self.degree = degree
        self.criterion = criterion
        self.tol = tol
        self.max_centers = max_centers
        self.max_candidates = max_candidates
        self.loss = loss
        self.selection = selection
        self.refine = refine
        self.random_state = random_state

    @fit_context(prefer_skip_nested_validation=True)
    @one_blas_thread
    def fit(self, X, y, sample_weight=None):
        """Choose widths, ridge and centres, and fit the weights.

        Parameters
        ----------
        X : array-like or dask array of shape (n_samples, n_features)
            Training rows.

        y : array-like of shape (n_samples,) or (n_samples, n_outputs)
            Targets.

        sample_weight : array-like of shape (n_samples,), default=None
            Weights; an integer weight is worth that many repeats of the row.

        Returns
        -------
        self : object
            Fitted estimator.

        Raises
        ------
        ValueError
            If X or y hold NaN, infinity, or numbers whose squares underflow; if a weight is
            negative or all are 0; if `length_scale` does not fit the features, or is so narrow or
            wide that double precision does not resolve the kernel.

        Warns
        -----
        UserWarning
            If more centres are asked for than there are distinct candidates: all are taken then.
        ConvergenceWarning
            If a limit that was not set by a parameter decided on the network: the default number of
            centres, or the rank of the factor from whose span they are chosen.
        """
        fitted = copy(self)  # a fit that is interrupted leaves this estimator as it was
        for name in _SOMETIMES:
            vars(fitted).pop(name, None)
        fitted._fit_weighted(X, y, sample_weight)
        if self.loss == "tukey":
            fitted._reweigh(X, y, sample_weight)
        self.__dict__ = fitted.__dict__
        return self

    def _reweigh(self, X, y, sample_weight):
        """Fit again with weights by the residuals, until these have settled."""
        if is_dask(X):
            X, y = X.compute(), np.asarray(y)
        given = check_weights(sample_weight, X)
        targets = np.asarray(y, dtype=np.float64).reshape(len(given), -1)
        factor = np.ones(len(given))
        for _ in range(MAX_FITS):
            residuals = targets - self.predict(X).reshape(targets.shape)
            last, factor = factor, biweights(residuals, given)
            if np.mean(np.abs(factor - last)) < SETTLED:
                break
            self._fit_weighted(X, y, given * factor)
        if np.any(factor < 1):
            self.noise_variance_ = self.noise_variance_ / NORMAL_SQUARE
        self.row_weight_ = factor

    def _fit_weighted(self, X, y, sample_weight):
        """Fit by least squares with given weights."""
        rng = check_random_state(self.random_state)
        problem = self._problem(X, y, sample_weight, rng)
        width = check_length_scale(self.length_scale, self.n_features_in_)
        check_resolved(width, problem.X, self.alpha)

        kernel, length_scale, alpha = self._tune(problem, width, rng)
        shift = problem.X.mean(axis=0)
        settings = CenterSettings(
            kernel,
            None if self.n_centers == "auto" else self.n_centers,
            self.criterion,
            self.tol,
            self.max_centers,
            self.max_candidates,
            self.selection,
            self.refine,
        )
        order, stop_reason = choose_centers(problem, alpha, shift, length_scale, settings, rng)
        Z = (problem.X[order] - shift) / length_scale
        root = psd_root(kernel_matrix(Z, Z, kernel))
        columns = Features(Z, shift, length_scale, kernel)
        p = problem.n_tail
        R = problem.reduce(partial(triangle_of_block, columns), stack_triangles, p + len(order))
        path = nested_least_squares(R, p, root, alpha, problem.within)
        k, scores, reached = choose_size(problem, alpha, path, settings)

        vars(self).pop("_posterior_", None)
        self.kernel_, self.length_scale_, self.criterion_path_ = kernel, length_scale, scores
        self.stop_reason_ = "criterion" if reached else stop_reason
        self.n_iter_ = len(order)
        self.centers_ = problem.X[order[:k]]
        self.center_indices_ = problem.first[order[:k]]
        varying = problem.spread > 0
        share = -np.diff(path.objective, axis=0)[:k, varying] / problem.spread[varying] ** 2
        self.error_reduction_ = share.sum(axis=1) / (problem.n_total * max(1, varying.sum()))
        solution = path.coefficients(k)
        polynomial = problem.tail_map.T @ solution[:p]
        self.coef_, self.intercept_, self.linear_coef_ = (
            solution[p:].T,
            polynomial[0],
            polynomial[1:].T,
        )
        # The likelihood's estimates; without a ridge the residual and the targets' own variance.
        ridged = alpha > 0
        plain = path.rss[k] / np.maximum(problem.n_total - path.dof[k], 1)
        noise = np.where(ridged, path.objective[k] / max(problem.n_total - p, 1), plain)
        known = problem.n_total > p  # one observation says nothing of its error
        noise = noise if known else np.full(len(noise), np.inf)
        signal = noise / np.where(ridged, alpha, 1.0)
        self.noise_variance_ = noise
        self.signal_variance_ = np.where(ridged & known, signal, problem.spread**2)
        self.relevance_ = relevance(problem, alpha, length_scale, self.signal_variance_)
        self.alpha_ = alpha * problem.unit
        self._weight_unit, self._tail_map = problem.unit, problem.tail_map
        # One triangle, packed, from which those of all outputs follow.
        size = min(len(path.rows), p + k)
        self._rows = path.rows[:size, : p + k][np.triu_indices(size, m=p + k)]
        if self._flat:
            for name in PER_OUTPUT:
                setattr(self, name, getattr(self, name)[0])

    def _problem(self, X, y, sample_weight, rng):
        """The data, checked: in memory, or in blocks where they are many or elsewhere."""
        held = max(
            MAX_CANDIDATES if self.max_candidates is None else self.max_candidates, SAMPLE_ROWS
        )
        if is_dask(X):
            chunks = dask_chunks(X, y, sample_weight)
            if len(chunks) > IN_MEMORY_ROWS:
                self.n_features_in_ = X.shape[1]
                self._flat = y.ndim == 1
                return chunked_problem(chunks, X.shape[1], self.degree, held, rng.randint(2**31))
            X, y = X.compute(), np.asarray(y)
            sample_weight = None if sample_weight is None else np.asarray(sample_weight)
        X, y = check_data(self, X, y)
        refuse_tiny("X", X)
        refuse_tiny("y", y)
        weights = check_weights(sample_weight, X)
        self._flat = y.ndim == 1
        Y = y.reshape(len(y), -1).astype(np.float64, copy=False)
        if len(X) <= IN_MEMORY_ROWS:
            return prepare(merge(X, Y, weights), self.degree)
        chunks = ArrayChunks(X, Y, weights)
        return chunked_problem(chunks, X.shape[1], self.degree, held, rng.randint(2**31))

    def _tune(self, problem, width, rng):
        """Kernel, widths and every output's ridge in the problem's units, found where not given."""
        alpha = check_alpha(self.alpha, len(problem.spread))
        alphas = np.ones(len(problem.spread)) if alpha is None else alpha / problem.unit
        # Given widths are those of one kernel.
        kernels = (self.kernel,) if self.kernel != "auto" else AUTO_KERNELS
        if width is not None:
            kernels = kernels[:1]
            if alpha is not None:
                return kernels[0], width, alphas
        sample = problem.sample
        view, rows = sample.view(), sample.block(slice(None))
        weights = np.square(sample.root[:, 0])
        data = Data(sample.X, view.of(rows)[1] / sample.root, weights, view.within)
        tuned = search(
            data,
            kernels,
            length_scale=width,
            isotropic=isinstance(self.length_scale, str) and self.length_scale == "isotropic",
            alpha=None if alpha is None else alpha[view.outputs] / sample.unit,
            random_state=rng,
        )
        if alpha is None:
            alphas[view.outputs] = leading_bits(tuned.alpha * sample.unit / problem.unit)
        units = tuned.n_observations * np.log(view.scale).sum()
        self.log_marginal_likelihood_value_ = float(tuned.log_likelihood - units)
        if width is None:
            warn_of_bound(tuned.at_bound)
            unit = sample.X.std(axis=0)
            unit[unit == 0] = 1.0
            width = unit * leading_bits(tuned.length_scale / unit)
        return tuned.kernel, width, alphas

    def predict(self, X, return_std=False, with_noise=True):
        """Predict targets.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Rows.

        return_std : bool, default=False
            Also return the standard deviation of the prediction: that of the Gaussian process
            whose posterior mean the network approximates. It grows to the signal's own standard
            deviation away from the data.

        with_noise : bool, default=True
            Whether that standard deviation is of a new observation, or of the mean.

        Returns
        -------
        y : ndarray of shape (n_samples,) or (n_samples, n_outputs)
            Predicted mean.

        y_std : ndarray of the same shape
            Standard deviation, where asked for.

        Raises
        ------
        sklearn.exceptions.NotFittedError
            If the model is not fitted.
        ValueError
            If X has another number of features than in fit, or holds NaN or infinity.
        """
        check_fitted(self, "coef_")
        X = check_features(self, X, dtype=np.float64, reset=False)
        n, k = len(X), len(self.centers_)
        shift = self.centers_.mean(axis=0) if k else 0.0
        centers = (self.centers_ - shift) / self.length_scale_
        coef = np.atleast_2d(self.coef_).T
        mean = np.tile(np.atleast_1d(self.intercept_), (n, 1))
        if np.any(self.linear_coef_):
            mean += X @ np.atleast_2d(self.linear_coef_).T
        variance = np.zeros((n, mean.shape[1]))
        posterior = self._posterior(centers) if return_std else None
        for part in chunks(n, _CHUNK // max(k, 1)):
            K = kernel_matrix((X[part] - shift) / self.length_scale_, centers, self.kernel_)
            mean[part] += K @ coef
            if return_std:
                variance[part] = self._variance(X[part], K, posterior, with_noise)
        flat = np.ndim(self.intercept_) == 0
        if flat:
            mean, variance = mean[:, 0], variance[:, 0]
        return (mean, np.sqrt(variance)) if return_std else mean

    def _posterior(self, centers):
        """What variances are made of, kept from one call to the next but not in a file."""
        if "_posterior_" not in self.__dict__:
            p = len(self._tail_map)
            K = kernel_matrix(centers, centers, self.kernel_)
            root, outside = psd_root(K), psd_inverse_root(K)
            rows = self._design_triangle()
            alphas = np.atleast_1d(self.alpha_) / self._weight_unit
            triangles = {a: penalise(rows, p, root, a)[1] for a in np.unique(alphas)}
            self._posterior_ = outside, [triangles[a] for a in alphas]
        return self._posterior_

    def _design_triangle(self):
        """Triangular factor of the columns at the training rows, polynomial first."""
        n = len(self._tail_map) + len(self.centers_)
        # Packed, and trapezoidal where there were fewer rows than columns.
        size = next(m for m in range(n + 1) if m * n - m * (m - 1) // 2 == len(self._rows))
        rows = np.zeros((size, n))
        rows[np.triu_indices(size, m=n)] = self._rows
        return rows

    def __getstate__(self):
        state = super().__getstate__().copy()
        state.pop("_posterior_", None)
        return state

    def __setstate__(self, state):
        super().__setstate__(state)
        if "centers_" not in vars(self):
            return
        q = () if np.ndim(self.intercept_) == 0 else ("outputs",)
        shapes = {"centers_": ("k", "d"), "length_scale_": ("d",), "center_indices_": ("k",)}
        shapes |= {"coef_": (*q, "k"), "intercept_": q, "linear_coef_": (*q, "d")}
        shapes |= {"noise_variance_": q, "signal_variance_": q, "_tail_map": ("p", "d1")}
        sizes = {"d": self.n_features_in_, "d1": self.n_features_in_ + 1}
        check_shapes(type(self).__name__, vars(self), shapes, sizes, ("length_scale_",))

    def _variance(self, X, K, posterior, with_noise):
        """Variance of the posterior: of the weights, and of what lies outside the centres' span."""
        prior_root, triangles = posterior
        tail = np.column_stack([np.ones(len(X)), X]) @ self._tail_map.T
        rows = np.hstack([tail, K]).T
        outside = np.maximum(1 - np.square(K @ prior_root.T).sum(axis=1), 0.0)
        noise, signal = np.atleast_1d(self.noise_variance_), np.atleast_1d(self.signal_variance_)
        variance = np.outer(outside, signal)
        of_weights = {}
        for i, R in enumerate(triangles):
            if id(R) not in of_weights:
                solved = solve_triangular(R, rows, trans="T", check_finite=False)
                of_weights[id(R)] = np.square(solved).sum(axis=0) + float(with_noise)
            variance[:, i] += noise[i] * of_weights[id(R)]
        return variance
