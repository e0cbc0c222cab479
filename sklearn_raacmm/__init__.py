"""Residual correction for articulated arm coordinate measuring machines."""

from sklearn_raacmm.arm import Arm

__version__ = "0.1.0.dev0"

__all__ = ["Arm"]
