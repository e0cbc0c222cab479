"""Bad runs: each gets a finding that says what is wrong, its test no number, the others theirs."""

import re
from dataclasses import replace

import numpy as np
import pytest

from sklearn_raacmm.acceptance import LABELS, AcceptanceRun, evaluate_acceptance
from sklearn_raacmm.datasets import make_acceptance
from sklearn_raacmm.metrics import fit_sphere


def only(run, keep):
    """The run of some rows."""
    columns = {name: getattr(run, name)[keep] for name in (*LABELS, "angles", "points")}
    return replace(run, **columns)


def stated(run, name, **what):
    return run.with_artefacts([replace(a, **what) if a.name == name else a for a in run.artefacts])


@pytest.fixture(scope="module")
def run(data):
    points = data.arm.forward(data.run.angles)
    return replace(data.run, points=points)


def smaller(run, test, times):
    points = np.where((run.test == test)[:, None], run.points / times, run.points)
    return replace(run, points=points)


def without_an_end(run):
    lost = (run.test == "length") & (run.artefact == "bar 600") & (run.position == "3")
    return only(run, ~(lost & (run.repeat == "2") & (run.end == "b")))


def of_another_bar(run):
    other = {"bar 400": "bar 600", "bar 600": "bar 400"}
    pairs = zip(run.test.tolist(), run.artefact.tolist(), strict=True)
    return replace(run, artefact=[other.get(a, a) if t == "length" else a for t, a in pairs])


def after_a_slip(run):
    points = run.points.copy()
    points[np.flatnonzero(run.position == "far")[4]] += [0.6, -0.5, 0.6]
    return replace(run, points=points)


def in_a_plane(run):
    rows = (run.test == "diameter")[:, None]
    return replace(run, points=np.where(rows, run.points * [1, 1, 0], run.points))


# What is done to a run, the code and text of the finding, and how many values are lost.
BAD = [
    (lambda run: only(run, (run.test != "articulation") | (run.articulation != "4")),
     "acceptance-incomplete", r"5 labels are needed .* 1, 2, 3, 5\.", 1),
    (lambda run: only(run, np.arange(len(run.test)) != np.flatnonzero(run.test == "probing")[30]),
     "acceptance-incomplete", "position 2 has 24 readings, 25 are needed", 2),
    (without_an_end, "acceptance-incomplete", "position 3, repeat 2, end b has 0 readings", 1),
    (lambda run: smaller(run, "diameter", 25.4),
     "artefact-unit", r"measures -?\d.* is stated as 25.* the points are in inches", 1),
    (lambda run: smaller(run, "volumetric", 1000),
     "artefact-unit", r"is stated as 500.* the points are in metres", 3),
    (of_another_bar, "artefact-other", "stated as 600.* it has the size of 'bar 400'", 1),
    (lambda run: stated(run, "bar 1000", certificate="", expanded_mm=None),
     "artefact-unknown", "'bar 1000' is not stated: expanded_mm, cert", 2),
    (lambda run: stated(run, "sphere", size_mm=12.5),
     "artefact-unit", "a radius was stated for a diameter", 4),
    (in_a_plane, "acceptance-geometry", "lie in one plane", 1),
    (after_a_slip, "slipped", r"single-point: 1 readings are off by up to 0\.9.*usual", 9),
]  # fmt: skip


@pytest.mark.parametrize(("spoil", "code", "text", "n_lost"), BAD)
def test_a_bad_run_has_a_finding_and_no_number(run, spoil, code, text, n_lost):
    good, bad = evaluate_acceptance(run), evaluate_acceptance(spoil(run))
    assert good.findings == ()
    assert {finding.code for finding in bad.findings} == {code}
    assert {finding.weight for finding in bad.findings} == {"repair"}
    assert any(re.search(text, finding.text) for finding in bad.findings)
    lost = [value.name for value in bad.values if value.before is None]
    assert len(lost) == n_lost
    tests = {finding.text.split(":")[0] for finding in bad.findings}
    for one, other in zip(good.values, bad.values, strict=True):
        expected = None if one.test in tests else pytest.approx(one.before, abs=1e-12)
        assert other.before == expected


def test_a_slip_is_named_by_its_row(run):
    bad = after_a_slip(run)
    (finding,) = evaluate_acceptance(bad).findings
    assert finding.rows == (int(np.flatnonzero(run.position == "far")[4]),)
    assert finding.size_mm == pytest.approx(0.98, abs=0.1)
    # A bar that slipped, and a point of a sphere.
    for test, row in (("volumetric", 7), ("probing", 12)):
        points = run.points.copy()
        at = np.flatnonzero(run.test == test)[row]
        mean = points[run.test == test].mean(axis=0)
        points[at] += 1.5 * (points[at] - mean) / np.linalg.norm(points[at] - mean)
        (finding,) = evaluate_acceptance(replace(run, points=points)).findings
        assert finding.text.startswith(test)


def test_more_readings_than_a_test_has(run):
    twice = np.r_[np.arange(len(run.test)), np.flatnonzero(run.test == "length")[0]]
    (finding,) = evaluate_acceptance(only(run, twice)).findings
    assert "has 2 readings, 1 are needed" in finding.text
    # More poses in a cone and more placements of a bar are as good.
    more = np.r_[np.arange(len(run.test)), np.flatnonzero(run.position == "near")[:2]]
    taken = only(run, more)
    taken.angles[-2:] += 1e-6
    assert evaluate_acceptance(taken).findings == ()


def test_a_ball_that_is_compensated_twice_and_one_that_is_unknown(run):
    (first, *_) = evaluate_acceptance(replace(run, tip_mm=0.0)).findings
    assert "it is another artefact" in first.text
    points = run.points.copy()
    for position in "12":
        own = (run.test == "probing") & (run.position == position)
        centre = fit_sphere(points[own])[0]
        points[own] = centre + (points[own] - centre) * 25 / (25 + 6)
    (found,) = evaluate_acceptance(replace(run, points=points)).findings
    assert "compensated twice" in found.text


@pytest.mark.exhaustive
def test_an_arm_that_is_bad_is_no_bad_run():
    """Neither errors twice as usual nor a nominal table are taken for slips or other artefacts."""
    for seed in range(2):
        bad = make_acceptance(machine="eccentricity", random_state=seed)
        assert evaluate_acceptance(bad.run, bad.arm).findings == ()
        assert evaluate_acceptance(bad.run, bad.arm, found=bad.nominal_arm).findings == ()


def test_rows_of_no_label():
    run = AcceptanceRun(test=["single-point"] * 3, artefact=[""] * 3, points=np.eye(3))
    (finding,) = evaluate_acceptance(run).findings
    assert "3 labels (near, middle, far) are needed in the column position" in finding.text
    assert "without a label" in finding.text


# -- whole runs that are none the less not what the test asks --------------------------------------


def taken_at(run, arm, rows, angles):
    """The run whose readings of some rows were taken at other angles."""
    angles = np.where(rows[:, None], angles, run.angles)
    points = np.where(rows[:, None], arm.forward(angles), run.points)
    return replace(run, angles=angles, points=points)


def near_exactly(angles, of, jitter=1e-6):
    """Angles of some rows again, as encoders read them."""
    return angles[of] + np.random.default_rng(0).normal(0, jitter, (len(of), 6))


def zones_at_one_distance(run, arm):
    angles, middle = run.angles.copy(), np.flatnonzero(run.position == "middle")
    for zone, turn in (("near", 0.5), ("far", -0.5)):  # joint 1 turns, and nothing else
        angles[run.position == zone] = near_exactly(angles, middle) + np.eye(6)[0] * turn
    return taken_at(run, arm, run.test == "single-point", angles)


def zones_exchanged(run, _):
    other = {"near": "far", "far": "near"}
    return replace(run, position=[other.get(name, name) for name in run.position.tolist()])


def two_zones_in_one_cone(run, arm):
    angles, middle = run.angles.copy(), run.position == "middle"
    angles[middle] = near_exactly(angles, np.flatnonzero(run.position == "near"))
    return taken_at(run, arm, middle, angles)


def one_pose(run, arm):
    angles, far = run.angles.copy(), run.position == "far"
    angles[far] = near_exactly(angles, np.repeat(np.flatnonzero(far)[0], 10), 1e-5)
    return taken_at(run, arm, far, angles)


def bar_never_moved(run, arm):
    angles, rows = run.angles.copy(), run.test == "volumetric"
    angles[rows] = near_exactly(angles, np.tile(np.flatnonzero(rows)[:2], 20))
    return taken_at(run, arm, rows, angles)


def copied_repeats(run, arm):
    angles, rows = run.angles.copy(), run.test == "length"
    for repeat in "23":
        angles[rows & (run.repeat == repeat)] = angles[rows & (run.repeat == "1")]
    return taken_at(run, arm, rows, angles)


def bar_off_by_a_tenth(run, _):
    """Twenty placements agree to 5 um, and all are 0.1 mm too long."""
    points, rows = run.points.copy(), np.flatnonzero(run.test == "volumetric")
    size = run.by_name["bar 500"].size_in_test
    errors = 0.1 + np.random.default_rng(0).normal(0, 0.005, 20)
    along = points[rows[1::2]] - points[rows[::2]]
    along *= ((size + errors) / np.linalg.norm(along, axis=1))[:, None]
    points[rows[1::2]] = points[rows[::2]] + along
    return replace(run, points=points)


def empty_cell(run, _):
    points = run.points.copy()
    points[np.flatnonzero(run.position == "far")[3], 2] = 0.0
    return replace(run, points=points)


def bar(**what):
    return lambda run, _: stated(run, "bar 500", **what)


def ball(**what):
    return lambda run, _: stated(run, "sphere", **what)


# What was done, how, and the code of what is found.
NOT_AS_ASKED = [
    ("1.15e-5 under expansion [1e-6/K]", bar(expansion_per_k=1.15e-11), "artefact-implausible"),
    ("11.5 for 11.5e-6 / K", bar(expansion_per_k=11.5), "artefact-implausible"),
    ("71 degrees F for C", bar(temperature_degc=71.0), "artefact-implausible"),
    ("294 K for degrees C", bar(temperature_degc=294.0), "artefact-implausible"),
    ("U in um for mm", bar(expanded_mm=4.0), "artefact-implausible"),
    ("U in mm under U [um]", bar(expanded_mm=4e-6), "artefact-implausible"),
    ("U in nm for mm", ball(expanded_mm=2000.0), "artefact-implausible"),
    ("a form in um for mm", ball(form_mm=2.0), "artefact-implausible"),
    ("an empty form, which is 0.0", ball(form_mm=0.0), "artefact-unknown"),
    ("near and far exchanged", zones_exchanged, "wrong-zones"),
    ("three cones at one distance", zones_at_one_distance, "wrong-zones"),
    ("near and middle in one cone", two_zones_in_one_cone, "one-place"),
    ("ten readings of one pose", one_pose, "one-pose"),
    ("a bar that was never moved", bar_never_moved, "one-place"),
    ("repeats that are copies", copied_repeats, "copied-readings"),
    ("a bar that is 0.1 mm off", bar_off_by_a_tenth, "mean-off"),
    ("an empty cell as 0.0", empty_cell, "slipped"),
]


@pytest.mark.parametrize(
    ("spoil", "code"),
    [one[1:] for one in NOT_AS_ASKED],
    ids=[one[0] for one in NOT_AS_ASKED],
)
def test_a_run_that_is_not_what_the_test_asks_is_named(run, data, spoil, code):
    bad = evaluate_acceptance(spoil(run, data.arm), data.arm)
    assert {finding.code for finding in bad.findings} == {code}
    # What may be the arm's own scale keeps its number.
    assert any(value.before is None for value in bad.values) == (code != "mean-off")


def test_uncertainties_are_judged_by_the_limit(run):
    """A U of 0.2 mm says nothing about a limit of 0.1 mm, and something about one of 0.5 mm."""
    bad = stated(only(run, run.test == "volumetric"), "bar 500", expanded_mm=0.2)
    for limit, codes in ((0.1, ["artefact-implausible"]), (0.5, [])):
        found = evaluate_acceptance(bad, limits={"volumetric largest": limit}).findings
        assert [finding.code for finding in found] == codes


@pytest.mark.parametrize(
    "machine",
    [
        "eccentricity",
        *(pytest.param(m, marks=pytest.mark.exhaustive) for m in ("typical", "gravity")),
    ],
)
def test_clean_runs_have_no_finding(machine):
    tests = ["probing", "articulation", "diameter", "single-point", "volumetric"]
    clean = make_acceptance(tests, machine=machine, random_state=3)
    assert evaluate_acceptance(clean.run, clean.arm).findings == ()
