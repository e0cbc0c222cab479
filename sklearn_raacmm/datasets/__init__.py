"""Simulated measurements with an articulated arm CMM, and open data of real arms.

What is made (``make_...``) is simulated, with errors that are physical: what a user of a real arm
would have is at the top level of each data set, what only a simulation knows under ``simulation``.
What is fetched (``fetch_...``) was measured by others, who published it.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.datasets._arm_errors import ArmErrors
from sklearn_raacmm.datasets._fetchers import fetch_panda_ball_socket, fetch_ur10_tracker
from sklearn_raacmm.datasets._generators import make_gauge, make_single_point
from sklearn_raacmm.datasets._simulation import SimulatedArm

__all__ = [
    "ArmErrors",
    "SimulatedArm",
    "fetch_panda_ball_socket",
    "fetch_ur10_tracker",
    "make_gauge",
    "make_single_point",
]
