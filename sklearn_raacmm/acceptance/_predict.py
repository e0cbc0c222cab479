"""What a model expects of a run that is planned: its values with the errors that it leaves."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import replace
from numbers import Integral
from typing import Any

import numpy as np
from sklearn.utils import check_random_state, check_scalar

from sklearn_raacmm.acceptance._run import AcceptanceRun
from sklearn_raacmm.acceptance._values import BARS, FUNCTIONS, LAYOUTS, SPHERES, Readings
from sklearn_raacmm.metrics import fit_sphere

# Of the interval of 95 %, and the median.
_ENDS = (1 - 0.95) / 2, 0.5, (1 + 0.95) / 2


def predict_acceptance(
    model: Any,
    plan: AcceptanceRun,
    *,
    n_draws: int = 200,
    random_state: int | np.random.RandomState | None = 0,
) -> dict[str, tuple[float, float, float]]:
    """Values that a corrected arm would have in a run, by what its model does not know.

    Parameters
    ----------
    model : Correction or ArmResidualRegressor
        Fitted; it has ``sample_y``. A regressor takes angles in rad.
    plan : AcceptanceRun
        Labels, joint angles near those of the test, and stated artefacts; the run itself will do.
        A pose test is left out: how a robot repeats, the model does not know.
    n_draws : int, default=200
        Number of draws.
    random_state : int, RandomState instance or None, default=0
        Of the draws.

    Returns
    -------
    dict of str to (float, float, float)
        Lower end of 95 %, median and upper end of the absolute value, mm, by the names of the
        values.

    Raises
    ------
    ValueError
        If the plan has no angles, or tests of the plan are not whole.
    TypeError
        If the model has no ``sample_y``.

    Notes
    -----
    Each draw of :meth:`~sklearn_raacmm.ArmResidualRegressor.sample_y` with noise, less the
    correction, is an error of every reading. What is common to a position is common to its rows, so
    that no factor of intervals within positions applies. Of a correction the scale is drawn, too,
    as far as its calibration left it open. The error is added to where the corrected probe would be
    on perfect artefacts, whose sizes are off as it is stated; form and fixture are not drawn.

    Examples
    --------
    >>> from sklearn_raacmm import ArmResidualRegressor
    >>> from sklearn_raacmm.acceptance import predict_acceptance
    >>> from sklearn_raacmm.datasets import make_acceptance, make_single_point
    >>> test = make_single_point(n_positions=6, n_poses=25, random_state=1)  # simulated
    >>> model = ArmResidualRegressor(test.arm, orders=4)
    >>> model = model.fit(test.data, test.target, groups=test.groups)
    >>> plan = make_acceptance(["single-point"], random_state=1).run
    >>> low, middle, high = predict_acceptance(model, plan, n_draws=50)["2S far"]
    >>> 0 < low < middle < high < 0.2
    True
    """
    check_scalar(n_draws, "n_draws", Integral, min_val=2)
    if plan.angles is None:
        raise ValueError("a plan needs joint angles: errors depend on the pose.")
    known = model if hasattr(model, "calibration") else None  # a correction
    regressor = known.model if known else model
    if not hasattr(regressor, "sample_y"):
        raise TypeError(f"{type(regressor).__name__} has no sample_y: it draws no corrections.")
    arm = known.arm if known else regressor.arm_
    X, rng = arm.check_angles(plan.angles, "rad"), check_random_state(random_state)
    mean = regressor.predict(known.inputs(X) if known else X)
    points = arm.forward(X) - mean
    if known:
        draws = points[:, :, None] - known.sample(plan.angles, n_draws, rng, with_noise=True)
    else:
        draws = regressor.sample_y(X, n_draws, rng, with_noise=True) - mean[:, :, None]
    tests = [test for test in LAYOUTS if test != "pose" and test in plan.test]
    rows = {test: np.flatnonzero(plan.test == test) for test in tests}
    ideal = np.zeros_like(points)
    for own in rows.values():
        ideal[own] = _on_artefacts(Readings(plan, own, points))
    found: dict[str, list[float]] = {}
    for k in range(n_draws):
        # Sizes are off by what they are stated to be known to.
        sizes = (a.size_mm and a.size_mm + a.u_size * rng.normal() for a in plan.artefacts)
        pairs = zip(plan.artefacts, sizes, strict=True)
        run = plan.with_artefacts(replace(artefact, size_mm=size) for artefact, size in pairs)
        for test, own in rows.items():
            readings = Readings(run, own, ideal + draws[:, :, k])
            for name, (errors, *_) in FUNCTIONS[test](readings).items():
                found.setdefault(name, []).append(np.abs(errors).max())
    ends = {name: np.quantile(values, _ENDS) for name, values in found.items()}
    return {name: tuple(three.tolist()) for name, three in ends.items()}


def _on_artefacts(readings):
    """Points nearest to these that lie on perfect artefacts, (n, 3), mm."""
    points, tip = readings.points.copy(), readings.tip_mm
    if readings.test in SPHERES:
        for rows in readings.groups("artefact", "position").values():
            centre, _, distances = fit_sphere(points[rows])
            radius = (readings.artefact(rows).size_in_test + tip) / 2
            points[rows] = centre + (points[rows] - centre) * (radius / distances)[:, None]
    elif readings.test in BARS:
        end = np.char.lower(readings.run.end[readings.rows])
        for rows in readings.groups("artefact", "position", "repeat").values():
            a, b = (rows[end[rows] == name] for name in "ab")
            size = readings.artefact(rows).size_in_test + tip
            along = points[b] - points[a]
            long = np.linalg.norm(along, axis=1, keepdims=True)
            points[a] -= (size / long - 1) / 2 * along
            points[b] += (size / long - 1) / 2 * along
    else:
        for rows in readings.groups("position").values():
            points[rows] = points[rows].mean(axis=0)
    return points
