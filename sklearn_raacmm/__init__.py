"""Residual correction for articulated arm coordinate measuring machines."""

__version__ = "0.1.0.dev0"
