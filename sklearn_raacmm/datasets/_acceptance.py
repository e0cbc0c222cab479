"""Simulated runs of acceptance tests; public in `sklearn_raacmm.datasets`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from sklearn.utils import Bunch

from sklearn_raacmm.acceptance import LABELS, AcceptanceRun, Artefact
from sklearn_raacmm.datasets._arm_errors import ArmErrors
from sklearn_raacmm.datasets._generators import (
    calibrated_arm,
    draw_cones,
    draw_gauges,
    machine_and_stream,
    take_readings,
)
from sklearn_raacmm.datasets._simulation import SimulatedArm, directions_at

_TESTS = ("probing", "articulation", "length", "diameter", "single-point", "volumetric")
_LENGTHS = (200.0, 400.0, 600.0, 800.0, 1000.0)
_TIP_MM = 6.0
# Places, articulations or repeats, and points of each.
_OF_SPHERES = {"probing": (2, 1, 25), "articulation": (2, 5, 5), "diameter": (1, 3, 9)}
# A room, a steel bar and a ceramic sphere, with certificates and uncertainties as these are usual.
_ROOM = {
    "expansion_per_k": 11.5e-6,
    "temperature_degc": 21.0,
    "fixture_mm": 0.001,
}
_BAR = {"expanded_mm": 0.004, **_ROOM}
_SPHERE = {"size_mm": 25.0, "expanded_mm": 0.002, "form_mm": 0.002, **_ROOM}
_GOLDEN_ANGLE = np.pi * (1 + np.sqrt(5))


def make_acceptance(
    tests: Sequence[str] = _TESTS,
    *,
    machine: SimulatedArm | ArmErrors | str = "typical",
    exact: bool = False,
    random_state: int | np.random.RandomState | None = 0,
) -> Any:
    """Simulate a run of acceptance tests with one arm and artefacts that have errors.

    Parameters
    ----------
    tests : sequence of str
        Of "probing", "articulation", "length", "bidirectional", "diameter", "single-point" and
        "volumetric", see :func:`~sklearn_raacmm.acceptance.evaluate_acceptance`; by default all but
        "bidirectional".
    machine, random_state
        As in :func:`make_single_point`; with the same int the individual is the same.
    exact : bool, default=False
        Whether artefacts are as they are stated. Places, poses and noise stay what they are.

    Returns
    -------
    data : :class:`~sklearn.utils.Bunch`
        ``run`` (AcceptanceRun of joint angles), ``arm`` (calibrated), ``nominal_arm``, and
        ``simulation`` with ``machine`` and ``true_points``, mm.

    Raises
    ------
    ValueError
        If a test or the machine is unknown.

    Notes
    -----
    True sizes, expansions, temperatures and fixtures are drawn as the standard uncertainties of
    the artefacts say, oval spheres (harmonics of the second order) with the form that is stated.
    Points of spheres are on the upper half. What a seat scatters stands for probing, too.

    Examples
    --------
    >>> from sklearn_raacmm.datasets import make_acceptance
    >>> data = make_acceptance(["probing"])
    >>> data.run.angles.shape, [artefact.name for artefact in data.run.artefacts]
    ((50, 6), ['sphere'])
    """
    unknown = sorted(set(tests) - {*_TESTS, "bidirectional"})
    if unknown or not tests:
        what = repr(unknown[0]) if unknown else "none"
        raise ValueError(f"tests names {what}; known are {', '.join(_TESTS)}, bidirectional.")
    simulated, rng = machine_and_stream(machine, random_state, stream=3)
    own = np.random.RandomState(rng.randint(2**31 - 1))
    drawn = _Drawn(simulated, rng, own, 0.0 if exact else 1.0)
    for test in tests:
        draw = drawn.sphere if test in _OF_SPHERES else drawn.bars
        (drawn.cones if test == "single-point" else draw)(test)
    labels, points, near = zip(*drawn.rows, strict=True)
    poses, warming = [pose[None] for pose in near], simulated.errors.warming_k
    angles, _, true_points = take_readings(simulated, np.array(points), poses, rng, warming)
    columns = dict(zip(LABELS, zip(*labels, strict=True), strict=True))
    stated = tuple(drawn.artefacts.values())
    return Bunch(
        run=AcceptanceRun(**columns, angles=angles, artefacts=stated, tip_mm=_TIP_MM),
        arm=calibrated_arm(simulated),
        nominal_arm=simulated.nominal_arm,
        simulation=Bunch(machine=simulated, true_points=true_points),
    )


class _Drawn:
    """Rows of a run as they are drawn: labels, where the probe is, and a pose near that."""

    def __init__(self, machine, rng, own, error):
        self.machine, self.rng, self.own, self.error = machine, rng, own, error
        self.rows, self.artefacts, self.true_sizes = [], {}, {}

    def _true_size(self, artefact):
        """The size that an artefact has during the test; what is stated is off by its errors."""
        if artefact.name not in self.artefacts:
            self.artefacts[artefact.name] = artefact
            size, factor, degc = self.error * self.own.normal(size=3)
            there = replace(
                artefact,
                size_mm=artefact.size_mm + size * artefact.expanded_mm / 2,
                expansion_per_k=artefact.expansion_per_k + factor * artefact.u_expansion_per_k,
                temperature_degc=artefact.temperature_degc + degc * artefact.u_temperature_k,
            )
            self.true_sizes[artefact.name] = there.size_in_test
        return self.true_sizes[artefact.name]

    def cones(self, test):
        """Ten poses in a seat near, in the middle and far."""
        self.artefacts["seat"] = Artefact(name="seat", fixture_mm=_ROOM["fixture_mm"])
        places, poses = draw_cones(self.machine, 3, 10, self.rng)
        for zone, place, own in zip(("near", "middle", "far"), places, poses, strict=True):
            for pose in own:
                self.rows.append(((test, "seat", zone, "", "", ""), place, pose))

    def sphere(self, test):
        """Points on the upper half: of a position, of each articulation, or of each repeat."""
        n_places, n_times, n = _OF_SPHERES[test]
        artefact = Artefact(name="sphere", serial="S1", certificate="simulated", **_SPHERE)
        radius = (self._true_size(artefact) + _TIP_MM) / 2
        # The form: n' A n with the largest less the smallest eigenvalue as stated, of mean 0.
        root = self.own.normal(size=(3, 3))
        form = root + root.T - np.eye(3) * 2 * np.trace(root) / 3
        form *= self.error * artefact.form_mm / np.ptp(np.linalg.eigvalsh(form))
        places, poses = draw_cones(self.machine, n_places, n_times * n, self.rng)
        for i, place in enumerate(places):
            # Poses come sorted by the swing of the elbow: an articulation is n of one side.
            for k in range(n_times):
                where = (str(k + 1), "") if test == "articulation" else ("", str(k + 1))
                shift = self.error * artefact.fixture_mm / 2 * self.own.normal(size=3)
                shift *= test == "articulation"
                height = 1 - (np.arange(n) + 0.5) / n  # evenly over the upper half
                turn = _GOLDEN_ANGLE * n * (1 - height) + self.rng.uniform(0, 2 * np.pi)
                for j, out in enumerate(directions_at(height, turn)):
                    at = place + shift + (radius + out @ form @ out) * out
                    labels = (test, artefact.name, str(i + 1), *where, "")
                    self.rows.append((labels, at, poses[i][k * n + j]))

    def bars(self, test):
        """Ends of bars: five lengths in seven positions thrice, or one bar in twenty once."""
        volumetric = test == "volumetric"
        sizes, n_times = ([500.0] * 20, 1) if volumetric else (np.repeat(_LENGTHS, 7), 3)
        ends, poses = draw_gauges(self.machine, sizes, n_times, self.rng)
        for i, size in enumerate(sizes):
            name = f"bar {size:.0f}"
            bar = Artefact(name=name, serial=name, certificate="simulated", size_mm=size, **_BAR)
            long = self._true_size(bar) + self.error * bar.fixture_mm * self.own.normal()
            long += _TIP_MM * (test == "bidirectional")
            pair = ends[2 * i : 2 * i + 2]
            half = (long / size - 1) / 2 * (pair[1] - pair[0])
            position = str(i + 1 if volumetric else i % 7 + 1)
            for k in range(n_times):
                for end in (0, 1):
                    labels = (test, name, position, "", str(k + 1), "ab"[end])
                    at = pair[end] + (2 * end - 1) * half
                    self.rows.append((labels, at, poses[2 * i + end][k]))
