"""What is learnt from, checked once, and one fit of calibration and model on some of its rows."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from copy import copy
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from sklearn.base import clone
from sklearn.utils.validation import has_fit_parameter

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.calibration import calibrate, disagreeing, places_of
from sklearn_raacmm.correction._change import transferred_model
from sklearn_raacmm.error_model import ArmResidualRegressor, check_extra
from sklearn_raacmm.measurements import Features, order_explained_by
from sklearn_raacmm.utils import Finding, FindingError, Groups, align, last_step_of, listed

# Regions that a tracker's poses are judged at, and poses of one: enough for an interval, and few
# enough to read.
_FEWEST_REGIONS, _MOST_REGIONS, _POSES_OF_A_REGION = 5, 30, 4
# Positions of which fewer poses share theirs are names of single poses.
_SHARED = 0.5
# Share of the variance of the row number that angles may explain where time is to be learnt: of two
# robots whose time helped -0.15 and -0.04, of one that it harmed 0.69.
_MOST_EXPLAINED = 0.2
# Angles in rad within which all rows are one pose; `find_poses` has the same.
_STILL = 1e-3
# How often the bases of stations are found through a model. Of four simulated arms at three
# stations 17.4 um are left with those of the calibration, 10.1 after once, 9.5 after twice, 9.3
# after three times; at one station 8.6 (``benchmarks/bench_few_poses.py --stations``).
_ROUNDS_OF_STATIONS = 2
# Orders of the model that tells outliers and wrong lengths: those of smooth functions of angles.
_LOW_ORDERS = 48


class Data:
    """What was `measured`, and how it is judged: by which positions, and what is left out together.

    `rows` are the first rows of each pose among those given; `causes` name the columns of `values`
    (n, n_causes); `like` are models of earlier arms of the make; `joined` are tuples of positions
    that are one, or of one block; `places` (n,) what is left out together where that is
    less than a position; `vertical` is the `up` of `Terms` that a model of all rows has, where
    there is one. Of touches, `kinds` are those of the labels of surfaces, whose rows are not `held`
    in one point, and `longer` is by how many mm a length is for the centre of the probe's own ball.
    """

    vertical: Any = None
    longer: Any = None

    def __init__(self, arm, measured, like=(), blocks=None):
        refuse_one_pose(measured.angles)
        self.measured, self.arm, self.like = measured, arm, listed("like", like)
        self.rows, pose = measured.poses.first, measured.poses.pose
        self.angles, self.points = measured.angles, measured.points
        labels = np.ones(1) if measured.labels is None else measured.labels
        codes = np.zeros(len(self.angles), dtype=int)
        codes = codes if measured.index is None else measured.index
        # As long as they were when they were measured. Of a ball and itself it is its size.
        ends = labels.tolist()
        self.lengths = [(ends[i], ends[j], *of) for i, j, *of in measured.lengths]
        kinds = zip(ends, measured.features or [], strict=False)
        self.kinds = {label: kind for label, kind in kinds if kind != "cone"}
        self.n_shown = measured.n_shown
        self.held = self.n_shown == 3
        given = codes[pose]
        tied = [i for entry in measured.lengths for i in entry[:2]]
        alone = np.setdiff1d(np.flatnonzero(np.bincount(given) == 1), tied)
        if self.points is None and len(alone):
            raise ValueError(
                f"position {ends[alone[0]]!r} has a single row, row "
                f"{np.flatnonzero(given == alone[0])[0]}: is its label mistyped?"
            )
        for what, given_too in (("tools", measured.tools is not None), ("features", self.kinds)):
            if given_too and self.like:
                raise ValueError(f"like and {what} cannot be given together.")
        if blocks is not None:
            names, of_block = Groups.encoded(blocks, len(pose), "blocks")
            blocks = names[of_block][self.rows]
        self.positions, self.places = labels[codes], None
        self.tools = named(measured.tools, measured.tool_labels)
        self.stations = named(measured.stations, measured.station_labels)
        if self.points is not None and not self.lengths:
            of_poses = None if measured.index is None else self.positions
            # Stations have frames of their own, and the arm's points one.
            near = self.points if self.stations is None else arm.forward(self.angles)
            self.positions, self.places = _judged_at(of_poses, near, blocks)
        self.causes, self.values = _causes(arm, measured, Groups.encoded(self.positions)[1])
        self.joined = []
        if blocks is not None:
            of_blocks = [np.unique(self.positions[blocks == name]) for name in np.unique(blocks)]
            self.joined = [tuple(one.tolist()) for one in of_blocks]

    def seen_by(self, calibration):
        """The same with what a calibration of all rows has found.

        Positions that are one place are joined. Lengths that are wrong are left out.
        """
        seen = copy(self)
        one_place = [f.positions for f in calibration.findings if f.code == "one-place"]
        seen.joined = [*one_place, *self.joined]
        seen._leave_out_wrong(calibration)
        if self.kinds:
            every = np.arange(len(self.angles))
            points = self.shown(calibration, every)
            off = self.length_errors(points, every, seen.lengths, robust=True)
            sides = zip(seen.lengths, off, seen.measured.offsets, strict=True)
            seen.longer = {entry[:2]: by[np.argmin(abs(mm - by))] for entry, mm, by in sides}
        return seen

    def along_vertical_of(self, model):
        """The same for models of some of the rows, which do not seek the vertical of a model."""
        known, linear = copy(self), getattr(last_step_of(model)[0], "linear_model_", None)
        known.vertical = None if linear is None else linear.terms.up
        return known

    @property
    def inputs(self):
        """Angles, then the causes, of each row."""
        return np.hstack([self.angles, self.values])

    def as_given(self, angles):
        """Of the rows that are learnt: these angles, which were given, positions, and points.

        Of several stations those of the one with most rows.
        """
        own = slice(None)
        if self.stations is not None:
            codes = Groups.encoded(self.stations)[1]
            own = codes == np.bincount(codes).argmax()
        positions = self.positions if self.points is None else None
        points = None if self.points is None else self.points[own]
        angles = np.asarray(angles, dtype=float)
        rows = self.rows if len(angles) == len(self.measured.poses.pose) else slice(None)
        return angles[rows][own], positions, points

    def without_lonely(self, rows=None):
        """Of these rows, or all, those of positions with two or more; others have no residuals."""
        rows = np.arange(len(self.angles)) if rows is None else rows
        if self.points is not None:
            return rows, rows[:0]
        touched = self._touched(rows)[1]
        alone = ~touched.scatter[touched.codes]
        return rows[~alone], rows[alone]

    def blocks(self):
        """Block of each row: positions at one place, of one block, or joined by lengths are one."""
        labels, codes = np.unique(self.positions, return_inverse=True)
        number = {label: i for i, label in enumerate(labels.tolist())}
        pairs = [(block[0], other) for block in self.joined for other in block]
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

    def calibrate(self, rows=None, accept=(), free=Arm.TABLE):
        """Calibrate on some rows, the fields `free`; on None on all, as they were given."""
        measured = self.measured if rows is None else self.measured.at(rows)
        return calibrate(self.arm, measured, accept=accept, free=free)

    def shown(self, calibration, rows):
        """Points (n, 3) that the calibrated arm shows in these rows, mm, in the base frame."""
        return calibration.arm.points_at(self.angles[rows], self.probes(calibration, rows))

    def _touched(self, rows):
        """Labels of these rows, and the `Features` that they name."""
        labels, codes = Groups.encoded(self.positions[rows])
        return labels, Features([self.kinds.get(label, "cone") for label in labels.tolist()], codes)

    def _about_forms(self, points, rows, robust):
        """Points (n, 3) of these rows about the form of their position, and the form by label.

        Those that are not slips, if `robust`, decide on the form.
        """
        labels, touched = self._touched(rows)
        about = touched.linearised(points, None if robust else np.ones(len(points)))
        return about.residual, dict(zip(labels.tolist(), about.forms, strict=True))

    def length_errors(self, points, rows, entries, robust=False):
        """Errors of known lengths, mm, in points (n, 3) of these rows."""
        if not entries:
            return np.empty(0)
        form = self._about_forms(points, rows, robust)[1]
        found = [form[a].length_to(form[b])[0] for a, b, *_ in entries]
        return np.subtract(found, [mm for _, _, mm, _ in self.at_centres(entries)])

    def at_centres(self, lengths):
        """Lengths as they are for the centre of the probe."""
        longer = self.longer or {}
        return [(a, b, mm + longer.get((a, b), 0.0), sd) for a, b, mm, sd in lengths]

    def as_shown(self, left, std):
        """Deviations and their standard deviations, (n, 3) each, in coordinates that rows show.

        A touch of a surface shows its distance from the form, which has taken some of the touches.
        """
        if not self.kinds:
            return left, std
        left, std, surface = left.copy(), std.copy(), ~self.held & np.isfinite(left).all(axis=1)
        distance = np.linalg.norm(left[surface], axis=1)
        out = left[surface] / np.maximum(distance, 1e-300)[:, None]
        touched = self._touched(surface)[1]
        n, unknown = np.bincount(touched.codes), touched.n_unknowns
        free = np.where(n > unknown, (n - unknown) / n, np.nan)[touched.codes]
        std[surface, 0] = np.linalg.norm(out * std[surface], axis=1) * np.sqrt(free)
        left[surface] = np.nan
        left[surface, 0] = np.where(np.isfinite(std[surface, 0]), distance, np.nan)
        return left, std

    def residuals(self, calibration, rows, correction: Any = 0.0, robust=True):
        """What is wrong with the calibrated, corrected arm at these rows, mm, in the base frame.

        About a tracker's points; else about the mean of the position, or the nearest of its form,
        which rows that are not slips decide on, if `robust`.
        """
        if self.points is None:
            return self._about_forms(self.shown(calibration, rows) - correction, rows, robust)[0]
        parts = (self.tools, self.stations)
        tools, stations = (None if part is None else part[rows] for part in parts)
        given = {"tools": tools, "stations": stations}
        return calibration.residuals(self.angles[rows], self.points[rows], **given) - correction

    def at_probes(self, model, calibration, rows):
        """The model as it predicts these rows, each with its own probe."""
        if self.tools is None:
            return model
        tools = self.tools[rows]

        def predict(X, return_std=False):
            found = np.empty((1 + return_std, len(X), 3))
            for tool in np.unique(tools):
                moved, own = model.with_arm(calibration.arms[tool]), tools == tool
                found[:, own] = moved.predict(X[own], return_std)
            return tuple(found) if return_std else found[0]

        return SimpleNamespace(predict=predict)

    def probes(self, calibration, rows):
        """Probe of each of these rows, (n, 3) in mm; None where all have the arm's."""
        if self.tools is None:
            return None
        return np.array([calibration.arms[tool].probe for tool in self.tools[rows]])

    def without_outliers(self, calibration):
        """The same without lengths that disagree beside what a model explains, and outliers.

        These are rows far from where the calibrated arm has them, which the model, of low orders
        and without the lengths, cannot explain.
        """
        far, seen = np.flatnonzero(calibration.sample_weight[self.rows] == 0), copy(self)
        several = self.points is None and len(self.lengths) > 1 and not self.causes
        if not (len(far) or several):
            return seen, far
        rows, lonely = self.without_lonely()
        with Finding.ignored():  # what there is to report is reported of the rows that are learnt
            y = self.residuals(calibration, rows)
            low = ArmResidualRegressor(orders=_LOW_ORDERS)
            model = self._fitted(low, calibration, rows, y, [], judged=False)
            again = several and calibrate(calibration.arm, self.measured, correction=model)
        if again:
            seen._leave_out_wrong(again)
            for finding in disagreeing(self.measured, again):
                finding.report()
        return seen, np.intersect1d(far, np.r_[rows[model.pose_weight_ == 0], lonely])

    def _leave_out_wrong(self, calibration):
        """Leave out the known lengths that disagree with the rest of a calibration."""
        if self.lengths and self.points is None:
            wrong = calibration.wrong_lengths
            self.measured = self.measured.without_lengths(wrong)
            self.lengths = [one for one, out in zip(self.lengths, wrong, strict=False) if not out]

    def fit(self, model, calibration, rows):
        """Fit a copy of the model for this calibration on these rows: model, noise in mm."""
        X, y, positions = self.inputs[rows], self.residuals(calibration, rows), self.positions[rows]
        fitted = None
        if self.like and model is None:
            fitted = transferred_model(self.like, calibration.arm, X, y, positions)
        if fitted is None:
            # Where the positions are, a tracker knows.
            lengths = [] if self.points is not None else self.lengths_among(rows)
            fitted = self._fitted(model, calibration, rows, y, lengths)
        expected = self.at_probes(fitted, calibration, rows).predict(X)
        left = self.residuals(calibration, rows, expected)
        return fitted, float(np.sqrt(np.square(left).sum() / self.n_shown[rows].sum()))

    def at_stations(self, model, calibration, rows):
        """The calibration with the base of each station where points say that a model corrects.

        What the arm does wrong has moved the bases that the calibration has found, each by another
        error, which a model would take for constants of positions.
        """
        for _ in range(_ROUNDS_OF_STATIONS if len(calibration.bases) > 1 else 0):
            y, of_rows = self.residuals(calibration, rows), self.stations[rows]
            fitted = self._fitted(model, calibration, rows, y, [], judged=False)
            corrected = self.shown(calibration, rows)
            corrected -= self.at_probes(fitted, calibration, rows).predict(self.inputs[rows])
            bases = {
                label: align(corrected[of_rows == label], self.points[rows][of_rows == label])
                for label in calibration.bases
            }
            rotation, translation = next(iter(bases.values()))
            calibration = replace(
                calibration, bases=bases, base_rotation=rotation, base_translation=translation
            )
        return calibration

    def _fitted(self, model, calibration, rows, y, lengths, judged=True):
        """Copy of a model, or the default one, fitted to the residuals y of these rows."""
        fitted = self._model_for(model, calibration.arm)
        last, prefix = last_step_of(fitted)
        if isinstance(last, ArmResidualRegressor) and (self.vertical is not None or not judged):
            last._vertical, last._judged = self.vertical if judged else (), judged
        given = {"groups": self.positions[rows], "lengths": lengths}
        if self.stations is not None and not judged:
            del given["groups"]  # constants of positions would take up what bases are off by
        if self.kinds:
            known = self.at_centres(lengths)
            given["lengths"] = [entry for entry in known if entry[0] != entry[1]]
            sizes = {a: of for a, b, *of in known if a == b}
            present = set(self.positions[rows].tolist())
            given["features"] = [
                (one, kind, *sizes.get(one, ()))
                for one, kind in self.kinds.items()  # in their order: a set has none
                if one in present
            ]
        if self.tools is not None:
            given["probes"] = self.probes(calibration, rows)
        for what, name in (("tools", "probes"), ("features", "features")):
            if name in given and (prefix or not has_fit_parameter(last, name)):
                raise ValueError(
                    f"{what} need an ArmResidualRegressor as the model, not in another one."
                )
        given = {n: v for n, v in given.items() if len(v) and has_fit_parameter(last, n)}
        fitted.fit(self.inputs[rows], y, **{f"{prefix}{n}": v for n, v in given.items()})
        return fitted

    def _model_for(self, model, arm):
        """Copy of a model, or the default one, for this arm and for angles in rad."""
        if model is None:
            return ArmResidualRegressor(arm, extra=self.causes)
        model, known = clone(model), {"arm": arm, "angle_unit": "rad", "azimuth": arm.azimuth}
        if self.causes:
            known["extra"] = self.causes
        changed = {}
        for name, value in model.get_params(deep=True).items():
            last = name.rsplit("__")[-1]
            # An azimuth that is no arm's own stays.
            if last in known and (
                last != "azimuth" or isinstance(getattr(value, "__self__", None), Arm)
            ):
                changed[name] = known[last]
        return model.set_params(**changed)


def refuse_one_pose(angles):
    """Refuse rows of an arm that stood still, the same angles in rad within one turn."""
    if len(angles) > 1 and np.ptp(angles, axis=0).max() < _STILL:
        said = f"The arm did not move: {len(angles)} rows are 1 pose."
        raise FindingError(Finding("one-pose", said, "Measure other poses, too.", "refuse"))


def _judged_at(positions, points, blocks):
    """Labels (n,) that a tracker's poses are judged by, and codes of what is left out together.

    Positions, if they can be judged by: at least half of the poses share theirs with another. Names
    of single poses do not say which poses are neighbours: blocks take their place, or else regions
    of neighbouring points. Of these the places are left out, for new poses lie between known ones.
    None: what is left out are the labels.
    """
    why = "there are no labels of positions"
    if positions is not None:
        codes = Groups.encoded(positions)[1]
        if np.mean(np.bincount(codes)[codes] > 1) >= _SHARED:
            return positions, None
        why = "the labels of positions name single poses"
    if blocks is not None:
        return blocks, None
    regions = _regions(points)
    n_regions = len(np.unique(regions))
    text = f"Judged at {n_regions} regions of neighbouring points: {why}."
    Finding("judged-at-regions", text, weight="note").report()
    return regions, places_of(points)


def _regions(points):
    """Labels of regions of neighbouring points, which take the place of positions.

    The region of most points is divided across its longest side, at the widest gap in the middle
    third of its points, until there are enough: regions of similar numbers of points, which leave
    whole what was measured at one place.
    """
    places, place = np.unique(points, axis=0, return_inverse=True)
    n_regions = min(_MOST_REGIONS, max(_FEWEST_REGIONS, len(places) // _POSES_OF_A_REGION))
    if len(places) < n_regions:
        raise ValueError(f"without positions, at least {n_regions} different points are needed.")
    regions = [np.arange(len(places))]
    while len(regions) < n_regions:
        region = regions.pop(int(np.argmax([len(one) for one in regions])))
        axis = np.argmax(np.ptp(places[region], axis=0))
        region = region[np.argsort(places[region, axis], kind="stable")]
        first = min(max(len(region) // 3, 2), len(region) // 2)  # none of a single point
        gaps = np.diff(places[region, axis])[first - 1 : len(region) - first]
        regions += np.split(region, [first + int(np.argmax(gaps))])
    codes = np.repeat(np.arange(n_regions), [len(one) for one in regions])
    codes = codes[np.argsort(np.concatenate(regions))][place.ravel()]
    return np.array([f"region {i + 1:02d}" for i in range(n_regions)])[codes]


def _causes(arm, measured, codes):
    """Names and values (n, n_causes) of the causes offered to a model.

    Time that the angles explain is refused: what it explains may be the place.
    """
    given, angles = measured.extra, measured.angles
    check_extra(tuple(given), angles.shape[1])
    turns = arm.phases(angles)
    if "time" in given and (explained := order_explained_by(turns, codes)) > _MOST_EXPLAINED:
        raise ValueError(
            f"time cannot be learnt from this run: the angles explain the number of the row (R2 "
            f"{explained:.2f}, at most {_MOST_EXPLAINED}), so that time and place are not apart. "
            "Measure the positions in mixed order, or leave time out."
        )
    return tuple(given), np.reshape([*given.values()], (len(given), len(angles))).T


def named(numbers, labels) -> Any:
    """Labels (n,) of tools or stations by their numbers, or None."""
    return None if numbers is None else np.array(labels)[numbers]


def usual_values(names, values):
    """What counts where a cause is not known: the mean, of time the last value, no direction."""
    usual = {}
    for name, column in zip(names, values.T, strict=True):
        kind = name.split()[0]
        usual[name] = float({"time": column[-1], "direction": 0.0}.get(kind, column.mean()))
    return usual
