"""Standard deviations of coordinates and distances against draws, geometry, and simulated arms."""

from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    Correction,
    RBFNetRegressor,
    learn_correction,
    position_residuals,
)
from sklearn_raacmm.correction._change import doubts_of
from sklearn_raacmm.correction._correction import _shoulder
from sklearn_raacmm.datasets import SimulatedArm, make_gauge, make_single_point
from sklearn_raacmm.utils import Groups


@pytest.mark.parametrize("name", ["aacmm6", "ur10", "panda"])
def test_a_scale_moves_points_away_from_the_shoulder(name):
    """Larger links, the height of the first axis kept, as no test at fixed points shows it."""
    arm = Arm.from_name(name)
    factor = 1.001
    d = factor * arm.d
    d[0] = arm.d[0]
    larger = arm.replace(a=factor * arm.a, d=d, probe=factor * arm.probe)
    angles = np.random.default_rng(0).uniform(-2, 2, (30, arm.n_joints))
    points = arm.forward(angles)
    moved = larger.forward(angles) - points
    np.testing.assert_allclose(moved, (factor - 1) * (points - _shoulder(arm)), atol=1e-9)


def test_distances_of_points_that_are_drawn():
    """A regressor with standard deviations of its own: both ends are independent."""
    rng, arm, scale_sd = np.random.default_rng(1), Arm.from_name("ur10"), 5e-5
    angles, sds = rng.uniform(-2, 2, (2, 6)), rng.uniform(0.01, 0.05, (2, 3))
    of_angles = {row[0]: sd for row, sd in zip(angles, sds, strict=True)}
    model = SimpleNamespace(
        predict=lambda X, return_std: (np.zeros((1, 3)), of_angles[X[0, 0]][None])
    )
    facts = {"causes": {}, "noise_mm": 0.0, "std_factor": 1.0, "scale_sd": scale_sd}
    _, std = Correction(arm, model, None, facts).distances(angles[:1], angles[1:])
    points = arm.forward(angles)[:, None] + sds[:, None] * rng.normal(size=(2, 20_000, 3))
    factor = 1 + scale_sd * rng.normal(size=(20_000, 1))
    drawn = np.linalg.norm(factor * (points[0] - points[1]), axis=1)
    assert drawn.std() == pytest.approx(std[0], rel=0.03)


@pytest.fixture(scope="module")
def learned():
    tests = [make_single_point(8, 20, bars=[500], random_state=seed) for seed in range(3)]
    return [
        learn_correction(t.nominal_arm, t.data, t.groups, lengths=t.lengths, cv=3) for t in tests
    ]


@pytest.mark.exhaustive
def test_three_deviations_have_three_names(learned):
    correction = learned[0]
    angles = correction.angles[:20]
    points, of_coordinate = correction.correct(angles)
    same, within = correction.correct(angles, std_of="position")
    np.testing.assert_array_equal(points, same)
    assert np.all(of_coordinate >= within)
    # Calibration and model have the scale from the same lengths: the model holds all of it.
    own, whole = correction.model.linear_model_.scale_sd, correction.calibration.scale_sd_corrected
    assert own == pytest.approx(whole)
    assert correction.scale_sd < 1e-6 * whole
    lengths, std = correction.distances(angles[:10], angles[10:])
    line = points[10:] - points[:10]
    np.testing.assert_allclose(lengths, np.linalg.norm(line, axis=1))
    draws = correction.model.sample_y(angles, 4000, random_state=0)
    draws = np.linalg.norm(line[:, :, None] + draws[10:] - draws[:10], axis=1).std(axis=1)
    # Of both ends the noise along the line, by the Jacobian.
    linear, along = correction.model.linear_model_, line / lengths[:, None]
    J = np.stack([correction.arm.jacobian(part) for part in (angles[:10], angles[10:])])
    size = correction.facts["std_factor"] * correction.noise / linear.noise_sd
    by_axis = linear.noise_of_rows + np.square(J) @ linear.noise_of_joints
    noise = size**2 * np.einsum("enc,nc->n", by_axis, np.square(along))
    expected = np.sqrt(draws**2 + noise + (correction.scale_sd * lengths) ** 2)
    np.testing.assert_allclose(std, expected, rtol=0.05)
    with pytest.raises(ValueError, match="std_of"):
        correction.correct(angles, std_of="length")
    with pytest.raises(ValueError, match="There are 10 angles, but 9 others"):
        correction.distances(angles[:10], angles[:9])


def test_draws_hold_the_scale_of_the_arm():
    """Lengths of drawn points scatter as is said of distances, by the table's scale above all."""
    test = make_single_point(6, 12, random_state=0)
    correction = learn_correction(test.nominal_arm, test.data, test.groups, cv=2)
    first, second = test.data[:12], test.data[-12:]
    points = correction.sample(np.vstack([first, second]), 4000, random_state=0)
    drawn = np.linalg.norm(points[12:] - points[:12], axis=1)
    lengths, std = correction.distances(first, second)
    np.testing.assert_allclose(drawn.mean(axis=1), lengths, atol=0.1 * std.max())
    noise = correction.model.linear_model_.distance_std(first, second)
    np.testing.assert_allclose(drawn.std(axis=1), noise, rtol=0.06)
    assert np.all(drawn.std(axis=1) > 0.8 * correction.calibration.scale_sd_corrected * lengths)
    # One scale for all poses of a draw: long lengths are long together.
    assert np.corrcoef(drawn[np.argsort(lengths)[-2:]])[0, 1] > 0.8
    # Of a table whose model holds no lengths the scale is drawn beside it.
    plain = ArmResidualRegressor(orders=2, causes=[])
    with pytest.warns(UserWarning, match="nothing holds the distances"):
        correction = learn_correction(test.nominal_arm, test.data, test.groups, model=plain, cv=2)
    points = correction.sample(np.vstack([first, second]), 4000, random_state=0)
    drawn = np.linalg.norm(points[12:] - points[:12], axis=1).std(axis=1)
    assert np.all(drawn > 0.9 * correction.calibration.scale_sd_corrected * lengths)
    network = RBFNetRegressor(5).fit(test.data, test.target)
    with pytest.raises(TypeError, match="RBFNetRegressor knows no causes"):
        replace(correction, model=network).sample(first)


@pytest.mark.exhaustive
def test_the_verdict_says_what_is_not_known_of_lengths(learned):
    assert learned[0].verdict.startswith("It helps at new positions")
    test = make_single_point(8, 20, random_state=0)
    alone = learn_correction(test.nominal_arm, test.data, test.groups, cv=3)
    assert alone.helps
    assert alone.verdict.startswith("It repeats better at new positions")
    per_metre = 2000 * alone.calibration.scale_sd_corrected
    assert f"not known to better than {per_metre:.2g} mm per metre (k = 2)" in alone.verdict


@pytest.fixture(scope="module")
def by_tracker():
    """Corrections of a robot by a tracker of 20 um, without and with that number."""
    rng = np.random.default_rng(0)
    arm = Arm.from_name("ur10", probe=(0, 0, 109))
    angles = rng.uniform(-2, 2, (260, 6))
    eccentric = angles + 1e-4 * np.cos(angles)
    true = arm.forward(eccentric)
    points = true + rng.normal(0, 0.02, true.shape)
    given = (arm, angles[:200], None, points[:200])
    model = ArmResidualRegressor(orders=2, causes=[])
    of = {sd: learn_correction(*given, model=model, cv=2, points_sd=sd) for sd in (0.0, 0.02)}
    return of, angles[200:], true[200:], points[200:], given, model


def test_noise_of_a_tracker_is_not_the_arms(by_tracker):
    """Corrected points are as far from the true ones as is said, and measured ones farther."""
    of, angles, true, points, *_ = by_tracker
    rotation, translation = of[0.02].base
    found, std = of[0.02].correct(angles, std_of="position")
    every = of[0.0].correct(angles, std_of="position")[1]
    np.testing.assert_allclose(np.square(every) - np.square(std), 0.02**2, rtol=1e-9)
    off = found @ rotation.T + translation
    assert np.mean(np.abs(off - points) < 1.96 * every) > 0.9
    assert np.sqrt(np.mean(np.square(off - true))) < 2 * np.sqrt(np.mean(np.square(std)))
    one, other = (c.distances(angles[::2], angles[1::2])[1] for c in (of[0.0], of[0.02]))
    np.testing.assert_allclose(np.square(one) - np.square(other), 2 * 0.02**2, rtol=1e-6)


def test_a_tracker_cannot_be_worse_than_its_points_show(by_tracker):
    """What is stated contradicts the data, or there is no tracker."""
    *_, (arm, angles, _, points), model = by_tracker
    with pytest.raises(ValueError, match=r"points_sd is 0\.2 mm, and the tracker's points differ"):
        learn_correction(arm, angles, None, points, model=model, cv=3, points_sd=0.2)
    with pytest.raises(ValueError, match="there are none"):
        learn_correction(arm, angles, np.arange(200) // 10, model=model, points_sd=0.02)


@pytest.mark.exhaustive
def test_errors_at_other_places_are_as_large_as_is_said(learned):
    of_distances, of_coordinates = [], []
    for seed, correction in enumerate(learned):
        other = make_gauge([300, 1000], 8, 2, random_state=seed)
        points, std = correction.correct(other.data)
        true = other.simulation.true_points
        of_coordinates.append((points - true) / std)
        i, j = np.arange(0, len(true), 4), np.arange(2, len(true), 4)
        found, std = correction.distances(other.data[i], other.data[j])
        of_distances.append((found - np.linalg.norm(true[i] - true[j], axis=1)) / std)
    assert 0.6 < np.sqrt(np.mean(np.square(of_distances))) < 1.6
    assert 0.4 < np.sqrt(np.mean(np.square(of_coordinates))) < 1.4


def test_an_update_keeps_the_probe_that_was_registered():
    """A joint that was knocked is no other stylus; one that is longer by 12 mm or 100 mm is."""
    machine = SimulatedArm("typical", random_state=0)
    test = make_single_point(9, 15, machine=machine, random_state=0)
    learnt, new = test.groups < 6, test.groups >= 6
    known = test.nominal_arm, test.data[learnt], test.groups[learnt]
    correction = learn_correction(*known, model=ArmResidualRegressor(orders=4), cv=2)
    knocked = test.data[new] + np.deg2rad([0, 0, 0, 0.02, 0, 0])
    updated = correction.update(knocked, test.groups[new])
    assert updated.arm == correction.arm
    assert updated.model.updates_[-1]["tau"].keys() == {"offset of joint 4"}
    points, bare = updated.correct(knocked)[0], correction.correct(knocked)[0]
    left, before = (
        np.linalg.norm(position_residuals(some, test.groups[new])) for some in (points, bare)
    )
    assert left < 0.5 * before
    for longer in (12, 100):
        other = copy(machine)
        for name in ("nominal_arm", "true_arm"):
            arm = getattr(machine, name)
            setattr(other, name, arm.replace(probe=arm.probe + np.array([0, 0, longer])))
        test = make_single_point(3, 12, machine=other, random_state=1)
        updated = correction.update(test.data, test.groups)
        assert updated.arm.probe[2] - correction.arm.probe[2] == pytest.approx(longer, abs=1)


def test_doubts_are_named_by_their_causes():
    """A probe that is not known by 1 mm is most of what is not known of points."""
    names = ["probe_x", "probe_y", "probe_z"]
    test = make_single_point(4, 10, random_state=0)
    fit = ArmResidualRegressor(test.arm, orders=2).fit(test.data, test.target, groups=test.groups)
    linear = fit.linear_model_
    wide = np.zeros((len(linear.coef), 3))
    for k, name in enumerate(names):
        column = linear.layout.others[linear.layout.names.index(name)]
        wide[linear.layout.n_waves + linear.layout.names.index(name), k] = 1 / column.unit
    linear = replace(
        linear, half=np.hstack([linear.half, wide]), seen=np.pad(linear.seen, ((0, 0), (0, 3)))
    )
    shares = doubts_of(linear, test.data, test.groups)
    assert next(iter(shares)) == "probe"
    assert sum(shares.values()) == pytest.approx(1)
    assert shares["probe"] > 0.9
    whole = np.square(
        Groups(test.groups).centred(linear.columns(test.data) @ linear.gauge_free_half)
    )
    alone = linear.columns(test.data) @ np.where(wide.any(axis=1)[:, None], wide, 0)
    expected = np.square(Groups(test.groups).centred(alone)).sum() / whole.sum()
    assert shares["probe"] == pytest.approx(expected, rel=0.05)
