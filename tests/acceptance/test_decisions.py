"""Uncertainties of the tester and decisions, against hand numbers."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from sklearn_raacmm.acceptance import AcceptanceRun, Artefact, evaluate_acceptance
from sklearn_raacmm.acceptance._run import FORM_IN_DIAMETER, FORM_IN_LOCATION
from sklearn_raacmm.metrics import articulated_location_error, fit_sphere

BAR = Artefact(
    name="bar", size_mm=1000.0, expanded_mm=0.004, expansion_per_k=11.5e-6,
    u_expansion_per_k=1e-6, temperature_degc=24.0, u_temperature_k=0.5, fixture_mm=0.003,
    certificate="1",
)  # fmt: skip
# Nothing but U = 20 um.
EXACT = replace(BAR, expanded_mm=0.02, expansion_per_k=0.0, u_expansion_per_k=0.0, fixture_mm=0.0)


def bars(errors, artefact=BAR):
    """Twenty placements whose lengths are off by these, mm."""
    errors = np.broadcast_to(errors, 20)
    points = np.zeros((40, 3))
    points[1::2, 0] = artefact.size_in_test + errors
    points[:, 1] = 50.0 * np.repeat(np.arange(20), 2)  # the bar is moved in between
    position = np.repeat(np.arange(20), 2)
    return AcceptanceRun(
        test=["volumetric"] * 40, artefact=["bar"] * 40, position=position, end=["a", "b"] * 20,
        points=points, artefacts=[artefact],
    )  # fmt: skip


def test_a_size_is_that_of_the_test_and_so_is_its_uncertainty():
    # 4 K times 11.5e-6 of 1 m; U / 2, 4 K times 1e-6 of 1 m, and 0.5 K times 11.5e-6 of 1 m.
    assert BAR.size_in_test == pytest.approx(1000.046, abs=1e-12)
    assert BAR.u_size == pytest.approx(np.sqrt(0.002**2 + 0.004**2 + 0.00575**2), rel=1e-12)
    at_20 = replace(BAR, temperature_degc=20.0, u_temperature_k=0.0)
    assert (at_20.size_in_test, at_20.u_size) == (1000.0, pytest.approx(0.002))
    assert at_20.missing == ()
    assert replace(BAR, certificate="", expanded_mm=None).missing == ("expanded_mm", "certificate")


def test_the_uncertainty_of_lengths_and_of_what_is_made_of_them():
    errors = np.linspace(-0.03, 0.05, 20)
    result = evaluate_acceptance(bars(errors))
    one = np.hypot(BAR.u_size, 0.003)
    largest, spread, rms = (result[f"volumetric {n}"] for n in ("largest", "range", "2 rms"))
    assert largest.before == pytest.approx(0.05)
    assert largest.u_before == pytest.approx(one)
    # A difference of two lengths of one bar: two fixtures.
    assert spread.before == pytest.approx(0.08)
    assert spread.u_before == pytest.approx(np.sqrt(2) * 0.003)
    # 2 rms by differences: of the bar, and of each placement by itself.
    value = 2 * np.sqrt(np.mean(errors**2))
    step = 1e-7
    common = (2 * np.sqrt(np.mean((errors + step) ** 2)) - value) / step * BAR.u_size
    own = [
        (2 * np.sqrt(np.mean((errors + step * unit) ** 2)) - value) / step * 0.003
        for unit in np.eye(20)
    ]
    assert rms.before == pytest.approx(value)
    assert rms.u_before == pytest.approx(np.hypot(common, np.linalg.norm(own)), rel=1e-4)


@pytest.mark.parametrize(
    ("error", "guarded", "simple"),
    [
        # u = 10 um: guard 16.45 um about a limit of 100 um.
        (0.0835, "pass", "pass"),
        (-0.0835, "pass", "pass"),
        (0.0836, "conditional pass", "pass"),
        (0.0999, "conditional pass", "pass"),
        (0.1001, "conditional fail", "fail"),
        (-0.1164, "conditional fail", "fail"),
        (0.1165, "fail", "fail"),
    ],
)
def test_decisions_by_hand(error, guarded, simple):
    run, limits = bars(error, EXACT), {"volumetric largest": 0.1}
    for rule, decision in (("guarded", guarded), ("simple", simple)):
        value = evaluate_acceptance(run, limits=limits, rule=rule)["volumetric largest"]
        assert value.u_before == pytest.approx(0.01)
        assert value.decision_before == decision
        assert value.limit_before == 0.1


def test_what_is_not_stated_proves_nothing():
    points = np.random.default_rng(0).normal(scale=0.01, size=(30, 3))
    points += np.repeat([300.0, 600.0, 900.0], 10)[:, None]
    run = AcceptanceRun(
        test=["single-point"] * 30, artefact=["seat"] * 30, points=points,
        position=np.repeat(["near", "middle", "far"], 10),
    )  # fmt: skip
    limits = {"2S far": 0.1, "2S near": 0.01}
    for rule, decisions in (
        ("guarded", ("conditional pass", "conditional fail")),
        ("simple", ("pass", "fail")),
    ):
        result = evaluate_acceptance(run, limits=limits, rule=rule)
        assert tuple(result[name].decision_before for name in limits) == decisions
    assert "um (U not stated) fail" in str(result)
    stated = run.with_artefacts([Artefact(name="seat", fixture_mm=0.001)])
    result = evaluate_acceptance(stated, limits=limits)
    assert [result[name].decision_before for name in limits] == ["pass", "fail"]
    assert result["2S far"].u_before == 0.001


def lengths_run(errors):
    """105 lengths of 100 to 500 mm with these errors (5,) of all that are of one bar."""
    artefacts, rows = [], []
    for i, error in enumerate(errors):
        size, name = 100.0 * (i + 1), f"{100 * (i + 1)}"
        artefacts.append(replace(EXACT, name=name, size_mm=size, expanded_mm=2e-5))
        for position, repeat in itertools.product(range(7), range(3)):
            for end, along in (("a", 0), ("b", size + error)):
                rows.append((name, position, repeat, end, [i + 0.1 * repeat, along, 50 * position]))
    columns = ("artefact", "position", "repeat", "end", "points")
    given = dict(zip(columns, zip(*rows, strict=True), strict=True))
    return AcceptanceRun(test=["length"] * 210, artefacts=artefacts, **given)


def test_every_single_length_has_its_own_limit():
    # A + L / K = 20 um + L / 10 at most 60 um: 30, 40, 50, 60, 60 um.
    limits = {"E_Uni": (0.02, 1e-4, 0.06)}
    run = lengths_run([0.029, 0.031, -0.031, 0.031, 0.055])
    value = evaluate_acceptance(run, limits=limits)["E_Uni"]
    # The least room is at 100 mm, though the largest error is at 500 mm.
    assert (value.before, value.size_before) == pytest.approx((0.029, 100.0))
    assert value.limit_before == pytest.approx(0.03)
    assert value.decision_before == "pass"
    value = evaluate_acceptance(lengths_run([0.031, 0, 0, 0, 0.055]), limits=limits)["E_Uni"]
    assert (value.before, value.decision_before) == (pytest.approx(0.031), "fail")
    value = evaluate_acceptance(lengths_run([0, 0, 0, 0, 0.061]), limits=limits)["E_Uni"]
    assert (value.limit_before, value.decision_before) == (pytest.approx(0.06), "fail")
    # Without a limit it is the largest one.
    assert evaluate_acceptance(run)["E_Uni"].before == pytest.approx(0.055)


def test_how_far_an_oval_sphere_moves_a_diameter_and_a_location():
    """Root mean squares over oval spheres of random axes, form 1, as fixed numbers have them."""
    rng = np.random.default_rng(0)
    diameters, locations = [], []
    for _ in range(300):
        root = rng.normal(size=(3, 3))
        form = root + root.T - np.eye(3) * 2 * np.trace(root) / 3
        form /= np.ptp(np.linalg.eigvalsh(form))

        def on(out, form=form):
            return (1e4 + np.sum(out @ form * out, axis=1))[:, None] * out

        diameters += [2 * (fit_sphere(on(half_sphere(n, 0.0)))[1] - 1e4) for n in (9, 25)]
        centres = [fit_sphere(on(half_sphere(5, turn)))[0] for turn in rng.uniform(0, 6.28, 5)]
        locations.append(articulated_location_error(centres))
    assert np.sqrt(np.mean(np.square(diameters))) == pytest.approx(FORM_IN_DIAMETER, rel=0.1)
    assert np.sqrt(np.mean(np.square(locations))) == pytest.approx(FORM_IN_LOCATION, rel=0.15)


def half_sphere(n, turn):
    """Directions spread over the upper half: Fibonacci's lattice."""
    z = 1 - (np.arange(n) + 0.5) / n
    angle = np.pi * (1 + np.sqrt(5)) * (np.arange(n) + 0.5) + turn
    return np.column_stack(
        [np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z]
    )
