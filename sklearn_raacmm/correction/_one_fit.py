"""What is learnt from, checked once, and one fit of calibration and model on some of its rows."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from copy import copy
from inspect import ismethod
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from sklearn.base import clone
from sklearn.cluster import KMeans
from sklearn.pipeline import Pipeline
from sklearn.utils.validation import has_fit_parameter

from sklearn_raacmm.arm import Arm, check_angles, check_arm, points_of
from sklearn_raacmm.calibration import are_wrong, calibrate, check_length
from sklearn_raacmm.correction._causes import checked_causes, refuse_explained_time
from sklearn_raacmm.correction._transfer import transferred_model
from sklearn_raacmm.error_model import ArmResidualRegressor
from sklearn_raacmm.measurements import find_poses, within_turn
from sklearn_raacmm.residuals import position_residuals
from sklearn_raacmm.utils import encode_groups, floats, ignored_findings, listed

# Regions that a tracker's points without labels are divided into: a fifth or a tenth of the volume
# is left out at a time. A choice, not measured.
_FEWEST_REGIONS, _MOST_REGIONS, _ROWS_OF_A_REGION = 5, 10, 20


class Data:
    """Checked input: angles in rad, labels, perhaps a tracker's points and known lengths.

    `rows` are the first rows of each pose among those `given`; `causes` name the columns of
    `values` (n, n_causes); `like` are models of earlier arms of the make.
    """

    def __init__(
        self, arm, angles, positions, points, lengths, angle_unit,
        extra=None, in_order=False, like=(), tools=None,
    ):  # fmt: skip
        check_arm(arm)
        angles = check_angles(angles, arm.n_joints, angle_unit)
        # Within one turn, lest a warning of far angles be said again by everything that follows.
        angles = within_turn(angles)
        lengths = listed("lengths", lengths)
        if positions is None and points is None:
            raise ValueError("give positions, the label of each row, or points of a tracker.")
        if points is not None:
            points = floats("points", points, 3)
            if len(points) != len(angles):
                raise ValueError(f"points must have shape ({len(angles)}, 3), got {points.shape}.")
            if positions is None:
                positions = _regions(points)
        labels, codes = encode_groups(positions, len(angles))
        tied = {i for entry in lengths for i in check_length(entry, labels.tolist())[:2]}
        for code in np.flatnonzero(np.bincount(codes) == 1) if points is None else ():
            if code not in tied:
                raise ValueError(
                    f"position {labels[code].item()!r} has a single row, row "
                    f"{np.flatnonzero(codes == code)[0]}: is its label mistyped?"
                )
        causes, values = checked_causes(extra, in_order, angles)
        refuse_explained_time(causes, angles, codes)
        kinds = codes
        like = tuple(listed("like", like))
        if tools is not None:
            if like:
                raise ValueError("like and tools cannot be given together.")
            names, of_tool = encode_groups(tools, len(angles), "tools")
            tools, kinds = names[of_tool], codes * len(names) + of_tool
        poses = find_poses(angles, kinds, points)
        self.arm, self.lengths, self.like, self.rows = arm, lengths, like, poses.first
        self.given = angles, labels[codes], points, tools
        self.angles, self.points = poses.mean_angles(angles), poses.mean(points)
        self.positions, self.tools = labels[codes][self.rows], _at(self.rows, tools)
        self.causes, self.values = causes, values[self.rows]
        self.one_place = []  # positions that are one, as tuples

    def seen_by(self, calibration):
        """The same without lengths that a calibration of all rows found to be wrong.

        And with the positions that it found to be one place.
        """
        right = copy(self)
        right.one_place = [f.positions for f in calibration.findings if f.code == "one-place"]
        if self.lengths and self.points is None:
            wrong = are_wrong(self.lengths, calibration.length_errors_mm, calibration.sigma_mm)
            right.lengths = [one for one, out in zip(self.lengths, wrong, strict=True) if not out]
        return right

    @property
    def inputs(self):
        """Angles, then the causes, of each row."""
        return np.hstack([self.angles, self.values])

    def without_lonely(self, rows):
        """Rows of positions with at least two, and the others: those have no residuals."""
        if self.points is not None:
            return rows, rows[:0]
        _, codes, counts = np.unique(self.positions[rows], return_inverse=True, return_counts=True)
        alone = counts[codes] < 2
        return rows[~alone], rows[alone]

    def blocks(self):
        """Block of each row: positions at one place, or joined by known lengths, are one."""
        labels, codes = np.unique(self.positions, return_inverse=True)
        number = {label: i for i, label in enumerate(labels.tolist())}
        pairs = [(place[0], other) for place in self.one_place for other in place]
        # Of a plate whose distances are all known: position by position.
        for joined in ([*pairs, *(entry[:2] for entry in self.lengths)], pairs):
            ends = np.array([[number[a], number[b]] for a, b in joined], dtype=int).reshape(-1, 2).T
            graph = coo_array((np.ones(ends.shape[1]), ends), shape=(len(labels), len(labels)))
            n_blocks, block_of = connected_components(graph, directed=False)
            if n_blocks >= 3:
                break
        return block_of[codes]

    def lengths_among(self, rows):
        """Known lengths whose two ends are among these rows' positions."""
        present = set(self.positions[rows].tolist())
        return [entry for entry in self.lengths if {*entry[:2]} <= present]

    def calibrate(self, rows=None):
        """Calibrate on some rows; on None on all, as they were given."""
        angles, positions, points, tools = self.given
        if rows is not None:
            angles, positions = self.angles[rows], self.positions[rows]
            points, tools = _at(rows, self.points), _at(rows, self.tools)
        if points is not None:
            return calibrate(self.arm, angles, points=points, tools=tools)
        lengths = self.lengths if rows is None else self.lengths_among(rows)
        return calibrate(self.arm, angles, positions, lengths=lengths, tools=tools)

    def residuals(self, calibration, rows):
        """What is wrong with the calibrated arm's points at these rows, mm, in the base frame."""
        groups = self.positions[rows] if self.points is None else None
        points, tools = _at(rows, self.points), _at(rows, self.tools)
        return calibration.residuals(self.angles[rows], points, groups, tools=tools)

    def shown(self, calibration, rows):
        """Points of the calibrated arm with the probe of each of these rows, (n, 3) mm."""
        return points_of(calibration.arm, self.angles[rows], self._probes(calibration, rows))

    def at_probes(self, model, calibration, rows):
        """The model as it predicts these rows, each with its own probe."""
        if self.tools is None:
            return model
        moved = {tool: model.with_arm(arm) for tool, arm in calibration.arms.items()}
        return _OfTools(moved, self.tools[rows])

    def _probes(self, calibration, rows):
        """Probe of each of these rows, (n, 3) in mm; None where all have the arm's."""
        tools = _at(rows, self.tools)
        return None if tools is None else np.array([calibration.arms[t].probe for t in tools])

    def outliers(self, calibration):
        """Rows far from where the calibrated arm has them, which its error model cannot explain."""
        far = np.flatnonzero(calibration.sample_weight[self.rows] == 0)
        if not len(far):
            return far
        every = np.arange(len(self.angles))
        rows, lonely = self.without_lonely(every)
        model = model_for(None, calibration.arm, self.causes)
        y = self.residuals(calibration, rows)
        probes = self._probes(calibration, rows)
        with ignored_findings():  # what there is to say is said of the rows that are learnt from
            model.fit(self.inputs[rows], y, groups=self.positions[rows], probes=probes)
        return np.intersect1d(far, np.r_[rows[model.pose_weight_ == 0], lonely])

    def fit(self, model, calibration, rows):
        """Fit a copy of the model for this calibration on these rows: model, noise in mm."""
        y = self.residuals(calibration, rows)
        fitted = None
        if self.like and model is None:
            of_rows = self.inputs[rows], y, self.positions[rows]
            fitted = transferred_model(self.like, calibration.arm, *of_rows)
        if fitted is None:
            fitted = self._fit_alone(model, calibration, rows, y)
        left = y - self.at_probes(fitted, calibration, rows).predict(self.inputs[rows])
        if self.points is None:
            left = position_residuals(left, self.positions[rows])
        return fitted, float(np.sqrt(np.mean(np.square(left))))

    def _fit_alone(self, model, calibration, rows, y):
        fitted = model_for(model, calibration.arm, self.causes)
        # Of a pipeline, what its last step takes.
        last: Any = fitted
        prefix = ""
        while isinstance(last, Pipeline):
            prefix, last = f"{prefix}{last.steps[-1][0]}__", last.steps[-1][1]
        # A tracker knows where the positions are: lengths between them tell the model nothing.
        lengths = [] if self.points is not None else self.lengths_among(rows)
        extra = {"groups": self.positions[rows], "lengths": lengths}
        if self.tools is not None:
            if not (last is fitted and has_fit_parameter(last, "probes")):
                raise ValueError(
                    "tools need an ArmResidualRegressor as the model, not in another one."
                )
            extra["probes"] = self._probes(calibration, rows)
        extra = {
            f"{prefix}{name}": value
            for name, value in extra.items()
            if len(value) and has_fit_parameter(last, name)
        }
        return fitted.fit(self.inputs[rows], y, **extra)


def _at(rows, values):
    return None if values is None else values[rows]


class _OfTools:
    """A model at the probes of several tools, by their labels, for rows with these (n,) labels."""

    def __init__(self, models, tools):
        self.models, self.tools = models, tools

    def predict(self, X, return_std=False):
        found = np.empty((1 + return_std, len(X), 3))
        for tool, model in self.models.items():
            if (rows := self.tools == tool).any():
                found[:, rows] = model.predict(X[rows], return_std)
        return tuple(found) if return_std else found[0]


def _regions(points):
    """Labels of regions of neighbouring points, which take the place of positions."""
    n_regions = min(_MOST_REGIONS, max(_FEWEST_REGIONS, len(points) // _ROWS_OF_A_REGION))
    if len(np.unique(points, axis=0)) < n_regions:
        raise ValueError(f"without positions, at least {n_regions} different points are needed.")
    codes = KMeans(n_regions, n_init=4, random_state=0).fit_predict(points)
    return np.array([f"region {i + 1:02d}" for i in range(n_regions)])[codes]


def model_for(model, arm, causes=()):
    """Copy of a model, or the default one, for this arm and for angles in rad."""
    if model is None:
        return ArmResidualRegressor(arm, extra=causes)
    model = clone(model)
    changes = {}
    for name, value in model.get_params(deep=True).items():
        last = name.rsplit("__")[-1]
        if last == "arm":
            changes[name] = arm
        elif last == "extra" and causes:
            changes[name] = causes
        elif last == "angle_unit":
            changes[name] = "rad"
        elif last == "azimuth" and ismethod(value) and isinstance(value.__self__, Arm):
            changes[name] = arm.azimuth
    return model.set_params(**changes)
