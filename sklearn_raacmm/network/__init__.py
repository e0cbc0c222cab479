"""The radial basis function network, for any regression problem: it knows nothing of arms."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.network._all_rows import ProcessPosterior
from sklearn_raacmm.network._feature_powers import FeaturePowers
from sklearn_raacmm.network._fitted_numbers import networks_of
from sklearn_raacmm.network._grouped_posterior import GroupedPosterior
from sklearn_raacmm.network._kernels import KERNELS, kernel_matrix
from sklearn_raacmm.network._network_posterior import NetworkPosterior
from sklearn_raacmm.network._rbf_net import RBFNetRegressor

__all__ = [
    "KERNELS",
    "FeaturePowers",
    "GroupedPosterior",
    "NetworkPosterior",
    "ProcessPosterior",
    "RBFNetRegressor",
    "kernel_matrix",
    "networks_of",
]
