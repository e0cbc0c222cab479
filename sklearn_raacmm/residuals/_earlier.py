"""Earlier corrections of measuring arms, as chains from joint angles to residuals.

Gao et al. (2020) name them. Their own papers were not at hand: this is the kind of model that each
is named for, on the inputs of Gao et al. `benchmarks/make_results.py` chooses the settings.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

import numpy as np
from sklearn.compose import TransformedTargetRegressor
from sklearn.linear_model import Ridge
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.residuals._pose_features import PoseFeatures
from sklearn_raacmm.residuals._target import CylindricalResidualTarget


def polynomial_chain(
    arm: Arm, *, degree: int = 3, alpha: float = 1.0, **inputs: Any
) -> CylindricalResidualTarget:
    """Build a polynomial of the pose, as that of Xiong and Bing.

    Parameters
    ----------
    arm : Arm
        The calibrated arm.
    degree : int, default=3
        Degree of the polynomial.
    alpha : float, default=1.0
        Ridge on the coefficients of its scaled terms.
    **inputs : dict
        Parameters of :class:`~sklearn_raacmm.PoseFeatures`, such as ``joints="all"``.

    Returns
    -------
    chain : CylindricalResidualTarget
        Not fitted. Fit it with `groups`: the constants of positions are then exact.

    Notes
    -----
    Named by Gao et al. (2020), doi 10.1177/1729881420925638.

    Examples
    --------
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> from sklearn_raacmm.residuals import polynomial_chain
    >>> test = make_single_point(n_positions=6, n_poses=20, random_state=0)  # simulated
    >>> chain = polynomial_chain(test.arm).fit(test.data, test.target, groups=test.groups)
    >>> chain.predict(test.data[:2]).shape
    (2, 3)
    """
    terms = PolynomialFeatures(degree, include_bias=False)
    # The angles first: powers of numbers far from 1 differ by more than a ridge can serve.
    return _chain(arm, inputs, StandardScaler(), terms, StandardScaler(), Ridge(alpha))


def database_chain(arm: Arm, *, n_neighbors: int = 10, **inputs: Any) -> CylindricalResidualTarget:
    """Build a database of residuals, as that of Xu: the mean of the nearest poses, by distance.

    Parameters
    ----------
    arm, **inputs
        As in :func:`polynomial_chain`.
    n_neighbors : int, default=10
        Poses of the database that are taken into account.

    Returns
    -------
    chain : CylindricalResidualTarget
        Not fitted. At a pose of the database it returns the residual of this pose: `groups` change
        nothing.

    Notes
    -----
    Named by Gao et al. (2020), doi 10.1177/1729881420925638.

    Examples
    --------
    >>> from sklearn_raacmm import Arm
    >>> from sklearn_raacmm.residuals import database_chain
    >>> database_chain(Arm.from_name("aacmm6")).regressor.steps[-1][0]
    'kneighborsregressor'
    """
    nearest = KNeighborsRegressor(n_neighbors, weights="distance")
    return _chain(arm, inputs, StandardScaler(), nearest)


def bp_network_chain(
    arm: Arm,
    *,
    hidden_layer_sizes: tuple[int, ...] = (64, 64),
    alpha: float = 3.0,
    max_iter: int = 1000,
    random_state: int | np.random.RandomState | None = None,
    **inputs: Any,
) -> CylindricalResidualTarget:
    """Build a perceptron trained by backpropagation of errors, a BP network.

    Parameters
    ----------
    arm, **inputs
        As in :func:`polynomial_chain`.
    hidden_layer_sizes : tuple of int, default=(64, 64)
        Units of each hidden layer.
    alpha : float, default=3.0
        Weight decay, for targets of unit variance.
    max_iter : int, default=1000
        Most steps of L-BFGS, which suits some hundred rows better than stochastic steps.
    random_state : int, RandomState instance or None, default=None
        Draws the first weights.

    Returns
    -------
    chain : CylindricalResidualTarget
        Not fitted.

    References
    ----------
    J. Zhu, X. Feng, J. Zhang, "Dynamic Error Compensation Model of Articulated Arm Coordinate
    Measuring Machine", 2019: a BP network for an arm's residuals.

    Examples
    --------
    >>> from sklearn_raacmm import Arm
    >>> from sklearn_raacmm.residuals import bp_network_chain
    >>> chain = bp_network_chain(Arm.from_name("aacmm6"), hidden_layer_sizes=(8,), random_state=0)
    >>> chain.regressor.steps[-1][0]
    'transformedtargetregressor'
    """
    network = MLPRegressor(
        hidden_layer_sizes=hidden_layer_sizes,
        solver="lbfgs",
        alpha=alpha,
        max_iter=max_iter,
        random_state=random_state,
    )
    # Any usual weight decay outweighs hundredths of a millimetre.
    scaled = TransformedTargetRegressor(network, transformer=StandardScaler())
    return _chain(arm, inputs, StandardScaler(), scaled)


def _chain(arm, inputs, *steps):
    """A chain with the azimuth of the arm, on its pose or on other inputs."""
    pose = PoseFeatures(arm, **inputs)
    return CylindricalResidualTarget(make_pipeline(pose, *steps), azimuth=arm.azimuth)
