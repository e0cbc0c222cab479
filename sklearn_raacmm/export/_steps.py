"""A fitted model taken apart into the steps that leave Python, each with its name."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from functools import partial
from types import MethodType
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from sklearn.exceptions import NotFittedError
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import MaxAbsScaler, MinMaxScaler, RobustScaler, StandardScaler
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.error_model import force_on_probe
from sklearn_raacmm.network import RBFNetRegressor
from sklearn_raacmm.residuals import CylindricalResidualTarget, PoseFeatures
from sklearn_raacmm.utils import show

SCALERS = (StandardScaler, MinMaxScaler, MaxAbsScaler, RobustScaler)
LINEAR = (LinearRegression, Ridge)
# What an ArmResidualRegressor uses, by the number of its stages.
STAGES = ("none", "harmonics", "harmonics+network")
# Centres up to which the standard deviation of a process is written: a table of 4 million numbers,
# as that of the largest network that a fit chooses by itself.
MOST_CENTERS = 2000


class Step(NamedTuple):
    """One estimator of the chain, by the path that leads to it."""

    path: str
    estimator: object


def leaves(model, path=None):
    """Steps in the order in which data pass; a wrapper comes before what it wraps.

    Parameters
    ----------
    model : estimator
        Fitted.
    path : str, optional
        What to call it in a message.

    Yields
    ------
    Step
    """
    path = type(model).__name__ if path is None else path
    if isinstance(model, Pipeline):
        for name, step in model.steps:
            if step is not None and not (isinstance(step, str) and step == "passthrough"):
                yield from leaves(step, name if path == "Pipeline" else f"{path}.{name}")
        return
    if hasattr(model, "best_estimator_"):  # of a search: what it has found
        yield from leaves(model.best_estimator_, path)
        return
    yield Step(path, model)
    if isinstance(model, CylindricalResidualTarget) and hasattr(model, "regressor_"):
        yield from leaves(model.regressor_, f"{path}.regressor")


def check_fitted(model):
    """Refuse a class, or an estimator that is not fitted, with one sentence."""
    if isinstance(model, type) or not hasattr(model, "fit"):
        raise TypeError(f"model must be a fitted estimator, got {show(model)}.")
    for path, step in leaves(model):
        try:
            check_is_fitted(step)
        except NotFittedError:
            raise NotFittedError(f"{path} is not fitted: fit the model first.") from None


def azimuth_arm(path, azimuth):
    """Arm and angle unit of a callable `azimuth`, which has to be the method of an `Arm`."""
    unit, method = "rad", azimuth
    if (
        isinstance(azimuth, partial)
        and not azimuth.args
        and set(azimuth.keywords) == {"angle_unit"}
    ):
        unit, method = azimuth.keywords["angle_unit"], azimuth.func
    known = isinstance(method, MethodType) and method.__func__ is Arm.azimuth
    if not known or not isinstance(method.__self__, Arm):
        raise ValueError(
            f"{path} takes its azimuth from {azimuth!r}, which cannot be exported: only the method "
            "of an Arm can, azimuth=arm.azimuth."
        )
    return method.__self__, unit


def arm_of(model):
    """Arm and angle unit of a chain, (None, None) where it has none.

    Raises
    ------
    ValueError
        If two steps disagree.
    """
    found = []
    for path, step in leaves(model):
        if isinstance(step, PoseFeatures):
            found.append((path, step.arm_, step.angle_unit))
        elif isinstance(step, CylindricalResidualTarget) and callable(step.azimuth):
            found.append((path, *azimuth_arm(path, step.azimuth)))
        elif isinstance(getattr(step, "arm_", None), Arm):
            found.append((path, step.arm_, step.angle_unit))
    for path, arm, unit in found[1:]:
        if (arm, unit) != found[0][1:]:
            what = "arms" if arm != found[0][1] else "angle units"
            raise ValueError(
                f"{found[0][0]} and {path} have different {what}, so the model cannot be exported: "
                f"{found[0][1]!r} in {found[0][2]}, {arm!r} in {unit}."
            )
    return found[0][1:] if found else (None, None)


def n_outputs(network):
    """Number of outputs of a fitted `RBFNetRegressor`, whatever the shape of its target."""
    return 1 if getattr(network.intercept_, "ndim", 0) == 0 else len(network.intercept_)


def described(network):
    """Kernel and number of centres of a fitted `RBFNetRegressor`, group by group, as text."""
    parts = network.networks_
    texts = [f"{part.kernel}, {len(part.centers)} centres" for part in parts]
    if len(parts) == 1:
        return texts[0]
    outputs = [", ".join(str(i) for i in part.outputs) for part in parts]
    return "; ".join(f"outputs {of}: {text}" for of, text in zip(outputs, texts, strict=True))


def extra_of(model):
    """Names of the columns after the angles that the arm's estimator of a chain takes."""
    for _, step in leaves(model):
        linear = getattr(step, "linear_model_", None)
        if linear is not None:
            return tuple(name for name, _ in linear.terms.extra)
    return ()


def force_of(extra):
    """Force on the probe of one unit of each extra column, (3, n_extra), base frame.

    Parameters
    ----------
    extra : tuple of (str, tuple of float)
        As `Terms` has it.
    """
    mean = np.array([reference[0] for _, reference in extra])
    one = force_on_probe(extra, mean + np.eye(len(extra)))
    return np.round(one - force_on_probe(extra, mean[None])).T


def fadings_of(step):
    """How each stage of one of the arm's estimators fades; all have one size and one factor."""
    return step.fadings_ if hasattr(step, "fadings_") else [step.fading_]


def posterior_spectrum(step):
    """The posterior of the weights in coordinates in which its covariance is diagonal.

    With phi the radial functions and t the polynomial's terms at a point, and A the triangle of the
    columns at the training rows, tail first, the variance of output j is

        signal_j (1 - |g|^2) + noise_j (|u|^2 + sum_i h_i^2 / (spectrum_i + alpha_j)),
        u = tail (1, x), g = turn phi, h = g - shift u.

    One matrix serves all outputs, whatever their ridges are.

    Returns
    -------
    turn : ndarray of shape (rank, k)
        The rank of the centres' kernel matrix is below k where rounding hides some directions.
    shift : ndarray of shape (rank, p)
    tail : ndarray of shape (p, 1 + n_features)
    shrunk : ndarray of shape (n_outputs, rank)
        ``1 / (spectrum + alpha)``.

    Raises
    ------
    ValueError
        If the tables would be too large, as they are where thousands of rows are centres.
    """
    posterior, k = step, len(step.centers)
    if k > MOST_CENTERS and posterior.all_rows:
        raise ValueError(
            f"The standard deviation of a network of {k} centres would need a table of "
            f"{k * k / 1e6:.0f} million numbers. Export without it, or fit the network with "
            f"max_centers={MOST_CENTERS}."
        )
    p, rows = len(posterior.tail_map), posterior.design_triangle()
    left, across, own = rows[:p, :p], rows[:p, p:], rows[p:, p:]
    tail = solve_triangular(left, posterior.tail_map, trans="T") if p else posterior.tail_map
    if not k:
        return np.empty((0, 0)), np.empty((0, p)), tail, np.empty((len(step.outputs), 0))
    whiten = posterior.prior_root
    _, singular, turn = np.linalg.svd(own @ whiten.T)
    spectrum = np.zeros(len(whiten))
    spectrum[: len(singular)] = np.square(singular)
    turn = turn @ whiten
    shrunk = 1 / np.maximum(spectrum + posterior.alpha[:, None], np.finfo(float).tiny)
    return turn, turn @ across.T, tail, shrunk


_KNOWN = (PoseFeatures, *SCALERS, CylindricalResidualTarget, RBFNetRegressor, *LINEAR)
KNOWN = ", ".join([known.__name__ for known in _KNOWN])
KNOWN += ", JointHarmonicRegressor, ArmResidualRegressor"
