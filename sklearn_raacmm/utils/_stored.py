"""Which classes of this package stand in the file of a fitted model."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from importlib import import_module
from typing import Any

# By name: the subpackages that define them stand above this one, and those that read and write
# files import them all.
_CLASSES = {
    "arm": ("Arm",),
    "error_model": ("ArmResidualRegressor", "Fading", "Judgement", "LinearModel", "Terms"),
    "network": ("Network", "RBFNetRegressor"),
    "residuals": ("CylindricalResidualTarget", "PoseFeatures"),
    "utils": ("Finding",),
}


def stored_classes() -> dict[str, Any]:
    """The classes by their public names."""
    names = [f"sklearn_raacmm.{part}.{name}" for part, own in _CLASSES.items() for name in own]
    modules = [import_module(name.rpartition(".")[0]) for name in names]
    return {n: getattr(m, n.rpartition(".")[2]) for n, m in zip(names, modules, strict=True)}


def trusted_types() -> list[str]:
    """Names that skops has to trust: public ones, and those of the modules that define them.

    ``Arm.azimuth`` is a function that a model may hold.
    """
    found = stored_classes()
    found["sklearn_raacmm.arm.Arm.azimuth"] = found["sklearn_raacmm.arm.Arm"].azimuth
    return [*found, *(f"{one.__module__}.{one.__qualname__}" for one in found.values())]
