"""Shared by all wings: groups, input checks, files, and what scikit-learn keeps private."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.utils._checks import (
    LARGEST,
    check_data,
    check_features,
    check_fitted,
    check_flags,
    check_option,
    check_points,
    check_weights,
    check_whole_number,
    floats,
    is_plain,
    listed,
    refuse_disguised,
    refuse_huge,
    refuse_masked,
    show,
)
from sklearn_raacmm.utils._chunks import chunk_size, chunks
from sklearn_raacmm.utils._files import check_path, write_whole
from sklearn_raacmm.utils._findings import (
    Finding,
    FindingError,
    FindingWarning,
    hear,
    heard_findings,
    one_warning,
    say_findings,
    unheard,
    with_findings,
)
from sklearn_raacmm.utils._groups import (
    CENTRED,
    centred,
    check_groups,
    deviations_by_group,
    encode_groups,
    group_means,
    group_sums,
    group_weights,
    share_of_means,
    slip_factors,
)
from sklearn_raacmm.utils._html import html_table
from sklearn_raacmm.utils._progress import stage
from sklearn_raacmm.utils._rigid import align, nearest_rotation
from sklearn_raacmm.utils._robust import TUKEY_CUT, many_without_weight, robust_scale, tukey_weights
from sklearn_raacmm.utils._shapes import check_shapes
from sklearn_raacmm.utils._sklearn import (
    HasMethods,
    Interval,
    StrOptions,
    check_feature_names,
    check_feature_names_in,
    check_n_features,
    fit_context,
    one_blas_thread,
    safe_indexing,
    validate_parameter_constraints,
    validate_params,
)
from sklearn_raacmm.utils._triangles import invert_triangle
from sklearn_raacmm.utils._versioned import InconsistentPackageVersionWarning, VersionedEstimator
from sklearn_raacmm.utils._warn_user import warn_user
from sklearn_raacmm.utils._whole_fit import whole_fit

__all__ = [
    "CENTRED",
    "LARGEST",
    "TUKEY_CUT",
    "Finding",
    "FindingError",
    "FindingWarning",
    "HasMethods",
    "InconsistentPackageVersionWarning",
    "Interval",
    "StrOptions",
    "VersionedEstimator",
    "align",
    "centred",
    "check_data",
    "check_feature_names",
    "check_feature_names_in",
    "check_features",
    "check_fitted",
    "check_flags",
    "check_groups",
    "check_n_features",
    "check_option",
    "check_path",
    "check_points",
    "check_shapes",
    "check_weights",
    "check_whole_number",
    "chunk_size",
    "chunks",
    "deviations_by_group",
    "encode_groups",
    "fit_context",
    "floats",
    "group_means",
    "group_sums",
    "group_weights",
    "hear",
    "heard_findings",
    "html_table",
    "invert_triangle",
    "is_plain",
    "listed",
    "many_without_weight",
    "nearest_rotation",
    "one_blas_thread",
    "one_warning",
    "refuse_disguised",
    "refuse_huge",
    "refuse_masked",
    "robust_scale",
    "safe_indexing",
    "say_findings",
    "share_of_means",
    "show",
    "slip_factors",
    "stage",
    "tukey_weights",
    "unheard",
    "validate_parameter_constraints",
    "validate_params",
    "warn_user",
    "whole_fit",
    "with_findings",
    "write_whole",
]
