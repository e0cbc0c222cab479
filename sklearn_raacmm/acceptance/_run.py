"""Readings of an acceptance test, and the artefacts that they were taken on."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sklearn_raacmm.utils import floats

# Lengths are calibrated for this temperature (ISO 1).
REFERENCE_DEGC = 20.0
LABELS = ("test", "artefact", "position", "articulation", "repeat", "end")
# The diameter of a sphere that is fitted on half of it moves by so much of the sphere's form, the
# sphere round five centres by so much: root mean squares over oval spheres (harmonics of the second
# order, by simulation 0.43 to 0.48, and 0.92 for five points without symmetry; a pole and four
# points round it move no centre). Those of higher orders move both by less.
FORM_IN_DIAMETER, FORM_IN_LOCATION = 0.46, 0.92
_MM = ("size_mm", "expanded_mm", "form_mm", "fixture_mm")
_MAY_BE_MISSING = ("size_mm", "expanded_mm", "expansion_per_k", "temperature_degc")


@dataclass(frozen=True, kw_only=True)
class Artefact:
    """A sphere, a bar or a gauge block, as its certificate and the tester describe it.

    Parameters
    ----------
    name : str
        As the readings name it.
    size_mm : float or None, default=None
        Calibrated diameter or length at 20 degC; None where there is no certificate.
    expanded_mm : float or None, default=None
        Expanded uncertainty U of the size as certificates state it, k = 2.
    form_mm : float, default=0.0
        Form deviation of a sphere, the largest radius less the smallest.
    expansion_per_k : float or None, default=None
        Coefficient of thermal expansion, 1/K; 11.5e-6 for steel.
    u_expansion_per_k : float, default=1e-6
        Standard uncertainty of it.
    temperature_degc : float or None, default=None
        Temperature during the test.
    u_temperature_k : float, default=0.3
        Standard uncertainty of it.
    fixture_mm : float, default=0.0
        Standard uncertainty of a length or a place by how the artefact is held; in a pose test
        that of the tracker's points.
    serial, certificate : str, default=""
        Numbers, for the sheet. Without a certificate nothing is judged by the artefact.

    Raises
    ------
    ValueError
        If a number is not finite, or negative.

    Examples
    --------
    >>> from sklearn_raacmm.acceptance import Artefact
    >>> bar = Artefact(name="bar", size_mm=500, expanded_mm=0.002, expansion_per_k=11.5e-6,
    ...                temperature_degc=22, certificate="17")
    >>> round(bar.size_in_test, 4)
    500.0115
    """

    name: str
    size_mm: float | None = None
    expanded_mm: float | None = None
    form_mm: float = 0.0
    expansion_per_k: float | None = None
    u_expansion_per_k: float = 1e-6
    temperature_degc: float | None = None
    u_temperature_k: float = 0.3
    fixture_mm: float = 0.0
    serial: str = ""
    certificate: str = ""

    def __post_init__(self) -> None:
        for name in (*_MM, *_MAY_BE_MISSING, "u_expansion_per_k", "u_temperature_k"):
            value = getattr(self, name)
            # Some materials shrink, and some rooms are cold.
            least = -np.inf if name in ("expansion_per_k", "temperature_degc") else 0.0
            missing = value is None and name in _MAY_BE_MISSING
            number = floats(name, 0.0 if missing else value)
            if number.shape or not np.isfinite(number) or number < least:
                what = "number" if least else "number of 0 or more"
                raise ValueError(f"artefact {self.name!r}: {name} must be a {what}, got {value!r}.")
        if self.size_mm == 0:
            raise ValueError(f"artefact {self.name!r}: size_mm must be positive, got 0.")

    @property
    def missing(self) -> tuple[str, ...]:
        """What a value needs and nobody has stated."""
        names = (*_MAY_BE_MISSING, "certificate")
        return tuple(name for name in names if getattr(self, name) in (None, ""))

    @property
    def size_in_test(self) -> float:
        """Size at the temperature of the test, mm."""
        factor, warming = self._expansion
        return float((self.size_mm or 0.0) * (1 + factor * warming))

    @property
    def u_size(self) -> float:
        """Standard uncertainty of the size in the test, mm: certificate, expansion, temperature."""
        factor, warming = self._expansion
        per_size = np.hypot(warming * self.u_expansion_per_k, factor * self.u_temperature_k)
        return float(np.hypot((self.expanded_mm or 0.0) / 2, (self.size_mm or 0.0) * per_size))

    @property
    def _expansion(self) -> tuple[float, float]:
        degc = self.temperature_degc
        return self.expansion_per_k or 0.0, 0.0 if degc is None else degc - REFERENCE_DEGC


@dataclass(frozen=True, eq=False, kw_only=True)
class AcceptanceRun:
    """Readings of acceptance tests, one a row, with what they were taken on.

    Parameters
    ----------
    test : array-like of shape (n_rows,)
        "probing", "articulation", "length", "bidirectional", "diameter", "single-point",
        "volumetric" or "pose", see :func:`evaluate_acceptance`.
    artefact : array-like of shape (n_rows,)
        Name of the artefact, one of `artefacts`; a single-point or pose test does without one.
    position, articulation, repeat, end : array-like of shape (n_rows,), default=None
        Labels, as far as the test has them; ends of a length are "a" and "b".
    angles : array-like of shape (n_rows, n_joints), default=None
        Joint angles, rad.
    points : array-like of shape (n_rows, 3), default=None
        Points that the maker's software shows, mm; in a pose test those that a tracker measured.
    artefacts : iterable of Artefact, default=()
        What was measured.
    tip_mm : float, default=0.0
        Diameter of the probe's ball; 0 where points are compensated for it.

    Raises
    ------
    ValueError
        If numbers of rows differ, or neither angles nor points are given.

    Examples
    --------
    >>> from sklearn_raacmm.acceptance import AcceptanceRun
    >>> run = AcceptanceRun(test=["pose"], artefact=[""], points=[[0.0, 0.0, 0.0]])
    >>> len(run.test), run.position.tolist()
    (1, [''])
    """

    test: Any
    artefact: Any
    position: Any = None
    articulation: Any = None
    repeat: Any = None
    end: Any = None
    angles: Any = None
    points: Any = None
    artefacts: Iterable[Artefact] = ()
    tip_mm: float = 0.0
    by_name: Mapping[str, Artefact] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        n = np.size(self.test)
        for name in LABELS:
            given = [""] * n if getattr(self, name) is None else map(str, getattr(self, name))
            self._set(name, np.array(list(given), dtype=str))
        if self.angles is None and self.points is None:
            raise ValueError("a run needs angles or points, and has neither.")
        for name, width in (("angles", -1), ("points", 3)):
            if getattr(self, name) is not None:
                self._set(name, floats(name, getattr(self, name), width, finite=True))
        for name in (*LABELS, "angles", "points"):
            values = getattr(self, name)
            if values is not None and len(values) != n:
                raise ValueError(f"{name} has {len(values)} rows, test has {n}.")
        if not (np.isfinite(self.tip_mm) and self.tip_mm >= 0):
            raise ValueError(f"tip_mm must be a diameter of 0 or more, got {self.tip_mm!r}.")
        self._set("artefacts", tuple(self.artefacts))
        self._set("by_name", {artefact.name: artefact for artefact in self.artefacts})

    def _set(self, name, value):
        object.__setattr__(self, name, value)

    def with_artefacts(self, artefacts: Iterable[Artefact]) -> "AcceptanceRun":
        """The same readings with other artefacts, as where certificates come later."""
        return replace(self, artefacts=tuple(artefacts))
