"""Simulated measurements with an articulated arm CMM, and open data of real arms.

Functions ``make_...`` simulate measurements of an arm with physical errors. What the user of a real
arm would have is at the top level of each data set; what only a simulation knows is under
``simulation``. Functions ``fetch_...`` load data that others measured and published.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.datasets._acceptance import make_acceptance
from sklearn_raacmm.datasets._arm_errors import ArmErrors
from sklearn_raacmm.datasets._features import make_features
from sklearn_raacmm.datasets._fetchers import fetch_panda_ball_socket, fetch_ur10_tracker
from sklearn_raacmm.datasets._generators import make_gauge, make_single_point
from sklearn_raacmm.datasets._simulation import SimulatedArm

__all__ = [
    "ArmErrors",
    "SimulatedArm",
    "fetch_panda_ball_socket",
    "fetch_ur10_tracker",
    "make_acceptance",
    "make_features",
    "make_gauge",
    "make_single_point",
]
