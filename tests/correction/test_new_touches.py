"""Touches of balls and plates update, check and register a correction, against whole matrices."""

from copy import copy

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import (
    ArmResidualRegressor,
    Measurements,
    check_correction,
    learn_correction,
    position_residuals,
    update_correction,
)
from sklearn_raacmm.datasets import SimulatedArm, make_features, make_single_point
from sklearn_raacmm.metrics import fit_sphere
from sklearn_raacmm.utils import Finding

MACHINE = SimulatedArm("eccentricity", random_state=1)
ARCSEC = np.pi / 180 / 3600
# Of unknowns of a feature that may be anything, mm and rad: with 1000 the explicit inverse below
# was rounding from the third digit on. And by how much positions may be off, mm.
WIDE, PLACE = 10.0, 5.0


@pytest.fixture(scope="module")
def model():
    test = make_single_point(6, 15, machine=MACHINE, random_state=1)
    model = ArmResidualRegressor(test.arm, orders=2)
    return model.fit(test.data, test.target, groups=test.groups)


@pytest.fixture(scope="module")
def touched():
    return make_features(3, 3, 1, 16, machine=MACHINE, random_state=1)


def shown(model, test, angles, features=None):
    """What an update and a check are given: residuals, and what was touched."""
    features = test.features if features is None else features
    points = model.arm_.forward(angles)
    y = position_residuals(points, test.groups, features=features)
    return {"X": angles, "y": y, "groups": test.groups, "features": features}


def block_rows(model, test, angles):
    """Per touch what is left (m,), its direction (m, 3), and columns of all unknowns (m, u).

    And for known sizes, which are rows of unknowns alone: what is left, and columns.
    """
    arm = model.arm_
    points = arm.forward(angles) - model.linear_model_.predict(angles)[0]
    kinds = {label: (kind, *of) for label, kind, *of in test.features}
    left, along, parts, sizes = [], [], [], []
    for label in np.unique(test.groups).tolist():
        own = points[test.groups == label]
        kind, *size = kinds.get(label, ("cone",))
        if kind == "cone":
            away = own - own.mean(axis=0)
            left.append(away.ravel())
            along.append(np.tile(np.eye(3), (len(own), 1)))
            parts.append(along[-1])
            continue
        if kind == "sphere":
            centre, radius, distance = fit_sphere(own)
            normal = (own - centre) / np.linalg.norm(own - centre, axis=1)[:, None]
            distance = np.linalg.norm(own - centre, axis=1) - radius
            parts.append(np.column_stack([normal, np.full(len(own), 0.5)]))
            sizes.append((len(parts) - 1, size[0] - 2 * radius, size[1]))
        else:
            away = own - own.mean(axis=0)
            axes = np.linalg.svd(away)[2]
            normal, distance = np.tile(axes[2], (len(own), 1)), away @ axes[2]
            parts.append(np.column_stack([np.ones(len(own)), away @ axes[:2].T]))
        left.append(distance)
        along.append(normal)
    first = np.cumsum([0, *(part.shape[1] for part in parts)])
    unknowns = np.zeros((sum(map(len, parts)), first[-1]))
    row = 0
    for part, start in zip(parts, first, strict=False):
        unknowns[row : row + len(part), start : start + part.shape[1]] = part
        row += len(part)
    of_sizes = np.zeros((len(sizes), first[-1]))
    for i, (k, *_) in enumerate(sizes):
        of_sizes[i, first[k] + 3] = 1.0
    stated = np.array([one[1:] for one in sizes])
    return np.concatenate(left), np.concatenate(along), unknowns, stated, of_sizes


def whole(model, test, angles):
    """Rows of touches and sizes: what is left, columns of the model, unknowns, covariance."""
    linear = model.linear_model_
    left, along, unknowns, stated, of_sizes = block_rows(model, test, angles)
    n_shown = np.where(np.isin(test.groups, [one[0] for one in test.features]), 1, 3)
    order = np.argsort(test.groups, kind="stable")
    row = np.repeat(order, n_shown[order])

    def seen(columns):  # (n, 3, k) along what is touched; sizes are none of the arm's
        shown = np.einsum("mc,mck->mk", along, columns[row])
        return np.vstack([shown, np.zeros((len(stated), columns.shape[2]))])

    C = np.diag(np.r_[np.full(len(row), linear.noise_variance), np.square(stated[:, 1])])
    return np.r_[left, stated[:, 0]], seen, np.vstack([unknowns, of_sizes]), C


def test_an_update_is_that_of_the_joint_normal_distribution(model, touched):
    """Of coefficients and of all that is unknown of what was touched, nothing projected out."""
    angles = touched.data + 60 * ARCSEC * np.eye(6)[3]
    updated = update_correction(model, **shown(model, touched, angles))
    old, new, (entry,) = model.linear_model_, updated.linear_model_, updated.updates_
    assert list(entry["tau"]) == ["offset of joint 4"]
    y, seen, unknowns, C = whole(model, touched, angles)
    assert len(y) > len(angles)
    C *= entry["noise_sd_mm"] ** 2 / old.noise_variance
    change = np.zeros(len(old.coef))
    at = old.layout.n_waves + old.layout.names.index("theta_offset4")
    change[at] = 100 * entry["tau"]["offset of joint 4"]
    P = old.half @ old.half.T + np.diag(np.square(change))
    A = seen(old.columns(angles))
    S = A @ P @ A.T + WIDE**2 * unknowns @ unknowns.T + C
    step = P @ A.T @ np.linalg.solve(S, y)
    far = make_single_point(3, 10, machine=MACHINE, random_state=5).data
    found = new.predict(far)[0] - old.predict(far)[0]
    assert np.abs(found).max() > 0.03
    # Forms are about touches of other weights: they differ in the second order.
    assert_allclose(found, old.columns(far) @ step, atol=5e-3 * np.abs(found).max())


def test_a_check_is_that_of_the_whole_covariance(model, touched, monkeypatch):
    monkeypatch.setattr("sklearn_raacmm.correction._rows._USUAL", 1 - 1e-12)
    for knock, holds in ((0, True), (60, False)):
        angles = touched.data + knock * ARCSEC * np.eye(6)[3]
        check = check_correction(model, **shown(model, touched, angles))
        assert check.holds == holds
        assert not check.slipped
        y, seen, unknowns, C = whole(model, touched, angles)
        # As the model in use is widened, and of what it leaves unfaded.
        linear = model.linear_model_
        share = model.predict(angles) - linear.predict(angles)[0]
        y -= seen(share[:, :, None])[:, 0]
        n_sizes = sum(len(one) > 2 for one in touched.features)
        C[:-n_sizes, :-n_sizes] *= max(linear.noise_scale, 1.0) ** 2
        A = max(linear.std_scale, 1.0) * seen(linear.columns(angles)) @ linear.half
        inverse = np.linalg.inv(A @ A.T + WIDE**2 * unknowns @ unknowns.T + C)
        tests = {row["cause"]: row for row in check.tests}
        assert tests["noise"]["freedom"] == len(y) - unknowns.shape[1]
        assert tests["noise"]["statistic"] == pytest.approx(y @ inverse @ y, rel=1e-3)
        column = seen(linear.arm.jacobian(angles)[:, :, [3]])[:, 0]
        expected = np.abs(column @ inverse @ y) / np.sqrt(column @ inverse @ column)
        found = np.sqrt(tests["offset of joint 4"]["statistic"])
        assert found == pytest.approx(expected, rel=0.01, abs=0.1)
    assert check.suspect == "offset of joint 4"


def changed(**fields):
    """The same machine with other fields of its true arm, and of the nominal one."""
    other = copy(MACHINE)
    other.true_arm = MACHINE.true_arm.replace(**fields)
    other.nominal_arm = (
        MACHINE.nominal_arm.replace(**fields) if "probe" in fields else MACHINE.nominal_arm
    )
    return other


def test_known_sizes_show_the_scale():
    """An arm half a part in a thousand longer, which cones and balls of any size do not show."""
    arm = MACHINE.true_arm
    longer = changed(a=arm.a * 1.0005, d=arm.d * 1.0005, probe=arm.probe * 1.0005)
    longer.nominal_arm = MACHINE.nominal_arm
    known = make_single_point(6, 15, bars=[500.0, 800.0], machine=MACHINE, random_state=1)
    model = ArmResidualRegressor(known.arm, orders=2)
    model.fit(known.data, known.target, groups=known.groups, lengths=known.lengths)
    test = make_features(4, 0, 1, 20, size=200.0, machine=longer, random_state=2)
    kinds = [entry[:2] for entry in test.features]
    known, open_sizes = (
        check_correction(model, **shown(model, test, test.data, of))
        for of in (test.features, kinds)
    )
    assert known.suspect == "scale"
    assert open_sizes.holds


@pytest.fixture(scope="module")
def learned():
    test = make_single_point(6, 15, machine=MACHINE, random_state=1)
    model = ArmResidualRegressor(orders=2)
    return learn_correction(test.nominal_arm, test.data, test.groups, model=model, cv=2)


def test_a_new_probe_is_registered_by_touches(learned):
    """Longer by 40 mm, with a ball of 6 mm; as near to it as cones bring it."""
    more = np.array([0.0, 0.0, 40.0])
    other = changed(probe=MACHINE.true_arm.probe + more)
    test = make_features(3, 2, 1, 15, tip_diameter=6.0, machine=other, random_state=3)
    given = {"features": test.features, "tip_diameter": 6.0}
    found = learned.register(test.data, test.groups, **given)
    cones = make_single_point(4, 15, machine=other, random_state=4)
    by_cones = learned.register(cones.data, cones.groups)
    assert np.linalg.norm(found.arm.probe - by_cones.arm.probe) < 0.1
    assert np.linalg.norm(found.arm.probe - learned.arm.probe - more) < 0.1
    measured = Measurements.of(test.data, test.groups, **given)
    assert_allclose(learned.register(measured).arm.probe, found.arm.probe, atol=1e-9)
    assert found.check(measured).holds


def test_a_registration_keeps_the_probe_that_few_poses_do_not_show_to_be_another(learned):
    """Of ten poses in two cones: the old one is better than what they find, another is found."""
    with Finding.collected() as found:
        same = make_single_point(2, 5, machine=MACHINE, random_state=5)
        kept = learned.register(same.data, same.groups)
    assert [finding.code for finding in found] == ["same-probe"]
    assert kept.arm == learned.arm
    more = np.array([0.3, 0.0, 0.0])
    other = changed(probe=MACHINE.true_arm.probe + more)
    test = make_single_point(2, 5, machine=other, random_state=5)
    moved = learned.register(test.data, test.groups)
    assert_allclose(moved.arm.probe, learned.arm.probe + more, atol=0.1)
    # One that was only stated is found, as well as from the one before it, and is in doubt no more.
    stated, long = learned.move(learned.arm.probe + more), learned.move((0.0, 0.0, 400.0))
    based = stated.register(test.data, test.groups, free=())
    assert based.model.linear_model_.shown_by is not None
    for known in (based, long.move(learned.arm.probe + more)):
        again = known.register(test.data, test.groups)
        assert_allclose(again.arm.probe, moved.arm.probe, atol=1e-3)
        of_both = (one.model.predict(test.data, return_std=True)[1] for one in (again, moved))
        assert_allclose(*of_both, rtol=1e-3)


def test_an_update_by_touches_of_a_ball_of_the_probe(learned):
    """What is left of a knock of joint 4 is what cones of today leave of it."""
    knock = 60 * ARCSEC * np.eye(6)[3]
    test = make_features(3, 2, 0, 15, tip_diameter=6.0, machine=MACHINE, random_state=3)
    given = {"features": test.features, "tip_diameter": 6.0}
    updated = learned.update(test.data + knock, test.groups, **given)
    assert list(updated.model.updates_[-1]["tau"]) == ["offset of joint 4"]
    assert updated.arm == learned.arm
    far = make_single_point(5, 12, machine=MACHINE, random_state=6)
    angles = far.data + knock

    def left(correction):
        points = correction.correct(angles)[0]
        return np.linalg.norm(
            points - np.array([points[far.groups == g].mean(axis=0) for g in far.groups])
        )

    assert left(updated) < 0.6 * left(learned)
