"""Every value of a run against plain loops over its rows, to 1e-9 mm."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

from sklearn_raacmm.acceptance import LAYOUTS, VALUES, AcceptanceRun, Artefact, evaluate_acceptance

EXACT = {"rtol": 0, "atol": 1e-9}


def sphere_by_newton(points):
    """Centre and radius in extended precision, from the normal equations alone."""
    p = np.asarray(points, dtype=np.longdouble)
    x = np.append(p.mean(axis=0), 10).astype(np.longdouble)
    for _ in range(60):
        away = p - x[:3]
        far = np.sqrt((away**2).sum(axis=1))
        jacobian = np.column_stack([-away / far[:, None], -np.ones(len(p))])
        normal, right = jacobian.T @ jacobian, jacobian.T @ (x[3] - far)
        # One round of refinement makes the solution one of extended precision.
        step = np.linalg.solve(normal.astype(float), right.astype(float))
        left = right - normal @ step.astype(np.longdouble)
        x = x + step + np.linalg.solve(normal.astype(float), left.astype(float))
    return x[:3].astype(float), float(x[3])


def smallest_ball(centres):
    """Of all spheres through two, three or four centres the smallest that holds all of them."""
    best = math.inf
    for size in (2, 3, 4):
        for some in itertools.combinations(centres, size):
            some = np.array(some)
            edges = some[1:] - some[0]
            # The centre is some[0] + w @ edges, as far from all of them.
            gram = edges @ edges.T
            if np.linalg.matrix_rank(gram) < len(gram):
                continue
            middle = some[0] + np.linalg.solve(2 * gram, np.diag(gram)) @ edges
            radius = math.dist(middle, some[0])
            if all(math.dist(middle, c) <= radius + 1e-10 for c in centres):
                best = min(best, radius)
    return best


def by_hand(run, points):
    """All values, by plain loops over dictionaries."""
    rows = [
        (*labels, p)
        for *labels, p in zip(
            run.test, run.artefact, run.position, run.articulation, run.repeat, run.end, points,
            strict=True,
        )
    ]  # fmt: skip
    size = {
        a.name: a.size_mm * (1 + a.expansion_per_k * (a.temperature_degc - 20))
        for a in run.artefacts
        if a.size_mm
    }
    found = {}

    def of(test, **where):
        columns = ("test", "artefact", "position", "articulation", "repeat", "end")
        return np.array([
            row[-1] for row in rows
            if row[0] == test and all(row[columns.index(k)] == v for k, v in where.items())
        ])  # fmt: skip

    errors, forms = [], []
    for position in "12":
        some = of("probing", position=position)
        centre, radius = sphere_by_newton(some)
        errors.append(2 * radius - run.tip_mm - size["sphere"])
        far = [math.dist(centre, p) for p in some]
        forms.append(max(far) - min(far))
    found["P_Size"], found["P_Form"] = max(errors, key=abs), max(forms)
    found["L_Dia"] = max(
        2 * smallest_ball(
            [sphere_by_newton(of("articulation", position=p, articulation=a))[0] for a in "12345"]
        )
        for p in "12"
    )  # fmt: skip
    for test, name, tip in (("length", "E_Uni", 0), ("bidirectional", "E_Bi", run.tip_mm)):
        errors = []
        for bar in (200, 400, 600, 800, 1000):
            for position in "1234567":
                for repeat in "123":
                    where = {"artefact": f"bar {bar}", "position": position, "repeat": repeat}
                    (a,), (b,) = of(test, end="a", **where), of(test, end="b", **where)
                    errors.append(math.dist(a, b) - tip - size[f"bar {bar}"])
        assert len(errors) == 105
        found[name] = max(errors, key=abs)
    errors = [
        2 * sphere_by_newton(of("diameter", repeat=r))[1] - run.tip_mm - size["sphere"]
        for r in "123"
    ]
    found["effective diameter"] = max(errors, key=abs)
    for zone in ("near", "middle", "far"):
        some = of("single-point", position=zone)
        away = [math.dist(p, some.mean(axis=0)) for p in some]
        found[f"2S {zone}"] = 2 * math.sqrt(sum(d * d for d in away) / (len(away) - 1))
        found[f"largest {zone}"] = max(away)
        found[f"half range {zone}"] = max((max(c) - min(c)) / 2 for c in some.T)
    errors = []
    for i in range(20):
        (a,), (b,) = (of("volumetric", position=str(i + 1), end=e) for e in "ab")
        errors.append(math.dist(a, b) - size["bar 500"])
    found["volumetric largest"] = max(map(abs, errors))
    found["volumetric range"] = max(errors) - min(errors)
    found["volumetric 2 rms"] = 2 * math.sqrt(sum(e * e for e in errors) / 20)
    return found


def test_every_value_is_that_of_plain_loops(data, model):
    result = evaluate_acceptance(data.run, data.arm, model)
    before = data.arm.forward(data.run.angles)
    after = before - model.predict(data.run.angles)
    assert result.findings == ()
    assert [v.name for v in result.values] == [n for n in VALUES if n not in ("AP", "RP")]
    for side, points in (("before", before), ("after", after)):
        for name, value in by_hand(data.run, points).items():
            assert_allclose(getattr(result[name], side), value, **EXACT, err_msg=name)


def test_points_of_the_makers_software_serve_as_well(data, model):
    points = data.arm.forward(data.run.angles)
    by_angles = evaluate_acceptance(data.run, data.arm, model)
    by_points = evaluate_acceptance(replace(data.run, points=points), data.arm, model)
    without = evaluate_acceptance(replace(data.run, points=points, angles=None))
    for one, two, three in zip(by_angles.values, by_points.values, without.values, strict=True):
        assert (one.before, one.after) == pytest.approx((two.before, two.after), abs=1e-9)
        assert three.before == pytest.approx(one.before, abs=1e-9)
        assert three.after is None
    with pytest.raises(ValueError, match="needs the joint angles"):
        evaluate_acceptance(replace(data.run, points=points, angles=None), None, model)
    with pytest.raises(ValueError, match="needs the arm"):
        evaluate_acceptance(data.run)


def test_as_found_is_the_arm_that_was_found(data):
    result = evaluate_acceptance(data.run, data.arm, found=data.nominal_arm)
    points = data.nominal_arm.forward(data.run.angles)
    value = by_hand(data.run, points)["volumetric largest"]
    assert_allclose(result["volumetric largest"].before, value, **EXACT)


def test_a_pose_test_by_hand(data):
    rng = np.random.default_rng(0)
    angles = np.repeat(data.run.angles[data.run.test == "length"][:50:10], 30, axis=0)
    position = np.repeat(np.arange(5), 30)
    shift = rng.normal(scale=0.1, size=(5, 3))
    believed = data.arm.forward(angles)
    points = believed + shift[position] + rng.normal(scale=0.02, size=believed.shape)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    seen = points @ turn.T + [100, 200, 300]
    run = AcceptanceRun(
        test=["pose"] * 150, artefact=[""] * 150, position=position, angles=angles, points=seen
    )
    result = evaluate_acceptance(run, data.arm, base=(turn, [100, 200, 300]))
    accuracy, repeatability = [], []
    for i in range(5):
        own = points[position == i]
        accuracy.append(math.dist(own.mean(axis=0), believed[30 * i]))
        far = [math.dist(p, own.mean(axis=0)) for p in own]
        repeatability.append(np.mean(far) + 3 * np.std(far, ddof=1))
    assert_allclose(result["AP"].before, max(accuracy), **EXACT)
    assert_allclose(result["RP"].before, max(repeatability), **EXACT)
    tracker = Artefact(name="", fixture_mm=0.004)
    stated = evaluate_acceptance(run.with_artefacts([tracker]), data.arm)
    assert [stated[name].u_before for name in ("AP", "RP")] == [0.004, 0.004]
    assert result["AP"].u_before == 0.0
    with pytest.raises(ValueError, match="needs points of a tracker"):
        evaluate_acceptance(replace(run, points=None), data.arm)


def test_intervals_are_those_of_chi_squared(data):
    result = evaluate_acceptance(data.run, data.arm)
    points = data.arm.forward(data.run.angles)[data.run.position == "far"]
    values = np.linalg.eigvalsh(np.cov(points.T))
    freedom = 9 * values.sum() ** 2 / np.sum(values**2)
    ends = result["2S far"].before * np.sqrt(freedom / chi2.ppf([0.975, 0.025], freedom))
    assert_allclose(result["2S far"].interval_before, ends, rtol=1e-9)
    value = result["volumetric 2 rms"]
    ends = value.before * np.sqrt(20 / chi2.ppf([0.975, 0.025], 20))
    assert_allclose(value.interval_before, ends, rtol=1e-12)
    assert result["volumetric largest"].interval_before is None


def test_every_value_has_its_source_and_its_test():
    assert {own for own, *_ in VALUES.values()} == set(LAYOUTS)
    assert all(all(parts) for parts in VALUES.values())
    run = AcceptanceRun(test=["length"], artefact=["bar"], points=[[0, 0, 0]])
    result = evaluate_acceptance(run)
    assert result["E_Uni"].standard == "ISO 10360-12:2016"
    assert str(result).endswith("E_Uni: no value")
    with pytest.raises(KeyError, match="P_Size"):
        result["P_Size"]
