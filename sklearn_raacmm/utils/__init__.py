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
from sklearn_raacmm.utils._files import (
    check_path,
    check_places,
    digest_of,
    whole_file,
    write_whole,
)
from sklearn_raacmm.utils._findings import (
    Finding,
    FindingWarning,
    heard_findings,
    say_findings,
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
    natural_order,
    share_of_means,
)
from sklearn_raacmm.utils._html import html_table
from sklearn_raacmm.utils._progress import stage
from sklearn_raacmm.utils._rigid import align, nearest_rotation
from sklearn_raacmm.utils._robust import TUKEY_CUT, robust_scale, tukey_weights
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
    "check_places",
    "check_points",
    "check_shapes",
    "check_weights",
    "check_whole_number",
    "chunk_size",
    "chunks",
    "deviations_by_group",
    "digest_of",
    "encode_groups",
    "fit_context",
    "floats",
    "group_means",
    "group_sums",
    "group_weights",
    "heard_findings",
    "html_table",
    "invert_triangle",
    "is_plain",
    "listed",
    "natural_order",
    "nearest_rotation",
    "one_blas_thread",
    "refuse_disguised",
    "refuse_huge",
    "refuse_masked",
    "robust_scale",
    "safe_indexing",
    "say_findings",
    "share_of_means",
    "show",
    "stage",
    "tukey_weights",
    "validate_parameter_constraints",
    "validate_params",
    "warn_user",
    "whole_file",
    "whole_fit",
    "write_whole",
]
