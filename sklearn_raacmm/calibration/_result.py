"""What a calibration returns."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.measurements import Features
from sklearn_raacmm.utils import Finding, Floats, Groups, floats

# What the names of parameters that are angles begin with.
ANGLES = ("alpha", "theta", "base_r")
# What the fields of a table are called, and how many of its changes are said.
_WORDS = {
    "a": "length a", "alpha": "twist", "d": "length d", "theta_offset": "zero", "scale": "scale",
}  # fmt: skip
_MOST_CHANGES = 8
# Standard deviations of a known length beyond which it disagrees: once in 1.7 million.
_LENGTH_OUTLIER = 5.0
# Rows and combinations that are printed.
_N_SHOWN = 10


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """What a calibration found, and what it could not find.

    Attributes
    ----------
    arm : Arm
        The calibrated arm; with several tools, with the probe of the first. Of touches of surfaces
        its table is that which serves best in all directions at their poses. What it does not
        explain, taken as eccentric joints and gravity, is told apart for that.
    names : tuple of str
        Names of the parameters: the field of `Arm` and the row of the table from 1, such as
        ``"a2"`` or ``"theta_offset4"``; ``"scale1"``, by which the ways of joint 1 are multiplied
        where it slides; and ``"probe_x"`` to ``"probe_z"``. For measured points then the base:
        ``"base_rx"`` to ``"base_rz"`` (a rotation vector) and ``"base_x"`` to ``"base_z"``. Where
        there are several tools or stations, the label follows in brackets.
    nominal, values : ndarray of shape (n_parameters,)
        Values of the parameters before and after, mm and rad, and scales of slides. A base has no
        nominal value: NaN.
    standard_deviations : ndarray of shape (n_parameters,)
        Standard deviations of `values`, the prior included, mm and rad; 0 for parameters that were
        not free, infinite where nothing is known of one, NaN where there are no more coordinates
        than parameters. They suppose independent errors: where the arm bends, they are too small.
    unidentified : tuple of str
        Parameters that stay where the prior has them because the data do not know better, and
        ``"scale"`` if this is so of the common scale of all links.
    unidentified_combinations : tuple of str
        The sums of parameters that the data leave open, such as ``"d2 - d3"``, mm and rad.
    prior_sd : dict
        Prior standard deviations that were used: ``"length_mm"`` of the long lengths,
        ``"short_length_mm"``, ``"angle_rad"``, ``"probe_mm"``; of joints that slide
        ``"slide_mm"``, ``"slide_rad"`` and ``"slide_scale"``.
    rank, n_free, n_coordinates : int
        How many combinations of the free parameters the data can show at all, how many parameters
        were free (bases included), and how many coordinates there are, less three for each unknown
        fixed point.
    condition_number : float
        Of the data's Jacobian, a turn counting as what moves the stretched arm's end by its
        length; infinite if `rank` is below `n_free`.
    observability_index : float
        O1 of Borm and Menq [1]_ in the same units: the geometric mean of the singular values that
        are not zero, over the square root of the number of rows. Larger is better.
    scale_sd, scale_sd_corrected : float
        Relative standard deviation of the common scale of all links; and of that where a correction
        takes away what the table does not explain.
    scatter_given_mm, scatter_before_mm, scatter_after_mm : float
        Mean distance of the points, outliers included, from the mean of their group, or from their
        measured positions: with the arm as it was given, with nothing but the probe (and the base)
        fitted, and calibrated. With a correction, of the corrected points.
    residuals_mm : ndarray of shape (n_samples, 3)
        Difference of each point after calibration, in the arm's base frame.
    length_errors_mm, length_sd_mm : ndarray of shape (n_lengths,)
        Distances between the centres of groups less the known lengths, and the standard deviations
        of these errors. Sizes of features that were stated follow, as they come in `features`.
    sigma_mm : float
        Standard deviation that the fit found of a coordinate.
    outliers : tuple of int
        Rows farther than `outlier_limit_mm` from where they belong (the weighted mean of their
        group, which they hardly pull), the farthest first.
    outlier_limit_mm : float
        Distance that at most one set in twenty without outliers exceeds, from the number of rows,
        how long the tail of the distances is, and how well so many rows show that.
    sample_weight : ndarray of shape (n_samples,)
        For the fit of a correction to the same rows: 0 for outliers and for rows that may be some,
        1 for all others. Three in ten of small sets without outliers lose a row by it.
    groups : ndarray of shape (n_samples,) or None
        The labels, as given.
    arms, bases : dict
        The calibrated arm with the probe of each label of `tools`, and rotation and translation of
        each label of `stations`; empty without.
    base_rotation, base_translation : ndarray of shape (3, 3) and (3,), or None
        For measured points, the arm's base in their frame, with several stations of the first:
        ``points = arm.forward(angles) @ base_rotation.T + base_translation``.
    converged : bool
        Whether weights and parameters settled.
    findings : tuple of Finding
        What the calibration noticed in the data.
    features : tuple
        What was touched, as given.

    See Also
    --------
    calibrate : Makes one.

    References
    ----------
    .. [1] J. H. Borm, C. H. Menq, "Determination of optimal measurement configurations for robot
       calibration based on observability measure", Int. J. Robotics Research 10(1), 1991, 51-63.
    """

    arm: Arm
    names: tuple[str, ...] = field(repr=False)
    nominal: Floats = field(repr=False)
    values: Floats = field(repr=False)
    standard_deviations: Floats = field(repr=False)
    unidentified: tuple[str, ...]
    unidentified_combinations: tuple[Any, ...] = field(repr=False)
    prior_sd: dict[str, float] = field(repr=False)
    rank: int = field(repr=False)
    n_free: int = field(repr=False)
    n_coordinates: int = field(repr=False)
    condition_number: float = field(repr=False)
    observability_index: float = field(repr=False)
    scale_sd: float
    scale_sd_corrected: float = field(repr=False)
    scatter_given_mm: float
    scatter_before_mm: float
    scatter_after_mm: float
    residuals_mm: Floats = field(repr=False)
    length_errors_mm: Floats = field(repr=False)
    length_sd_mm: Floats = field(repr=False)
    sigma_mm: float
    outliers: tuple[int, ...]
    outlier_limit_mm: float = field(repr=False)
    sample_weight: Floats = field(repr=False)
    groups: np.ndarray | None = field(repr=False)
    arms: dict[str, Arm] = field(repr=False)
    bases: dict[str, Any] = field(repr=False)
    base_rotation: Floats | None = field(repr=False)
    base_translation: Floats | None = field(repr=False)
    converged: bool
    findings: tuple[Finding, ...] = ()
    features: tuple[Any, ...] = ()

    @property
    def typical_scatter_mm(self) -> float:
        """Mean distance from where rows belong, without the outliers, mm."""
        distance = np.linalg.norm(self.residuals_mm, axis=1)
        return float(np.delete(distance, list(self.outliers)).mean())

    @property
    def wrong_lengths(self) -> np.ndarray:
        """Which known lengths disagree with the rest of the data, (n_lengths,) of bool.

        By more than five standard deviations of their errors.
        """
        return np.abs(self.length_errors_mm) > _LENGTH_OUTLIER * self.length_sd_mm

    @property
    def changes(self) -> list[str]:
        """What calibration has changed of the table, in words: the largest at the probe first.

        Changes of more than three standard deviations, at most eight: a length by its size, an
        angle by what it does at the end of the stretched arm.
        """
        found = []
        columns = self.names, self.nominal, self.values, self.standard_deviations
        for name, nominal, value, sd in zip(*columns, strict=True):
            change, field = value - nominal, name.rstrip("0123456789")
            # Not what is held, or not known, nor bases and probes: nan compares false.
            if field not in _WORDS or name in self.unidentified or not abs(change) > 3 * sd > 0:
                continue
            factor, unit, size = 1.0, "mm", abs(change)
            if name.startswith(ANGLES):
                factor, unit, size = 180 / np.pi, "degrees", abs(change) * self.arm.reach_mm
            elif field == "scale":
                factor, unit, size = 1e6, "ppm", abs(change) * self.arm.reach_mm
            words = f"{_WORDS[field]} of joint {name.removeprefix(field)} {factor * change:+.4g} "
            found.append((size, f"{words}{unit} (sd {factor * sd:.2g})"))
        return [text for _, text in sorted(found, reverse=True)[:_MOST_CHANGES]]

    def residuals(
        self,
        angles: ArrayLike,
        points: ArrayLike | None = None,
        groups: ArrayLike | None = None,
        *,
        tools: ArrayLike | None = None,
        stations: ArrayLike | None = None,
        angle_unit: str = "rad",
    ) -> Floats:
        """Residuals of rows, old or new, in the arm's base frame: what a correction learns.

        Parameters
        ----------
        angles : array-like of shape (n_samples, n_joints)
            Joint angles.
        points : array-like of shape (n_samples, 3), default=None
            Measured points in mm, in the frame of those that the calibration was given.
        groups : array-like of shape (n_samples,), default=None
            Instead of points, the label of the fixed point of each sample.
        tools, stations : array-like of shape (n_samples,), default=None
            Labels as :func:`calibrate` was given them; None where it was given none.
        angle_unit : {"rad", "deg"}, default="rad"
            Unit of `angles`.

        Returns
        -------
        ndarray of shape (n_samples, 3)
            What the calibrated arm shows, without any correction, minus the measured point, or
            minus the mean of its group without slips or the nearest point of its feature (see
            :func:`position_residuals`), mm.

        Raises
        ------
        ValueError
            If shapes or labels do not fit, if points are given to a calibration that found no
            base, or if neither or both of points and groups are given.

        Examples
        --------
        >>> import numpy as np
        >>> from sklearn_raacmm import Arm, calibrate
        >>> arm = Arm.from_name("aacmm6")
        >>> angles = np.random.default_rng(0).uniform(-2, 2, (60, 6))
        >>> tracker = arm.forward(angles) + [1000, 0, 0]
        >>> result = calibrate(arm, angles[:40], points=tracker[:40], free=["probe"])
        >>> bool(np.abs(result.residuals(angles[40:], tracker[40:])).max() < 1e-3)
        True
        """
        angles = self.arm.check_angles(angles, angle_unit)
        if (points is None) == (groups is None):
            raise ValueError("Give either points, measured positions, or groups, labels.")
        shown = np.empty((len(angles), 3))
        for rows, arm in self._parts("tools", tools, self.arms, self.arm, len(angles)):
            shown[rows] = arm.forward(angles[rows])
        if groups is not None:
            labels, codes = Groups.encoded(groups, len(angles))
            named = labels.tolist()
            if self.features:
                given = [one for one in self.features if one[0] in named]
                return Features.stated(given, named, codes).linearised(shown).residual
            return Groups(codes).centred(shown, Groups(codes).slip_factors(shown))
        points = floats("points", points, 3)
        if len(points) != len(angles):
            raise ValueError(f"There are {len(points)} points, but {len(angles)} rows of angles.")
        if self.base_rotation is None:
            raise ValueError(
                "This calibration was made with groups and knows no frame of measured points. "
                "Give groups, or calibrate with points."
            )
        one = (self.base_rotation, self.base_translation)
        for rows, base in self._parts("stations", stations, self.bases, one, len(angles)):
            rotation, translation = base
            shown[rows] -= (points[rows] - translation) @ rotation
        return shown

    @staticmethod
    def _parts(name, labels, known, single, n):
        """Yield the rows of each label and what belongs to it."""
        if labels is None:
            if len(known) > 1:
                raise ValueError(f"The calibration has {len(known)} {name}: give {name}=labels.")
            yield slice(None), single
            return
        found, codes = Groups.encoded(labels, n, name)
        for i, label in enumerate(found.tolist()):
            if label not in known:
                raise ValueError(
                    f"{name} name {label!r}, which the calibration did not see; it has "
                    f"{', '.join(map(repr, known)) or 'none'}."
                )
            yield np.flatnonzero(codes == i), known[label]

    def __str__(self) -> str:
        lines = [
            f"Calibration of {self.arm!r}, {len(self.residuals_mm)} points",
            f"mean scatter: {self.scatter_given_mm:.4g} mm as given, "
            f"{self.scatter_before_mm:.4g} mm with the probe fitted, "
            f"{self.scatter_after_mm:.4g} mm calibrated",
            f"common scale of the links: +-{100 * self.scale_sd:.2g} %",
            f"{self.n_coordinates} coordinates, {self.n_free} free parameters, rank {self.rank}, "
            f"condition {self.condition_number:.3g}, O1 {self.observability_index:.3g}",
            f"{'parameter':<15}{'nominal':>12}{'value':>12}{'sd':>11}",
        ]
        for name, nominal, value, sd in zip(
            self.names, self.nominal, self.values, self.standard_deviations, strict=True
        ):
            factor, unit = (180 / np.pi, "deg") if name.startswith(ANGLES) else (1.0, "mm")
            if name.startswith("scale"):
                nominal, value, factor, unit = nominal - 1, value - 1, 1e6, "ppm"
            note = "  not identified" if name in self.unidentified else ""
            before = f"{nominal * factor:12.4f}" if np.isfinite(nominal) else f"{'':12}"
            sd_text = f"{'held':>11}" if sd == 0 else f"{sd * factor:11.4f}"
            lines.append(f"{name:<15}{before}{value * factor:12.4f}{sd_text} {unit}{note}")
        if self.unidentified_combinations:
            lines.append(f"open combinations: {len(self.unidentified_combinations)}")
            lines += _first([f"  {text}" for text in self.unidentified_combinations])
        distance = np.linalg.norm(self.residuals_mm, axis=1)
        lines.append(f"outliers beyond {self.outlier_limit_mm:.3g} mm: {len(self.outliers)}")
        rows = []
        for row in self.outliers:
            label = "" if self.groups is None else f" ({self.groups[row]})"
            rows.append(f"  row {row}{label}: {distance[row]:.3g} mm")
        return "\n".join(lines + _first(rows))


def _first(lines):
    more = len(lines) - _N_SHOWN
    return lines if more <= 0 else [*lines[:_N_SHOWN], f"  and {more} more"]
