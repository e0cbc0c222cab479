"""Radial basis function network regression with centres chosen by orthogonal least squares."""

from functools import partial
from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import MultiOutputMixin, RegressorMixin
from sklearn.utils import check_random_state

from sklearn_raacmm.network._center_choice import CenterSettings
from sklearn_raacmm.network._feature_powers import likely_powers, log_likelihood_of, tune_powers
from sklearn_raacmm.network._fitted_numbers import FittedNumbers
from sklearn_raacmm.network._grouped_fit import Given, check_kernel, fit_groups, tuned_groups
from sklearn_raacmm.network._kernels import KERNELS
from sklearn_raacmm.network._parameters import (
    check_alpha,
    check_length_scale,
    check_resolved,
    relevance,
)
from sklearn_raacmm.network._read_data import read_problem
from sklearn_raacmm.network._robust_loss import reweigh
from sklearn_raacmm.network._tuning import last_network
from sklearn_raacmm.utils import (
    Interval,
    StrOptions,
    VersionedEstimator,
    check_features,
    check_fitted,
    check_flags,
    check_shapes,
    check_whole_number,
    fit_context,
    one_blas_thread,
    whole_fit,
)

# Attributes that not every fit has.
_SOMETIMES = ("log_marginal_likelihood_value_", "row_weight_")


class RBFNetRegressor(FittedNumbers, MultiOutputMixin, RegressorMixin, VersionedEstimator):
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
    alone, the network is a constant; where a linear model makes them most probable, it is that.
    With up to 40 rows, fewer than ten a feature, and one output it is an average of the three, by
    their probability. Several outputs share kernel, widths and centres; those that are clearly more
    probable with their own fall into groups.

    Parameters
    ----------
    n_centers : int or "auto", default="auto"
        Number of centres; all candidates, with a warning, where there are fewer. "auto" leaves it
        to `criterion`, and makes all distinct rows of a rough function centres; see the notes.
        A number is shared by all outputs, unless `length_scale` has rows of them: then it is that
        of each group.

    kernel : str or array-like of shape (n_outputs,), default="auto"
        Radial function of the scaled distance r. "auto" takes "gaussian", or "matern52" or
        "matern32" for rougher functions where the data are clearly more probable with them; with
        a given `length_scale`, which is one kernel's, "gaussian". A name for each output goes with
        such a `length_scale`.
        "gaussian", :math:`e^{-r^2/2}`; "matern32",
        :math:`(1 + \sqrt 3 r) e^{-\sqrt 3 r}`; "matern52",
        :math:`(1 + \sqrt 5 r + 5r^2/3) e^{-\sqrt 5 r}`; "rational_quadratic",
        :math:`1 / (1 + r^2/2)`; "inverse_multiquadric", :math:`1 / \sqrt{1 + r^2}`.

    length_scale : {"auto", "isotropic"} or float or array-like, default="auto"
        Width of the radial functions, in the units of X: one number, or one for each feature,
        shape (n_features,); infinity leaves a feature out. A row for each output, shape
        (n_outputs, n_features): outputs of the same kernel and widths share centres.
        "auto" finds one for each feature, "isotropic" one for all, in units of each feature's
        standard deviation.

    alpha : float or array-like of shape (n_outputs,) or "auto", default="auto"
        Ridge, of all outputs or of each, in units of the sum of sample weights. 0 is plain least
        squares. In terms of a Gaussian process it is the noise variance over the signal variance.

    degree : {-1, 0, 1} or "auto", default="auto"
        Degree of the polynomial: none, a constant, or linear in the features. The linear part has
        a ridge of its own, found by the likelihood of a linear model, if `alpha` is "auto", and
        none if `alpha` is given. "auto" is a constant, unless `length_scale` and `alpha` are to be
        found and the data are more probable with a linear model alone than with any radial
        functions: then the network is that model. With up to 40 rows, fewer than ten a feature,
        and one output it is an average of linear, radial and constant model, in which the linear
        part has a ridge. Not above 100 000 rows, nor for "newrb".

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
        did not suffice, or all rows of a rough function, which ``max_centers=2000`` rules out.

    max_candidates : int, default=None
        Most distinct training rows, drawn at random, that may become centres. None: all, or
        10 000 where there are more.

    power_transform : {"auto"} or None, default="auto"
        "auto": features of positive numbers or zeros that span powers of ten are seen through a
        power of them, by Box and Cox [4]_, where the data are clearly more probable so. Only where
        the widths are to be found, without `groups`, not for "newrb", for `degree` 1 nor above
        100 000 rows. None: features are seen as they are.

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

    warm_start : bool, default=False
        Start a refit from the last fit, for data that have changed little: kernel, widths and
        ridges are kept if the likelihood says that they are right for the new rows, too, and are
        searched for anew if not; candidates are the last centres, and rows far from all of them.

    random_state : int, RandomState instance or None, default=None
        Draws the candidates, and the rows on which kernel, widths and ridge are found: the search
        starts on 300 rows. With up to 300 rows it has no effect.

    Attributes
    ----------
    output_groups_ : ndarray of shape (n_outputs,)
        Group of every output, from 0. Outputs of a group share kernel, widths and centres; a
        constant one is of the first group.

    centers_ : ndarray of shape (n_centers, n_features)
        Centres, in the order of selection; sorted where all rows are centres. With several groups
        of outputs theirs one after another, as in all attributes by centre.

    center_indices_ : ndarray of shape (n_centers,)
        Their rows in X.

    coef_ : ndarray of shape (n_centers,) or (n_outputs, n_centers)
        Weights, in the units of y; 0 at the centres of another group of outputs.

    intercept_ : float or ndarray of shape (n_outputs,)
        Constant term.

    linear_coef_ : ndarray of shape (n_features,) or (n_outputs, n_features)
        Linear term, in the powers of the features where these are seen so; zero unless `degree` is
        1, or "auto" has found it to be.

    kernel_ : str or ndarray of shape (n_outputs,)
        Name of the radial function, chosen or given; with several groups of outputs, of each.

    length_scale_ : ndarray of shape (n_features,) or (n_outputs, n_features)
        Width of every feature, or of the power that it is seen through, with several groups of
        outputs for each output; infinite for a feature that is ignored: it did not vary, or the
        function's slope along it cannot be told from 0.

    lambdas_ : ndarray of shape (n_features,)
        Exponent of every feature: 1 where it is seen as it is, 0 where by its logarithm.

    powers_ : FeaturePowers
        All numbers of these powers.

    alpha_ : float or ndarray of shape (n_outputs,)
        Ridge of every output: outputs of a group share widths and centres, but not their noise.

    noise_variance_, signal_variance_ : float or ndarray of shape (n_outputs,)
        Of the Gaussian process whose posterior the network approximates, in squared units of y;
        the noise is that of an observation of mean weight, and infinite where the polynomial has as
        many parameters as there are observations. Where widths or ridge were found, the mean of
        the posterior: with few rows it is larger than the most probable value.

    relevance_ : ndarray of shape (n_features,)
        How steep the modelled function is along each feature, per standard deviation of the
        feature, as a share of the sum over features: prior standard deviation of the slope, and
        slope of the linear term. 0 for a feature that is ignored; all 0 where all is noise.

    log_marginal_likelihood_value_ : float
        Logarithm of the marginal likelihood, summed over outputs, of the up to 1000 rows on which
        kernels were compared. Only where kernel, widths or ridge were searched for.

    error_reduction_ : ndarray of shape (n_centers,)
        Share of the targets' variance (about the polynomial, averaged over outputs) by which each
        centre lowered the objective. Empty where all rows are centres, which have no order.

    criterion_path_ : ndarray of shape (n_tried,)
        The criterion after 1, 2, ... centres of a group of outputs. Empty where none was needed.

    stop_reason_ : str
        Why no more centres were tried: "n_centers", "max_centers", "criterion", "dependent" (every
        other candidate is a combination of the chosen ones to working precision), "rank" (the
        same, but only as far as a factor of limited rank tells the candidates apart) or "all rows"
        (none was chosen: all distinct rows are centres). With several groups of outputs theirs,
        joined by ", ".

    row_weight_ : ndarray of shape (n_samples,)
        With ``loss="tukey"``: the factor of each row's weight, 0 for an outlier.

    n_iter_ : int
        Number of centres tried.

    offsets_, group_share_ : bool, float
        Whether each group has an unknown constant, and the share of the noise variance that is a
        smooth function of each group's own. With offsets the level of the prediction is not known:
        its mean over the training rows is 0, and deviations are of the difference from that mean.

    posterior_ : NetworkPosterior, ProcessPosterior or GroupedPosterior
        All numbers that predictions are made of; the second where all rows are centres, the last
        with several groups of outputs.

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

    Outputs fall into groups where widths are to be found, `n_centers` is "auto" and there are at
    most 16 of them; not for "newrb", nor with offsets of `groups`, nor for rows in blocks. On 300
    rows it is looked what every output would gain by widths of its own, and which others suit it;
    a group more has to raise the likelihood, less the price of features, by 10 nats, and the
    density of rows left out. Each group is then the network that its outputs alone would have.

    Where a function is rough all distinct rows become centres, and the model is the Gaussian
    process itself: if it has more effective parameters than a quarter of the rows, or than 2000
    centres can follow; from 1000 to 10 000 rows; and if no parameter of the choice is set. The
    weights of 3000 rows then take 0.4 s instead of 2 to 9, those of 10 000 rows 8 s instead of 50.
    Predictions cost in proportion to the centres (10 000: 30 to 80 us a row), standard deviations
    to their square (2 ms a row, after 7 s and in 800 MB for each ridge).

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
    .. [4] G. E. P. Box, D. R. Cox, "An analysis of transformations", Journal of the Royal
       Statistical Society B 26(2), 1964, 211-252.

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
        "kernel": [StrOptions({"auto", *KERNELS}), "array-like"],
        "length_scale": [
            Interval(Real, 0, None, closed="neither"),
            StrOptions({"auto", "isotropic"}),
            "array-like",
        ],
        "alpha": [Interval(Real, 0, None, closed="left"), StrOptions({"auto"}), "array-like"],
        "degree": [Interval(Integral, -1, 1, closed="both"), StrOptions({"auto"})],
        "criterion": [StrOptions({"auto", "posterior", "gcv", "error_reduction", "mse"})],
        "tol": [Interval(Real, 0, None, closed="left")],
        "max_centers": [Interval(Integral, 1, None, closed="left"), None],
        "max_candidates": [Interval(Integral, 1, None, closed="left"), None],
        "power_transform": [StrOptions({"auto"}), None],
        "loss": [StrOptions({"squared", "tukey"})],
        "selection": [StrOptions({"ols", "newrb"})],
        "refine": ["boolean"],
        "warm_start": ["boolean"],
        "random_state": ["random_state"],
    }

    def __init__(
        self,
        n_centers: int | str = "auto",
        *,
        kernel="auto",
        length_scale: ArrayLike | str = "auto",
        alpha: float | str = "auto",
        degree: int | str = "auto",
        criterion="auto",
        tol=0.02,
        max_centers=None,
        max_candidates=None,
        power_transform="auto",
        loss="squared",
        selection="ols",
        refine=False,
        warm_start=False,
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
        self.power_transform = power_transform
        self.loss = loss
        self.selection = selection
        self.refine = refine
        self.warm_start = warm_start
        self.random_state = random_state

    @fit_context(prefer_skip_nested_validation=True)
    @one_blas_thread
    @whole_fit
    def fit(self, X, y, sample_weight=None, groups=None):
        """Choose widths, ridge and centres, and fit the weights.

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
            residuals from the mean point of a position. Where the groups' mean targets are zero,
            such constants, and besides them a smooth function of each group's own, are allowed for
            if groups that are left out then scatter clearly less; else labels change nothing.

        Returns
        -------
        self : object
            Fitted estimator.

        Raises
        ------
        ValueError
            If X or y hold NaN, infinity, or numbers whose squares underflow; if a weight is
            negative or all are 0; if a feature, whose width is to be found, has numbers 3e6 spreads
            apart; if `length_scale` does not fit the features, or is so narrow or wide that double
            precision does not resolve the kernel; if `groups` has missing labels, or X more than
            100 000 rows with them.

        Warns
        -----
        UserWarning
            If more centres are asked for than there are distinct candidates: all are taken then.
        ConvergenceWarning
            If a limit that was not set by a parameter decided: the default number of centres, or
            the rank of their factor; if outputs have to share widths that do not suit them.
        """
        for name in _SOMETIMES:
            vars(self).pop(name, None)
        self._fit_weighted(X, y, sample_weight, groups)
        if self.loss == "tukey":
            reweigh(self, X, y, sample_weight, groups)

    def _fit_weighted(self, X, y, sample_weight, groups, offsets=None):
        """Fit by least squares with given weights; groups have offsets, have none, or may have."""
        rng, refit = check_random_state(self.random_state), offsets is not None
        problem = read_problem(self, X, y, sample_weight, groups, offsets, rng)
        n_outputs = len(problem.spread)
        width = check_length_scale(self.length_scale, self.n_features_in_, n_outputs)
        check_resolved(width, problem.X, self.alpha)
        kernel = check_kernel(self.kernel, width, n_outputs)
        alpha = check_alpha(self.alpha, n_outputs)
        isotropic = isinstance(self.length_scale, str) and self.length_scale == "isotropic"
        last = last_network(self, problem) if self.warm_start else None
        open_degree = self.degree == "auto" and self.selection == "ols"
        given = Given(kernel, width, alpha, isotropic, open_degree)
        settings = CenterSettings.of(self)
        find = partial(tuned_groups, given=given, settings=settings, rng=rng)
        tuned, self.powers_ = tune_powers(self, problem, find, rng, last, refit)
        value = log_likelihood_of(tuned)
        if value is not None:
            self.log_marginal_likelihood_value_ = value
        if self.offsets_ and not tuned[0].tuned.offsets:
            if likely_powers(self, problem) is not None:  # labels are to change nothing
                return self._fit_weighted(X, y, sample_weight, None)
            problem = read_problem(self, X, y, sample_weight, None, False, rng)
            tuned = [tuned[0]._replace(problem=problem)]
        self.group_share_ = tuned[0].tuned.share
        found = fit_groups(tuned, settings)
        self.posterior_, self.stop_reason_ = found.posterior, found.stop_reason
        self.criterion_path_, self.n_iter_ = found.scores, found.n_tried
        self.center_indices_ = problem.first[found.centers]
        self.error_reduction_ = found.error_reduction
        self.relevance_ = relevance(found.slopes)

    def predict(self, X, return_std=False, return_cov=False, with_noise=True):
        """Predict targets.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Rows.

        return_std : bool, default=False
            Also return the standard deviation of the Gaussian process whose posterior mean the
            network approximates: away from the data it grows to the signal's own.

        return_cov : bool, default=False
            Also return the covariance of the predictions at these rows. Not with `return_std`.

        with_noise : bool, default=True
            Whether that standard deviation or covariance is of new observations, or of the mean.

        Returns
        -------
        y : ndarray of shape (n_samples,) or (n_samples, n_outputs)
            Predicted mean.

        y_std : ndarray of the same shape
            Standard deviation, where asked for.

        y_cov : ndarray of shape (n_samples, n_samples) or (n_samples, n_samples, n_outputs)
            Covariance, where asked for.

        Raises
        ------
        sklearn.exceptions.NotFittedError
            If the model is not fitted.
        ValueError
            If X has another number of features than in fit, or holds NaN or infinity; if both the
            standard deviation and the covariance are asked for.
        """
        check_flags(return_std=return_std, return_cov=return_cov, with_noise=with_noise)
        if return_std and return_cov:
            raise ValueError("Ask for one of return_std and return_cov, not for both.")
        X = self._seen_rows(X)
        mean, std = self.posterior_.predict(X, return_std, with_noise)
        if return_cov:
            return self._shaped(mean), self._shaped(self.posterior_.covariance(X, with_noise))
        return (self._shaped(mean), self._shaped(std)) if return_std else self._shaped(mean)

    def sample_y(self, X, n_samples=1, random_state=0, with_noise=True):
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
        sklearn.exceptions.NotFittedError
            If the model is not fitted.
        ValueError
            If X has another number of features than in fit, or holds NaN or infinity; if the noise
            variance is infinite, as it is after a fit to one observation.

        Examples
        --------
        >>> import numpy as np
        >>> from sklearn_raacmm import RBFNetRegressor
        >>> X = np.linspace(0, 6, 50)[:, None]
        >>> model = RBFNetRegressor().fit(X, np.sin(X[:, 0]))
        >>> model.sample_y([[1.0], [2.0]], n_samples=3).shape
        (2, 3)
        """
        X = self._seen_rows(X)
        n_samples = check_whole_number("n_samples", n_samples, 1)
        draws = self.posterior_.sample(X, n_samples, check_random_state(random_state), with_noise)
        return draws[:, 0] if self._flat else draws

    def predict_gradient(self, X, return_variance=False):
        """Derivatives of the prediction by the features, in closed form.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Rows.

        return_variance : bool, default=False
            Also return the derivatives of the predictive variance. The noise does not depend on
            the features, so that it is the same for an observation and for the mean.

        Returns
        -------
        gradient : ndarray of shape (n_samples, n_features) or (n_samples, n_outputs, n_features)
            Of the mean, in units of y per unit of X.

        variance_gradient : ndarray of the same shape
            Of the variance, where asked for.

        Raises
        ------
        sklearn.exceptions.NotFittedError
            If the model is not fitted.
        ValueError
            If X has another number of features than in fit, or holds NaN or infinity; if the
            derivatives of an infinite variance are asked for, as after a fit to one observation.

        Examples
        --------
        >>> import numpy as np
        >>> from sklearn_raacmm import RBFNetRegressor
        >>> X = np.linspace(0, 6, 50)[:, None]
        >>> model = RBFNetRegressor().fit(X, np.sin(X[:, 0]))
        >>> bool(abs(model.predict_gradient([[1.0]])[0, 0] - np.cos(1.0)) < 0.01)
        True
        """
        X = self._checked_rows(X)
        seen, slopes = self.powers_.transform(X), self.powers_.slopes(X)[:, None]
        of_mean, of_variance = self.posterior_.gradient(seen, return_variance)
        of_mean *= slopes
        if return_variance:
            of_variance *= slopes
        if self._flat:
            of_mean = of_mean[:, 0]
            of_variance = of_variance[:, 0] if return_variance else None
        return (of_mean, of_variance) if return_variance else of_mean

    def _checked_rows(self, X):
        check_fitted(self, "posterior_")
        return check_features(self, X, dtype=np.float64, reset=False)

    def _seen_rows(self, X):
        X = self._checked_rows(X)
        return self.powers_.transform(X)

    def __setstate__(self, state):
        super().__setstate__(state)
        if "posterior_" in vars(self):
            sizes = {"k": len(self.posterior_.centers)}
            check_shapes(type(self).__name__, vars(self), {"center_indices_": ("k",)}, sizes)
            sizes = {"d": len(self.posterior_.polynomial) - 1}
            check_shapes("FeaturePowers", vars(self.powers_), {"lambdas": ("d",)}, sizes)
