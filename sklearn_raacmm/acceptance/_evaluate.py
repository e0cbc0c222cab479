"""A run judged: values before and after a correction, uncertainties, limits and decisions."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.acceptance._checks import find_faults
from sklearn_raacmm.acceptance._run import AcceptanceRun
from sklearn_raacmm.acceptance._values import FUNCTIONS, LAYOUTS, VALUES, Readings
from sklearn_raacmm.arm import Arm
from sklearn_raacmm.utils import Finding, check_option, floats

# One-sided 95 % of a normal error, the guard of ISO 14253-1.
_GUARD = 1.645
_RULES = ("guarded", "simple")
_DECISIONS = ("pass", "conditional pass", "conditional fail", "fail")


@dataclass(frozen=True)
class AcceptanceValue:
    """One value of a run, all lengths in mm.

    Attributes
    ----------
    name, test : str
        The value and its test.
    formula, standard, read : str
        How it is computed, after what, and what of that was read: the text of a standard, an open
        secondary source, or only what is common practice.
    before, after : float or None
        As found and as left, with their signs; None where the test was bad, or without correction.
    u_before, u_after : float
        The tester's standard uncertainty; U is twice that (k = 2).
    size_before, size_after : float
        Length or diameter that it was found at; 0 for a place.
    limit_before, limit_after : float or None
        At this size.
    decision_before, decision_after : str
        "pass", "conditional pass", "conditional fail", "fail"; "" without a limit or a value.
    interval_before, interval_after : (float, float) or None
        Of 95 %: what another run would change. Largest values have none.
    """

    name: str
    test: str
    formula: str
    standard: str
    read: str
    before: float | None = None
    after: float | None = None
    u_before: float = 0.0
    u_after: float = 0.0
    size_before: float = 0.0
    size_after: float = 0.0
    limit_before: float | None = None
    limit_after: float | None = None
    decision_before: str = ""
    decision_after: str = ""
    interval_before: tuple[float, float] | None = None
    interval_after: tuple[float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class AcceptanceResult:
    """What :func:`evaluate_acceptance` found.

    Attributes
    ----------
    values : tuple of AcceptanceValue
        In the order of the tests; those of a bad test have no numbers.
    findings : tuple of Finding
        What was wrong with which test.
    rule : str
        The decision rule.
    """

    values: tuple[AcceptanceValue, ...]
    findings: tuple[Finding, ...]
    rule: str

    def __getitem__(self, name: str) -> AcceptanceValue:
        return {value.name: value for value in self.values}[name]

    def __str__(self) -> str:
        lines = [f"{finding.weight}: {finding}" for finding in self.findings]
        for one in self.values:
            parts = [
                f"{1e3 * value:.1f} um (U{f' = {2e3 * u:.1f} um' if u else ' not stated'}) {what}"
                for value, u, what in (
                    (one.before, one.u_before, one.decision_before),
                    (one.after, one.u_after, one.decision_after),
                )
                if value is not None
            ]
            lines.append(f"{one.name}: {' -> '.join(map(str.rstrip, parts)) or 'no value'}")
        return "\n".join(lines)


def evaluate_acceptance(
    run: AcceptanceRun,
    arm: Arm | None = None,
    model: Any = None,
    *,
    found: Arm | None = None,
    base: tuple[ArrayLike, ArrayLike] | None = None,
    limits: Mapping[str, ArrayLike] | None = None,
    rule: str = "guarded",
) -> AcceptanceResult:
    r"""Values of a run of acceptance tests, before and after a correction.

    Parameters
    ----------
    run : AcceptanceRun
        The readings.
    arm : Arm, default=None
        The calibrated arm; needed where the run has angles, and for a correction.
    model : Correction or object, default=None
        A correction, with its own arm and base; or with ``predict(angles)``, in rad: residuals
        (n, 3) mm, subtracted from the points.
    found : Arm, default=None
        The arm as it was found. None: `arm`, without the model.
    base : (array-like of shape (3, 3), array-like of shape (3,)), default=None
        Rotation and translation, mm, of the arm's base in the frame of the tracker that measured
        the points of a pose test. None: that of the correction, or their frame is the base.
    limits : dict of str to float or (float, float, float), default=None
        Of the values by their names, mm: one number, or A, s and B for A + s L, at most B, such as
        ``(0.02, 1 / 50_000, 0.05)`` for 20 um + L / 50 with L in mm.
    rule : {"guarded", "simple"}, default="guarded"
        Decision rule of ISO 14253-1: the uncertainty is the tester's, who has to prove with 95 %,
        by a guard of 1.645 u, and cannot where u is not stated; or simple acceptance, without
        guard.

    Returns
    -------
    AcceptanceResult
        With a finding, and no value, for each test that is not whole, or whose readings cannot be
        of what is stated, or were not taken as the test asks. Lengths that are all off by one
        number keep their values beside a doubt.

    Raises
    ------
    ValueError
        If a test or the name of a limit is unknown, or angles do not fit the arm.

    Notes
    -----
    ============== ============================================ ==================================
    test           readings                                     values
    ============== ============================================ ==================================
    probing        25 points on a sphere at 2 positions         P_Size, P_Form
    articulation   5 articulations of 5 points on a sphere      L_Dia
    length         5 lengths, 7 positions, 3 repeats, 2 ends    E_Uni
    bidirectional  the same, on opposite faces                  E_Bi
    diameter       3 times 9 points on a sphere                 effective diameter
    single-point   10 or more in a cone near, middle and far    2S, largest, half range
    volumetric     20 or more placements of a bar, 2 ends       volumetric largest, range, 2 rms
    pose           5 poses, 30 times or more                    AP, RP
    ============== ============================================ ==================================

    After ISO 10360-12:2016, ASME B89.4.22-2004 and ISO 9283:1998, of which only open secondary
    sources were read. VDI/VDE 2617-9 and JJF 1408 share the probing, articulation and length tests;
    there is no code of their own. No value is a statement of conformance to any of them.

    The standard uncertainty u holds what ISO 14253-5 leaves to the tester: calibration, temperature
    and expansion of the artefact, its form and its fixture, not how the arm repeats. An oval form F
    moves the diameter of half a sphere by 0.46 F, and L_Dia by 0.92 F (rms, simulated); to P_Form
    it adds F / 2 (after ISO/TS 23165). That of places and poses is the `fixture_mm` of the seat or
    the tracker. Of a size A + s L every single length has its own limit and
    decision; the value is the one with the least room.

    A 2S has an interval by :func:`~sklearn_raacmm.metrics.repeatability_interval`, 2 rms of n
    placements one by chi-squared with n degrees of freedom; a maximum has none.

    Examples
    --------
    >>> from sklearn_raacmm.acceptance import evaluate_acceptance
    >>> from sklearn_raacmm.datasets import make_acceptance
    >>> data = make_acceptance(tests=["single-point"], random_state=0)  # simulated
    >>> result = evaluate_acceptance(data.run, data.arm, limits={"2S far": 0.1})
    >>> [value.name for value in result.values][:3]
    ['2S near', '2S middle', '2S far']
    >>> result["2S far"].decision_before
    'pass'
    """
    check_option("rule", rule, _RULES)
    bounds = {name: _checked_limit(name, limit) for name, limit in (limits or {}).items()}
    if unknown := sorted(set(run.test.tolist()) - set(LAYOUTS)):
        raise ValueError(f"the run has the test {unknown[0]!r}; known are {', '.join(LAYOUTS)}.")
    if hasattr(model, "calibration"):  # it is a correction
        correction, arm = model, arm or model.arm
        base = correction.base if base is None else base
        model = SimpleNamespace(predict=lambda q: correction.model.predict(correction.inputs(q)))
    sides = _points(run, arm, model, found)
    largest = max((one.size_mm or 0.0 for one in run.artefacts), default=0.0)
    findings: list[Finding] = []
    values = []
    for test in LAYOUTS:
        rows = np.flatnonzero(run.test == test)
        if not len(rows):
            continue
        readings = [_readings(run, rows, side, test, base) for side in sides]
        computed = []
        try:
            # As left is looked at where there is one: its errors are smaller, and faults stand out.
            own = [one for name, one in bounds.items() if VALUES[name][0] == test]
            most = max((min(a + s * largest, b) for a, s, b in own), default=None)
            faults = find_faults(readings[-1], arm, most)
            if all(fault.weight == "doubt" for fault in faults):
                computed = [FUNCTIONS[test](each) for each in readings]
        except ValueError as error:
            advice = "Measure points that determine what was probed."
            faults = [Finding("acceptance-geometry", f"{test}: {error}", advice, weight="repair")]
        findings += faults
        for name, about in VALUES.items():
            if about[0] == test:
                judged = _judged([each[name] for each in computed], bounds.get(name), rule)
                values.append(AcceptanceValue(name, *about, **judged))
    return AcceptanceResult(values=tuple(values), findings=tuple(findings), rule=rule)


def _checked_limit(name, limit):
    """Limit as A, s and B, mm."""
    if name not in VALUES:
        raise ValueError(f"limits names {name!r}; known are {', '.join(VALUES)}.")
    numbers = floats(f"the limit of {name}", limit)
    if numbers.shape == ():
        numbers = np.array([float(numbers), 0.0, np.inf])
    if numbers.shape != (3,) or np.isnan(numbers).any() or numbers[0] <= 0 or min(numbers) < 0:
        raise ValueError(f"the limit of {name} must be a positive number or A, s, B: {limit!r}.")
    return numbers


def _points(run, arm, model, found):
    """Points as found, and as left where there is a model: each with what the arm believes."""
    if run.angles is None or arm is None:
        if run.points is None:
            raise ValueError("a run of joint angles needs the arm that they are of.")
        if model is not None:
            raise ValueError("a correction needs the joint angles of the run, and the arm.")
        return [(run.points, None)]
    angles = arm.check_angles(run.angles, "rad")
    believed = (found or arm).forward(angles)
    sides = [(believed if run.points is None else run.points, believed)]
    if model is not None:
        residuals, believed = np.asarray(model.predict(angles)), arm.forward(angles)
        shown = believed if run.points is None else run.points
        sides.append((shown - residuals, believed - residuals))
    return sides


def _readings(run, rows, side, test, base):
    """The readings of a test, those of a pose test in the frame of the arm's base."""
    points, believed = side
    if test == "pose":
        if run.points is None or believed is None:
            raise ValueError("a pose test needs points of a tracker, joint angles and the arm.")
        points = run.points  # what was measured is no other after a correction
        if base is not None:
            points = (points - np.asarray(base[1])) @ np.asarray(base[0])
    return Readings(run, rows, points, believed)


def _judged(sets, limit, rule):
    """Fields of a value: numbers and decisions of the worst candidates, before and after.

    There are no sets where the test is a bad one, and one without a correction.
    """
    found: dict[str, Any] = {}
    for side, one in zip(("before", "after"), sets, strict=False):
        errors, sizes, u = (np.asarray(part, dtype=float) for part in one[:3])
        interval = one[3:] or (None,)
        limits = np.zeros(len(errors))  # without any the worst has the largest error
        if limit is not None:
            limits = np.minimum(limit[0] + limit[1] * sizes, limit[2])
        room = limits - np.abs(errors)
        worst = int(np.argmin(room))
        found |= {side: float(errors[worst]), f"u_{side}": float(u[worst])}
        found |= {f"interval_{side}": interval[0], f"size_{side}": float(sizes[worst])}
        if limit is not None:
            # What nobody has stated the uncertainty of proves nothing.
            guard = np.where(u > 0, _GUARD * u, np.inf) if rule == "guarded" else 0 * u
            # Of every single length; the whole is as good as its worst.
            level = np.select([room >= guard, room >= 0, room > -guard], [0, 1, 2], 3)
            found[f"limit_{side}"] = float(limits[worst])
            found[f"decision_{side}"] = _DECISIONS[int(level.max())]
    return found
