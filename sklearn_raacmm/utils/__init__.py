"""Shared by all subpackages: groups, checks of input, files, and decorators of fits."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

# ruff: noqa: F401  (used by the other subpackages)

from sklearn_raacmm.utils._checks import (
    LARGEST,
    check_data,
    check_features,
    check_flags,
    check_option,
    check_weights,
    floats,
    is_plain,
    listed,
    refuse_disguised,
)
from sklearn_raacmm.utils._chunks import chunk_size, chunks
from sklearn_raacmm.utils._files import check_places, digest_of, write_whole
from sklearn_raacmm.utils._findings import (
    Finding as Finding,  # for type checkers of those who import it from here
)
from sklearn_raacmm.utils._findings import (
    FindingError,
    FindingWarning,
    call_collecting,
    collected_findings,
    ignored_findings,
    numbered_rows,
    one_warning,
    row_numbers,
)
from sklearn_raacmm.utils._groups import (
    are_deviations,
    centred,
    check_groups,
    deviations_by_group,
    encode_groups,
    group_means,
    group_sums,
    natural_order,
)
from sklearn_raacmm.utils._matrices import align
from sklearn_raacmm.utils._robust import (
    TUKEY_CUT,
    many_without_weight,
    robust_scale,
    slip_factors,
    tukey_weights,
)
from sklearn_raacmm.utils._shapes import check_shapes
from sklearn_raacmm.utils._sklearn import (
    Floats,
    Pair,
    TransformerMixin,
    one_blas_thread,
    param_checks,
    validate_params,
)
from sklearn_raacmm.utils._versioned import (
    InconsistentPackageVersionWarning,
    VersionedEstimator,
    VersionedRegressor,
)
from sklearn_raacmm.utils._warn_user import warn_user
from sklearn_raacmm.utils._whole_fit import stage, whole_fit

__all__ = [name for name in dir() if name[0] != "_"]  # pyright: ignore[reportUnsupportedDunderAll]
