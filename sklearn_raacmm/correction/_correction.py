"""A correction in use: points and distances corrected, checked, registered, updated, moved."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from html import escape
from os import PathLike
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils import check_random_state

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.calibration import CalibrationResult, calibrate
from sklearn_raacmm.correction._change import as_prior, doubts_of
from sklearn_raacmm.correction._files import dump_model, load_model, read_folder, write_folder
from sklearn_raacmm.correction._model_check import CorrectionCheck, check_correction
from sklearn_raacmm.correction._rows import Expected, for_centres, new_rows
from sklearn_raacmm.correction._scores import CorrectionScores, linear_in_use, predict_with_std
from sklearn_raacmm.correction._suspects import named_changes
from sklearn_raacmm.correction._update import nothing_changed, probe_is_new, update_correction
from sklearn_raacmm.error_model import LEAST_POSITIONS, Rows, judge, shoulder as _shoulder
from sklearn_raacmm.measurements import Measurements, given_causes, position_residuals
from sklearn_raacmm.utils import Finding, Floats, Groups, align, check_option, listed, one_warning

# A base of which more is open is none that a correction could be used with, mm.
_WELL_KNOWN_MM = 1.0
# A registration keeps the probe where its poses are likelier of that one than of another, by so
# many nats: see ``benchmarks/bench_after_the_lab.py registers``.
_SAME_PROBE_NATS = 1.0
# Share of a standard deviation that is the arm's at least, whatever a reference states: a choice.
_LEAST_SHARE = 0.2
# Outliers, and positions, that are shown; colours of bars before and after.
_SHOWN, _COLOURS = 10, ("#999999", "#0072B2")
# What a tracker's frame is saved as.
_BASE = "rotation", "translation_mm"


class FittedModel(Protocol):
    """Any fitted regressor; that of `learn_correction` is an `ArmResidualRegressor`."""

    def predict(self, X: ArrayLike, /) -> Floats:
        """Residuals (n_samples, 3), mm."""
        ...


@dataclass(frozen=True, eq=False)
class Correction:
    """A calibrated arm, the model of what calibration leaves, and what both are worth.

    :func:`learn_correction` returns one and :meth:`load` reads one. `register`, `update`, `move`
    and `with_tool` return new ones, with the same scores.

    Attributes
    ----------
    arm : Arm
        The calibrated arm with the probe in use.
    model : estimator
        Fitted: ``model.predict(angles)``, in rad, is to be subtracted from ``arm.forward(angles)``.
    base : (ndarray of shape (3, 3), ndarray of shape (3,)) or None
        Rotation and translation in mm of the arm's base in the tracker's frame, of several
        stations at the first; None where no tracker has measured it.
    facts : dict
        Scores, verdict and versions as plain values: what ``correction.json`` holds.
    scores : CorrectionScores or None
        Positions left out, before and after. None after `load`.
    calibration : CalibrationResult or None
        Of the calibration, or of the last registration: parameters with their standard deviations,
        and what could not be identified. None after `load`.
    angles : ndarray of shape (n_samples, n_joints) or None
        Of the rows that it was learnt from, rad and within a turn. None after `load`.
    positions : ndarray of shape (n_samples,) or None
        Their labels. None after `load`.
    """

    arm: Arm
    model: FittedModel
    base: tuple[Any, ...] | None
    facts: dict[str, Any]
    scores: CorrectionScores | None = None
    calibration: CalibrationResult | None = None
    angles: Floats | None = None
    positions: np.ndarray | None = None

    @property
    def helps(self) -> bool:
        """Whether the correction is worth using at new positions."""
        return self.facts["helps"]

    @property
    def verdict(self) -> str:
        """The same in one sentence."""
        return self.facts["verdict"]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What there is to say about the data, a tuple of :class:`Finding`."""
        return tuple(Finding(**finding) for finding in self.facts["findings"])

    @property
    def noise(self) -> float:
        """Root mean square of a coordinate that the model leaves of its training rows, mm."""
        return self.facts["noise_mm"]

    @property
    def scale_sd(self) -> float:
        """Standard deviation of the arm's common scale, as a share of it, beside the model's own.

        0 where the model holds all of it: kinematic columns do, if the correction is used.
        """
        return self._scale_beside(linear_in_use(self.model))

    @property
    def causes(self) -> dict[str, float]:
        """The causes that the model takes after the angles, and what counts where one is not known.

        The mean, no direction, and of time the last value.
        """
        return self.facts["causes"]

    @property
    def tools(self) -> dict[str, Any]:
        """Vectors of the probes that it was learnt with by their labels, mm."""
        return self.facts.get("tools", {})

    @property
    def outliers(self) -> np.ndarray:
        """Rows left out as outliers, the farthest first: a structured array (n_outliers,).

        ``row``, ``position`` and ``distance`` in mm, see :class:`CorrectionScores`.
        """
        rows = [tuple(row) for row in self.facts["outliers"]]
        labels = np.array([row[1] for row in rows]) if rows else np.empty(0, "U1")
        fields = [("row", "i8"), ("position", labels.dtype), ("distance", "f8")]
        return np.array(rows, dtype=fields)

    @one_warning
    def correct(
        self,
        angles: ArrayLike,
        *,
        angle_unit: str = "rad",
        std_of: str = "coordinate",
        extra: Mapping[str, ArrayLike] | None = None,
    ) -> tuple[Floats, Floats]:
        """Corrected points, and how far to trust them.

        Parameters
        ----------
        angles : array-like of shape (n_samples, n_joints)
            Joint angles.
        angle_unit : {"rad", "deg"}, default="rad"
            Unit of `angles`.
        std_of : {"coordinate", "position"}, default="coordinate"
            What the standard deviations are of: a coordinate of one reading in the arm's base
            frame; or its deviation within a position, which is all that cones show: 95 % of the
            coordinates left out lay within 1.96 of them.
        extra : dict of str to array-like of shape (n_samples,), default=None
            The causes that `causes` names; for those that are missing it has what counts instead.

        Returns
        -------
        points : ndarray of shape (n_samples, 3)
            Corrected points in the arm's base frame, mm.
        std : ndarray of shape (n_samples, 3)
            Standard deviation of each coordinate of one reading, mm (k = 1). In the base frame it
            holds the standard deviation within a position, the scale, s (P - S) with P the point, S
            the shoulder and s ``calibration.scale_sd``, and how the arm may give way as a function
            of the place. For distances see :meth:`distances`.

        Raises
        ------
        ValueError
            If `angles` do not fit the arm, or `extra` names what the model does not know.
        """
        check_option("std_of", std_of, ("coordinate", "position"))
        X = self.inputs(self.arm.check_angles(angles, angle_unit), extra)
        points, within = self._within_positions(X)
        if std_of == "position":
            return points, within
        return points, self._of_coordinate(X, points, within)

    def distances(
        self, angles: ArrayLike, others: ArrayLike, *, angle_unit: str = "rad"
    ) -> tuple[Floats, Floats]:
        """Distances between pairs of corrected readings, and how far to trust them.

        Parameters
        ----------
        angles, others : array-like of shape (n_samples, n_joints)
            Joint angles at both ends.
        angle_unit : {"rad", "deg"}, default="rad"
            Unit of both.

        Returns
        -------
        lengths : ndarray of shape (n_samples,)
            In mm.
        std : ndarray of shape (n_samples,)
            Standard deviation of a distance between two readings, mm (k = 1): of its ends along
            the line, together and with what cones do not show, and of the scale of the arm.

        Raises
        ------
        ValueError
            If the angles do not fit the arm or each other.
        """
        ends = [self.inputs(self.arm.check_angles(one, angle_unit)) for one in (angles, others)]
        if len(ends[0]) != len(ends[1]):
            raise ValueError(f"There are {len(ends[0])} angles, but {len(ends[1])} others.")
        points, stds = map(list, zip(*map(self._within_positions, ends), strict=True))
        apart = points[1] - points[0]
        lengths = np.linalg.norm(apart, axis=1)
        along = apart / np.maximum(lengths, 1e-300)[:, None]
        variance = (self.scale_sd * lengths) ** 2
        # A linear model knows how both ends belong together, and what positions did not show;
        # without one the errors of both ends are taken as independent.
        if (linear := linear_in_use(self.model)) is not None:
            variance += linear.distance_std(*ends) ** 2
            stds = [self._of_arm(self.noise * linear.noise_ratio(X)) for X in ends]
        return lengths, np.sqrt(variance + np.square(along * np.hypot(*stds)).sum(axis=1))

    def sample(
        self,
        angles: ArrayLike,
        n_samples: int = 200,
        random_state: int | np.random.RandomState | None = None,
        *,
        angle_unit: str = "rad",
        extra: Mapping[str, ArrayLike] | None = None,
        with_noise: bool = False,
    ) -> Floats:
        """Draw corrected points of all poses together, with all that is not known of the arm.

        Compute a result, such as a diameter or a flatness, from the points of each draw: the
        standard deviation of these results is that of the result.

        Parameters
        ----------
        angles : array-like of shape (n_poses, n_joints)
            Joint angles.
        n_samples : int, default=200
            Number of draws.
        random_state : int, RandomState instance or None, default=None
            Of the draws.
        angle_unit, extra
            As in :meth:`correct`.
        with_noise : bool, default=False
            Whether each reading has noise of its own, independent from pose to pose.

        Returns
        -------
        points : ndarray of shape (n_poses, 3, n_samples)
            In the arm's base frame, mm, about those of :meth:`correct`. What is common to all
            draws of a pose and others, such as the scale of the arm, is drawn once for all poses.

        Raises
        ------
        ValueError
            As :meth:`correct`.
        TypeError
            If the model knows no causes, as an :class:`ArmResidualRegressor` does.

        Examples
        --------
        >>> import numpy as np
        >>> from sklearn_raacmm import learn_correction
        >>> from sklearn_raacmm.datasets import make_single_point
        >>> test = make_single_point(6, 15)  # simulated
        >>> correction = learn_correction(test.nominal_arm, test.data, test.groups, cv=3)
        >>> points = correction.sample(test.data[[0, 40]], 100, random_state=0)
        >>> lengths = np.linalg.norm(points[1] - points[0], axis=0)
        >>> bool(0.01 < np.std(lengths) < 1)
        True
        """
        model: Any = self.model
        if not hasattr(model, "linear_model_"):
            raise TypeError(f"{type(model).__name__} knows no causes: it draws no corrections.")
        rng = check_random_state(random_state)
        X = self.inputs(self.arm.check_angles(angles, angle_unit), extra)
        points = self.arm.forward(X[:, : self.arm.n_joints])
        drawn = points[:, :, None] - model.sample_y(X, n_samples, rng, with_noise=with_noise)
        scale = self._scale_beside(model.linear_model_) * rng.normal(size=n_samples)
        return drawn + (points - _shoulder(self.arm))[:, :, None] * scale

    def doubts(
        self, angles: ArrayLike, positions: ArrayLike | None = None, *, angle_unit: str = "rad"
    ) -> dict[str, float]:
        """Of which causes most is not known, of corrected points at some poses.

        Parameters
        ----------
        angles : array-like of shape (n_samples, n_joints)
            Joint angles.
        positions : array-like of shape (n_samples,), default=None
            Labels of positions, about which points deviate. None: of points in the base frame.
        angle_unit : {"rad", "deg"}, default="rad"
            Unit of `angles`.

        Returns
        -------
        dict of str to float
            Share of the variance of the points by cause, such as "probe" or "offset of joint 3",
            the largest first; empty where no model of causes is in use.
        """
        X = self.inputs(self.arm.check_angles(angles, angle_unit))
        codes = None if positions is None else Groups.encoded(positions, len(X))[1]
        linear = linear_in_use(self.model)
        return {} if linear is None else doubts_of(linear, X, codes)

    def check(
        self,
        angles: ArrayLike | Measurements,
        positions: ArrayLike | None = None,
        points: ArrayLike | None = None,
        lengths: Iterable[Sequence[object]] = (),
        *,
        angle_unit: str = "rad",
        extra: Mapping[str, ArrayLike] | None = None,
        new_base: bool = False,
        false_alarm_rate: float = 0.01,
        date: str | None = None,
        accept: str | Sequence[str] = (),
        features: Iterable[Sequence[object]] = (),
        tip_diameter: float = 0.0,
    ) -> CorrectionCheck:
        """Say from a few poses of today whether the correction still holds.

        Parameters
        ----------
        angles, positions, points, lengths, angle_unit, accept, features, tip_diameter
            As in :meth:`register`.
        extra : dict of str to array-like of shape (n_samples,), default=None
            As in :meth:`correct`.
        new_base : bool, default=False
            Whether the tracker stands elsewhere: its frame is then found from these same points,
            which takes up a part of any change, as where `base` is None.
        false_alarm_rate, date
            As in :func:`check_correction`.

        Returns
        -------
        CorrectionCheck

        Raises
        ------
        TypeError, ValueError
            As :func:`check_correction`.
        """
        given = angles, positions, points, lengths, extra, angle_unit, features, tip_diameter
        Finding.check_accepted(accept)  # a registration alone looks at them
        measured = self._measured(*given)
        new_base = measured.points is not None and (new_base or self.base is None)
        known = self.register(measured, free=(), accept=accept) if new_base else self
        y, today = known._shown(measured)
        model: Any = self.model  # of another kind is refused
        found = check_correction(
            model, self.inputs(measured.angles, measured.extra), y, **today,
            refitted=["base"] * new_base, false_alarm_rate=false_alarm_rate, date=date,
        )  # fmt: skip
        slipped = np.isin(measured.poses.pose, found.slipped)
        return replace(found, slipped=tuple(np.flatnonzero(slipped).tolist()))

    def register(
        self,
        angles: ArrayLike | Measurements,
        positions: ArrayLike | None = None,
        points: ArrayLike | None = None,
        lengths: Iterable[Sequence[object]] = (),
        *,
        angle_unit: str = "rad",
        free: Sequence[str] = ("probe",),
        accept: str | Sequence[str] = (),
        features: Iterable[Sequence[object]] = (),
        tip_diameter: float = 0.0,
    ) -> Self:
        """Find the probe, and the base from a tracker's points, through the correction.

        Where the poses are likelier of the probe that the correction was for than of another one,
        that is kept, unless it was only stated: few poses would find it worse. Of causes beside
        the angles counts what is usual.

        Parameters
        ----------
        angles : array-like of shape (n_samples, n_joints) or Measurements
            Joint angles of today's poses, or all that was measured.
        positions : array-like of shape (n_samples,), default=None
            Label of the position of each.
        points : array-like of shape (n_samples, 3), default=None
            Positions measured by a tracker, mm.
        lengths : iterable of (label, label, length, standard deviation), default=()
            Known distances between two positions, mm.
        angle_unit : {"rad", "deg"}, default="rad"
            Unit of `angles`.
        free, accept : list of str
            What is found beside the base, and codes of findings that are none: see
            :func:`calibrate`.
        features, tip_diameter
            Positions that are touches of planes or spheres, as in :func:`calibrate`.

        Returns
        -------
        Correction
            The same correction with the new probe and base; its `calibration` is the fit to these
            poses.

        Raises
        ------
        ValueError
            As :func:`calibrate`; or if the poses leave the base open by more than a millimetre.
        """
        given = angles, positions, points, lengths, None, angle_unit, features, tip_diameter
        measured = self._measured(*given)
        X, free = self.inputs(measured.angles), listed("free", free)
        model: Any = copy(self.model)
        linear: Any = getattr(model, "linear_model_", None)
        by_points = measured.points is not None
        found_before = linear_in_use(model) is not None and linear.shown_by is None
        if "probe" in free and found_before and not (by_points and linear.offsets):
            with Finding.ignored():  # of poses as if the probe were the old one
                expected = self._expected(measured, X)[2]
            if named_changes(expected, ["base"], -_SAME_PROBE_NATS, only=["probe"]) == []:
                free.remove("probe")
                said = "These poses are likelier of the probe that the correction was for than of"
                Finding("same-probe", f"{said} another: it is kept.", weight="note").report()
        places = np.arange(len(X)) if by_points else measured.index
        doubt: Any = None
        if "probe" in free and linear is not None and len(np.unique(places)) >= LEAST_POSITIONS:
            # These poses had no part in the fit: it fades beyond the largest doubt at them.
            doubt = linear.predict_with_doubt(X)[2]
            model.fading_ = replace(model.fading_, known_mm=float(doubt.max()))
        of_angles = self._of_angles(model)
        found = calibrate(self.arm, measured, correction=of_angles, free=free, accept=accept)
        turns = np.char.startswith(found.names, "base_r")
        open_mm = self.arm.reach_mm * found.standard_deviations[turns].max(initial=0.0)
        if open_mm > _WELL_KNOWN_MM:
            raise ValueError(
                f"these poses leave the base open by {open_mm:.2g} mm at the arm's reach: measure "
                "points that are spread in all directions, not along a line."
            )
        by_points = found.base_rotation is not None
        base = (found.base_rotation, found.base_translation) if by_points else self.base
        if "probe" in free and hasattr(model, "with_arm"):
            model = model.with_arm(found.arm)
        new = replace(self, arm=found.arm, model=model, base=base, calibration=found)
        if doubt is not None:  # and they say how much of it is used with another probe
            y, today = new._shown(measured)
            # A tracker's points show the offsets of positions, too.
            rows = (
                new_rows(model, X, y, **today)
                if today
                else Rows(self.arm, X, y, np.ones(len(y)), None)
            )
            correction, _, doubt = model.linear_model_.predict_with_doubt(X)
            before = float(model.fading_.found(doubt).mean())
            of_poses = found.sample_weight[measured.poses.first], rows.centre, places, before
            model.fading_ = judge(rows.y, correction, doubt, model.fading_, *of_poses)[0]
        return new

    def update(
        self,
        angles: ArrayLike | Measurements,
        positions: ArrayLike | None = None,
        points: ArrayLike | None = None,
        lengths: Iterable[Sequence[object]] = (),
        *,
        angle_unit: str = "rad",
        extra: Mapping[str, ArrayLike] | None = None,
        date: str | None = None,
        accept: str | Sequence[str] = (),
        features: Iterable[Sequence[object]] = (),
        tip_diameter: float = 0.0,
    ) -> Self:
        """Bring the model up to date with new poses; a tracker's base is found by them, too.

        The probe counts as the one that was registered, a little bent perhaps: the model holds that
        beside other changes. Only where the poses show another one it is registered first. Where
        they show nothing but noise, as its evidence says, the model stays as it is.

        Parameters
        ----------
        angles, positions, points, lengths, angle_unit, features, tip_diameter
            As in :meth:`register`.
        extra : dict of str to array-like of shape (n_samples,), default=None
            As in :meth:`correct`.
        date, accept
            As in :func:`update_correction`.

        Returns
        -------
        Correction

        Raises
        ------
        TypeError, ValueError
            As :meth:`register` and :func:`update_correction`.
        """
        given = angles, positions, points, lengths, extra, angle_unit, features, tip_diameter
        measured = self._measured(*given)
        X = self.inputs(measured.angles, measured.extra)
        model: Any = copy(self.model)
        y, today, expected = self._expected(measured, X)
        unchanged = nothing_changed(model, expected, date)
        if unchanged or not probe_is_new(expected):
            if not unchanged:
                model = update_correction(model, X, y, accept=accept, date=date, **today)
            new: Any = replace(self, model=model).register(measured, free=(), accept=accept)
            return replace(new, model=model)
        new = self.register(measured, accept=accept)
        y, today = new._shown(measured)
        model = update_correction(new.model, X, y, accept=accept, date=date, **today)
        return replace(new, model=model)

    def move(self, probe: ArrayLike) -> Self:
        """The same with another probe, whose vector is stated, by a drawing or an instrument.

        Poses with one probe do not show how the last frame is turned. With another probe standard
        deviations contain what that may do; a registration of it takes it out again.

        Parameters
        ----------
        probe : array-like of shape (3,)
            From the last frame to the centre of the probe, mm.

        Raises
        ------
        ValueError
            If the model knows no causes, so that only a registration helps.
        """
        return self._at_probe(probe, stated=True)

    def _at_probe(self, probe, stated=False):
        """The same with a probe whose vector is stated, or known in the frames of the table."""
        model: Any = self.model
        if not hasattr(model, "with_arm"):
            raise ValueError(
                "this correction has no model of causes: register the new probe instead."
            )
        arm = self.arm.replace(probe=probe)
        return replace(self, arm=arm, model=model.with_arm(arm, stated=stated))

    def with_tool(self, tool: str) -> Self:
        """The same with another of the probes that it was learnt with.

        Parameters
        ----------
        tool : str
            Its label.

        Raises
        ------
        ValueError
            If there is none of this label.
        """
        return self._at_probe(_labelled("tool", tool, self.tools, "with"))

    def at_station(self, station: str) -> Self:
        """The same with the base of another of the stations that it was learnt at.

        Parameters
        ----------
        station : str
            Its label.

        Raises
        ------
        ValueError
            If there is none of this label.
        """
        base = _labelled("station", station, self.facts.get("stations", {}), "at")
        return replace(self, base=tuple(np.array(part) for part in base))

    def save(
        self, folder: str | PathLike[str], others: Mapping[str, str | bytes] | None = None
    ) -> list[Path]:
        """Write the arm, the model and the scores into a folder.

        Whatever interrupts the writing, the folder holds the old correction or this.

        Parameters
        ----------
        folder : str or path-like
            Made if it does not exist.
        others : dict of str to str or bytes, default=None
            Names and contents of files to write with them, such as a report.

        Returns
        -------
        list of pathlib.Path
            ``correction.json`` with scores, verdict and versions, ``arm.json``, ``model.skops``,
            and the others.

        Raises
        ------
        ImportError
            If skops is not there.
        """
        base: Any = self.base
        if base is not None:
            base = dict(zip(_BASE, (part.tolist() for part in base), strict=True))
        contents: dict[str, str | bytes] = {"arm.json": self.arm.to_json(), **(others or {})}
        if "model.skops" not in contents:
            contents["model.skops"] = dump_model(self.model)
        return write_folder(folder, self.facts | {"base": base}, contents)

    @classmethod
    def load(cls, folder: str | PathLike[str]) -> Self:
        """Read a folder that `save` has written: the same without the data.

        Parameters
        ----------
        folder : str or path-like

        Returns
        -------
        Correction

        Raises
        ------
        ValueError
            If the files do not belong together, or are of another version.
        OSError
            If one is missing.
        ImportError
            If skops is not there.
        """
        facts, (arm, model) = read_folder(folder, ["arm.json", "model.skops"])
        model = load_model(folder, model, facts.get("written_by", "another version"))
        known = facts.get("base")
        base = None if known is None else tuple(np.array(known[name]) for name in _BASE)
        return cls(Arm.from_json(arm), model, base, facts)

    def inputs(self, angles: Floats, extra: Mapping[str, ArrayLike] | None = None) -> Floats:
        """What the model takes: angles in rad, (n, n_joints), then its causes."""
        given = given_causes(extra, len(angles))
        unknown = [name for name in given if name not in self.causes]
        if unknown:
            raise ValueError(
                f"extra names {unknown[0]!r}, of which the model knows nothing; it was fitted with "
                f"{', '.join(self.causes) or 'none'}."
            )
        columns = [np.broadcast_to(value, len(angles)) for value in (self.causes | given).values()]
        return np.column_stack([angles, *columns])

    def columns(self, X: Floats) -> Floats:
        """What a corrected table gets, (n_samples, 10) in mm, of what `inputs` returns.

        Points; standard deviations of the coordinates in the base frame and within a position; that
        of a distance of 1 m from here to a point that is known as well.
        """
        points, within = self._within_positions(X)
        scale = 1000 * self.facts["scale_sd"]
        of_metre = np.sqrt(2 * np.mean(within**2, axis=1) + scale**2)
        return np.column_stack([points, self._of_coordinate(X, points, within), within, of_metre])

    def residuals(self, angles: Floats, points: ArrayLike) -> Floats:
        """What the arm shows, in rad, less what a tracker measured, in the base frame, (n, 3) mm.

        Raises
        ------
        ValueError
            If no tracker has measured the base.
        """
        if self.base is None:
            raise ValueError(
                "this correction was learnt without a tracker and knows no frame of measured "
                "points: register it with some first."
            )
        rotation, translation = self.base
        return self.arm.forward(angles) - (np.asarray(points) - translation) @ rotation

    def _measured(
        self, angles, positions, points, lengths, extra, angle_unit, features, tip
    ) -> Any:
        """Today's `Measurements`, of one tool and one station, checked."""
        given = {"points": points, "lengths": lengths, "extra": extra, "angle_unit": angle_unit}
        given |= {"features": features, "tip_diameter": tip, "joint_types": self.arm.joint_types}
        measured = Measurements.taken(angles, positions, **given)
        measured.check_joints(self.arm)
        if measured.tools is not None or measured.stations is not None:
            raise ValueError("tools and stations are for calibrate and learn_correction.")
        if measured.points is None and measured.index is None:
            raise ValueError("Give positions, the label of each pose, or points, of a tracker.")
        return measured

    def _shown(self, measured):
        """Residuals (n, 3) of today's poses, and what else a model takes of them.

        Without the correction, in the base frame: against a tracker's points, or about positions.
        """
        if measured.points is not None:
            return self.residuals(measured.angles, measured.points), {}
        points = self.arm.forward(measured.angles)
        with Finding.ignored():  # of a correction that is not in use
            corrected = points - self.model.predict(self.inputs(measured.angles, measured.extra))
        today = for_centres(measured, corrected)
        return position_residuals(points, today["groups"], features=today["features"]), today

    def _expected(self, measured, X):
        """As `_shown`, the base being where the corrected points say; and what the model expects.

        `X` are the poses and causes, as `inputs` returns them.
        """
        model: Any = self.model
        base = self.base
        if measured.points is not None:
            base = align(self.arm.forward(measured.angles) - model.predict(X), measured.points)
        y, today = replace(self, base=base)._shown(measured)
        rows = new_rows(model, X, y, **today)
        return y, today, Expected(as_prior(model.linear_model_), rows)

    def _scale_beside(self, linear):
        """Standard deviation of the common scale beside that of a linear model, or of none."""
        own = 0.0 if linear is None else linear.scale_sd
        return float(np.sqrt(max(self.facts["scale_sd"] ** 2 - own**2, 0.0)))

    def _within_positions(self, X):
        """Corrected points, and standard deviations of their coordinates within a position."""
        correction, std = predict_with_std(self.model, X, self.noise)
        return self.arm.forward(X[:, : self.arm.n_joints]) - correction, self._of_arm(std)

    def _of_arm(self, std):
        """Standard deviations against a reference as intervals ask for, less the reference's."""
        variance = np.square(self.facts["std_factor"] * std)
        variance -= self.facts.get("points_sd_mm", 0.0) ** 2
        return np.sqrt(np.maximum(variance, np.square(_LEAST_SHARE * std)))

    def _of_coordinate(self, X, points, within):
        """Standard deviations of coordinates in the base frame, from those within a position.

        Cones do not show the common scale k of all lengths, which moves every point by k times its
        distance from the shoulder S; nor how the arm gives way as a function of the place. The base
        frame is the arm's own: z along the first axis, x where its encoder says, the origin below S
        by what the table says.
        """
        variance = within**2 + (self.scale_sd * (points - _shoulder(self.arm))) ** 2
        if (linear := linear_in_use(self.model)) is not None:
            variance += linear.unseen_variance(X)
        return np.sqrt(variance)

    def _of_angles(self, model):
        """The model as one of angles alone, to register by: of each cause counts what is usual."""
        of_angles = SimpleNamespace(predict=lambda angles: model.predict(self.inputs(angles)))
        if hasattr(model, "with_arm"):
            of_angles.arm_ = model.arm_
            of_angles.with_arm = lambda arm: self._of_angles(model.with_arm(arm))
        return of_angles

    def _repr_html_(self) -> str:
        """The verdict, and 2S or deviation of each position before and after as bars."""
        table = self.facts["positions"]
        columns = zip(*(table[name] for name in ("position", "before", "after")), strict=True)
        rows = sorted(columns, key=lambda row: -row[1])
        most = max([size for row in rows[:_SHOWN] for size in row[1:]], default=1.0) or 1.0
        parts = [f"<p><strong>{escape(self.verdict)}</strong></p><p>{escape(repr(self.arm))}</p>"]
        measure = escape(self.facts["measure"])
        parts.append(f"<table><tr><th>position</th><th>{measure}, mm</th><th></th></tr>")
        for name, *sizes in rows[:_SHOWN]:
            for label, value, colour in zip((name, "corrected"), sizes, _COLOURS, strict=True):
                parts.append(
                    f"<tr><td>{escape(str(label))}</td><td>{value:.4f}</td><td><svg width='200' "
                    f"height='10'><rect width='{200 * value / most:.1f}' height='10' "
                    f"fill='{colour}'/></svg></td></tr>"
                )
        more = f"<p>and {len(rows) - _SHOWN} more, with less before</p>" * (len(rows) > _SHOWN)
        return f"<div>{''.join(parts)}</table>{more}</div>"

    def __repr__(self) -> str:
        lines = [f"{self.arm!r}, {self.facts['n_rows']} rows"]
        if self.calibration is not None:
            before, after = self.calibration.scatter_before_mm, self.calibration.scatter_after_mm
            lines.append(f"calibration: mean scatter {before:.3f} -> {after:.3f} mm")
        lines.append(self.verdict if self.scores is None else str(self.scores))
        said = [f"  outlier: row {row} ({label}), {mm:.3g} mm" for row, label, mm in self.outliers]
        lines += said[:_SHOWN] + [f"  and {len(said) - _SHOWN} more"] * (len(said) > _SHOWN)
        return "\n".join(lines)


def _labelled(what, label, known, how):
    """The tool or station of a label, of those that a correction was learnt with or at."""
    if str(label) not in known:
        names = ", ".join(known) or "one only"
        raise ValueError(
            f"the correction knows no {what} {str(label)!r}; it was learnt {how} {names}."
        )
    return known[str(label)]
