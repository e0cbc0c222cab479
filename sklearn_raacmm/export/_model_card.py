"""What a fitted model is, what it was fitted on, and how much it helped."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import json

import numpy as np
import sklearn
from scipy.spatial import ConvexHull, QhullError
from sklearn.base import clone
from sklearn.model_selection import GroupKFold
from sklearn.utils import check_array, check_consistent_length
from sklearn.utils.validation import has_fit_parameter

from sklearn_raacmm._version import __version__
from sklearn_raacmm.export._c_source import fingerprint_of
from sklearn_raacmm.export._steps import arm_of, check_fitted, leaves
from sklearn_raacmm.metrics import single_point_repeatability
from sklearn_raacmm.utils import encode_groups, refuse_disguised


class ModelCard(dict):
    """Facts about a model: plain numbers, text, lists and dicts, fit for ``json.dumps``.

    ``str(card)`` is Markdown, in which what is long, such as the hull's corners, is left out.
    """

    def __str__(self):
        lines = ["# Residual correction of an arm", ""]
        for key, value in self.items():
            if not isinstance(value, dict):
                lines.append(f"- {_words(key)}: {_short(value)}")
                continue
            lines += ["", f"## {_words(key)}", ""]
            for name, fact in value.items():
                if name != "hull_corners_mm":
                    lines.append(f"- {_words(name)}: {_short(fact)}")
        return "\n".join(lines) + "\n"


def _words(key):
    """A key as words; units stay as they are written."""
    words = key.split("_")
    unit = f", {words.pop()}" if words[-1] in ("mm", "rad", "deg", "litre") else ""
    return " ".join(words) + unit


def _short(value):
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(map(_short, value))
    return "unknown" if value is None else str(value)


def card_of(model, X=None, y=None, groups=None, *, n_folds=5):
    """See `sklearn_raacmm.export.describe`."""
    check_fitted(model)
    if X is None and (y is not None or groups is not None):
        raise ValueError("y and groups describe rows of X, which is None.")
    whole = isinstance(n_folds, int | np.integer) and not isinstance(n_folds, bool)
    if not whole or n_folds < 0 or n_folds == 1:
        raise ValueError(f"n_folds must be 0 or a whole number of at least 2, got {n_folds!r}.")
    arm, unit = _arm(model)
    first = next(leaves(model)).estimator
    card = ModelCard(
        written_by=f"sklearn_raacmm {__version__}, scikit-learn {sklearn.__version__}",
        fingerprint=_fingerprint(model),
        steps=[_step(step) for _, step in leaves(model)],
        input=f"{first.n_features_in_} columns"
        if arm is None
        else f"{arm.n_joints} joint angles in {unit}",
        output="residual of the probe in the base frame, mm: subtract it from the measured point"
        if arm is not None
        else "as fitted",
    )
    if arm is not None:
        table = json.loads(arm.to_json())
        card["arm"] = {k: v for k, v in table.items() if not k.startswith("format")}
    if X is not None:
        refuse_disguised("X", X)
        X = check_array(X, dtype=np.float64, input_name="X")
        if X.shape[1] != first.n_features_in_:
            raise ValueError(
                f"X has {X.shape[1]} columns, but the model was fitted on {first.n_features_in_}."
            )
        codes = None
        if groups is not None:
            codes = encode_groups(groups, len(X))[1]
        card["training"] = _training(X, codes, arm, unit)
        if y is not None:
            refuse_disguised("y", y)
            y = check_array(y, dtype=np.float64, input_name="y", ensure_2d=False)
            check_consistent_length(X, y)
            card["error"] = _error(model, X, y, codes, groups, n_folds)
    return card


def _arm(model):
    try:
        return arm_of(model)
    except ValueError:  # an azimuth that is not an arm's, or two arms: not what can be described
        return None, None


def _fingerprint(model):
    try:
        return fingerprint_of(model)
    except ValueError:
        return None


def _step(step):
    name = type(step).__name__
    if hasattr(step, "centers_"):
        return f"{name} ({step.kernel_}, {len(step.centers_)} centres)"
    if hasattr(step, "get_feature_names_out") and hasattr(step, "arm_"):
        return f"{name} ({', '.join(step.get_feature_names_out())})"
    return name


def _training(X, codes, arm, unit):
    facts = {"rows": len(X), "positions": None if codes is None else int(codes.max()) + 1}
    if arm is None:
        return facts
    facts[f"smallest_joint_angles_{unit}"] = X.min(axis=0).round(4).tolist()
    facts[f"largest_joint_angles_{unit}"] = X.max(axis=0).round(4).tolist()
    points = arm.forward(X, angle_unit=unit)
    radius = np.hypot(*points[:, :2].T)
    facts["distance_from_the_base_axis_mm"] = [float(radius.min()), float(radius.max())]
    facts["height_mm"] = [float(points[:, 2].min()), float(points[:, 2].max())]
    try:
        hull = ConvexHull(points)
        facts["hull_volume_litre"] = float(hull.volume / 1e6)
        facts["hull_corners_mm"] = points[hull.vertices].round(2).tolist()
    except (QhullError, ValueError):  # points of one plane, or fewer than four
        facts["hull_volume_litre"] = 0.0
    return facts


def _error(model, X, y, codes, groups, n_folds):
    """Errors before and after; the latter at positions that a copy of the model has not seen."""
    n_outputs = np.shape(model.predict(X[:1]).ravel())[0]
    if y.size != len(X) * n_outputs:
        raise ValueError(
            f"y has shape {y.shape}, but the model predicts {n_outputs} numbers a row."
        )
    n_positions = 0 if codes is None else int(codes.max()) + 1
    predicted = np.empty_like(y)
    folds = min(n_folds, n_positions)
    if folds >= 2:
        takes_groups = has_fit_parameter(model, "groups")
        groups = np.asarray(groups)
        for train, test in GroupKFold(folds).split(X, groups=codes):
            extra = {"groups": groups[train]} if takes_groups else {}
            fold = clone(model).fit(X[train], y[train], **extra)
            predicted[test] = fold.predict(X[test])
        seen = f"positions not seen: {folds} folds by position, fitted again each time"
    else:
        predicted[:] = np.reshape(model.predict(X), y.shape)
        seen = (
            "these rows; if the model was fitted on them, this is better than it will be on others"
        )
    facts = {"after_is_measured_at": seen}
    for when, left in (("before", y), ("after", y - predicted)):
        size = np.abs(left) if y.ndim == 1 else np.linalg.norm(left, axis=1)
        facts[f"mean_{when}_mm"] = float(size.mean())
        facts[f"largest_{when}_mm"] = float(size.max())
        if codes is not None and y.ndim == 2 and y.shape[1] == 3:
            facts[f"mean_2S_{when}_mm"] = float(single_point_repeatability(left, codes))
    return facts
