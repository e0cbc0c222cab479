"""Shared by all subpackages: rows and groups, checks of input, findings, files, estimators."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

# ruff: noqa: F401  (used by the other subpackages)

from sklearn_raacmm.utils._checks import (
    LARGEST,
    check_data,
    check_features,
    check_flags,
    check_option,
    check_shapes,
    check_weights,
    floats,
    is_dask,
    is_plain,
    listed,
    refuse_disguised,
)
from sklearn_raacmm.utils._estimators import (
    Floats,
    InconsistentPackageVersionWarning,
    VersionedRegressor,
    VersionedTransformer,
    last_step_of,
    one_blas_thread,
    param_checks,
    warn_user,
)
from sklearn_raacmm.utils._files import check_places, check_unpacked, digest_of, write_whole
from sklearn_raacmm.utils._findings import (
    Finding as Finding,  # "as" for type checkers of those who import it from here
    FindingError as FindingError,
    FindingWarning as FindingWarning,
    Weight,
    one_warning,
    stage,
    whole_fit,
)
from sklearn_raacmm.utils._rows import (
    TUKEY_CUT,
    Groups,
    Whitening,
    align,
    chunks,
    many_without_weight,
    robust_scale,
    tukey_weights,
)
from sklearn_raacmm.utils._stored import stored_classes, trusted_types

__all__ = [name for name in dir() if name[0] != "_"]  # pyright: ignore[reportUnsupportedDunderAll]
