"""The radial basis function network, for any regression problem: it knows nothing of arms."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.network._kernels import KERNELS, radial
from sklearn_raacmm.network._posterior import Network
from sklearn_raacmm.network._ranks import by_feature
from sklearn_raacmm.network._rbf_net import RBFNetRegressor

__all__ = ["KERNELS", "Network", "RBFNetRegressor", "by_feature", "radial"]
