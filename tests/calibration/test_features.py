"""Calibration from touches of planes and balls, whose places and sizes are unknown."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from sklearn_raacmm import calibrate, position_residuals
from sklearn_raacmm.calibration._fit import TableFit
from sklearn_raacmm.datasets import ArmErrors, make_features, make_gauge, make_single_point
from sklearn_raacmm.metrics import gauge_lengths, single_point_repeatability


def calibrated(test, features=None, **given):
    """A calibration without its warnings."""
    features = test.features if features is None else features
    given = {"groups": test.groups, "lengths": test.lengths, **given}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return calibrate(test.nominal_arm, test.data, features=features, **given)


def test_balls_and_planes_teach_the_table():
    """At cones that took no part 2S falls from that of the drawing to about that of cones."""
    left = {}
    for name, n in (("cones", (0, 0, 10)), ("balls", (10, 0, 0)), ("both", (4, 4, 2))):
        test = make_features(*n, n_touches=30, random_state=2)
        result = calibrated(test)
        new = make_single_point(8, 15, machine=test.simulation.machine, random_state=5)
        for arm, which in ((test.nominal_arm, "drawing"), (result.arm, name)):
            left[which] = single_point_repeatability(arm.forward(new.data), new.groups)
    assert left["cones"] < left["drawing"] / 4
    assert max(left["balls"], left["both"]) < 1.5 * left["cones"]


def without_last_step(monkeypatch):
    """What touches have been fitted to stays, whatever the table does not explain."""
    monkeypatch.setattr(TableFit, "_take_best_table", lambda fit, mask: None)


def test_a_table_taught_by_planes_does_not_follow_what_only_planes_show(monkeypatch):
    """At new cones, of joints that are eccentric: beside the table that fits the touches best."""
    machine, left = ArmErrors.only(eccentricity_arcsec=(8.0, 3.0), encoder_noise_arcsec=0.5), {}
    for step in ("taken", "left out"):
        if step == "left out":
            without_last_step(monkeypatch)
        for seed in range(3):
            test = make_features(0, 8, 0, 20, machine=machine, random_state=seed)
            arm = calibrated(test).arm
            own = test.simulation.machine
            new = make_single_point(6, 12, machine=own, random_state=seed + 50)
            value = single_point_repeatability(arm.forward(new.data), new.groups)
            left.setdefault(step, []).append(value)
    assert np.mean(left["taken"]) < 0.93 * np.mean(left["left out"])


def test_projected_unknowns_are_those_of_an_explicit_search(monkeypatch):
    """Zeros and probe as of least squares with centres, sizes and planes among the parameters."""
    without_last_step(monkeypatch)
    test = make_features(3, 2, 1, 12, random_state=4)
    sd, free = 0.003, ["theta_offset", "probe"]
    kinds = [(label, kind) for label, kind, *_ in test.features]  # no sizes
    given = {"free": free, "loss": "squared", "prior_angle_rad": sd, "prior_length_mm": 0.4}
    result = calibrated(test, kinds, **given)
    arm, n = test.nominal_arm, 6
    kind_of = dict(kinds)

    def shown(x):
        zeros = arm.theta_offset + x[:n]
        return arm.replace(theta_offset=zeros, probe=arm.probe + x[n : n + 3]).forward(test.data)

    def off(x):
        points, at, rows = shown(x), n + 3, []
        for label in np.unique(test.groups):
            own = points[test.groups == label]
            kind, unknown = kind_of.get(label, "cone"), x[at : at + 4]
            start = origin[label]
            if kind == "sphere":
                rows.append(np.linalg.norm(own - start - unknown[:3], axis=1) - 15 - unknown[3])
            elif kind == "plane":
                normal = np.array([unknown[0], unknown[1], 1.0]) @ axes[label]
                rows.append((own - start) @ normal / np.linalg.norm(normal) - unknown[2])
            else:
                rows.append((own - start - unknown[:3]).ravel())
            at += 4
        rows = np.concatenate(rows) / result.sigma_mm
        return np.r_[rows, x[:n] / sd, x[n : n + 3] / 1000]

    first = arm.forward(test.data)
    origin, axes = {}, {}
    for label in np.unique(test.groups):
        own = first[test.groups == label]
        origin[label] = own.mean(axis=0)
        axes[label] = np.linalg.svd(own - origin[label])[2]
    start = np.zeros(n + 3 + 4 * len(origin))
    for i, label in enumerate(origin):
        if kind_of.get(label) == "sphere":
            start[n + 3 + 4 * i + 2] = -7.0  # below the touches
    tight = {"x_scale": "jac", "xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
    found = least_squares(off, least_squares(off, start, **tight).x, jac="3-point", **tight).x
    assert_allclose(result.arm.theta_offset - arm.theta_offset, found[:n], atol=2e-7)
    assert_allclose(result.arm.probe - arm.probe, found[n : n + 3], atol=2e-4)


def test_a_wrong_size_and_a_wrong_block_are_named():
    test = make_features(5, 0, 2, 25, blocks=[250.0, 300.0, 300.0], random_state=1)
    assert not calibrated(test).findings
    features = [(a, kind, *((30.1, 0.001) if a == 2 else of)) for a, kind, *of in test.features]
    result = calibrated(test, features)
    assert [finding.code for finding in result.findings] == ["wrong-length"]
    found = result.findings[0].text.split("the size of 2 is ")[1].split()[0]
    assert abs(float(found) - 30) < 0.03
    right, wrong = test.lengths[:2], test.lengths[2]
    lengths = [*right, (*wrong[:2], wrong[2] + 0.1, wrong[3])]
    (finding,) = calibrated(test, lengths=lengths).findings
    found = finding.text.split(f"{wrong[0]} to {wrong[1]} is ")[1].split()[0]
    assert abs(float(found) - 300) < 0.08


def test_no_length_is_between_planes_that_are_not_parallel():
    test = make_features(5, 2, 0, 25, random_state=1)
    planes = [label for label, kind, *_ in test.features if kind == "plane"]
    with pytest.raises(ValueError, match=r"planes . and ., which are turned by \d+ degrees"):
        calibrated(test, lengths=[(*planes, 300.0, 0.01)])


def test_the_ball_of_the_probe_counts_on_the_side_that_was_touched():
    """Outside, as it was touched; said to be inside, sizes disagree by twice the ball."""
    test = make_features(6, 0, 0, 25, blocks=[150.0], tip_diameter=4.0, random_state=3)
    result = calibrated(test, tip_diameter=4.0)
    assert result.findings == ()
    assert np.abs(result.length_errors_mm).max() < 0.05
    (block, *sizes) = result.length_errors_mm / result.length_sd_mm
    assert max(abs(block), np.abs(sizes).max()) < 3
    inside = [(*one, "inside") if one[1] == "sphere" else one for one in test.features]
    result = calibrated(test, inside, tip_diameter=4.0, accept="wrong-length")
    assert "wrong-length" in {finding.code for finding in result.findings}


def test_the_scale_is_as_unsure_as_an_arm_that_bends_makes_it():
    """Errors of the scale, by gauges elsewhere, over its standard deviation, of three arms each."""
    noise = ArmErrors.only(length_mm=0.4, encoder_noise_arcsec=1)
    found = {}
    for name, machine in (("typical", "typical"), ("noise", noise)):
        off = []
        for seed in range(3):
            test = make_features(0, 0, 5, 15, blocks=[500.0], machine=machine, random_state=seed)
            result = calibrated(test, accept=["poses-alike", "wrong-length"])
            own = test.simulation.machine
            gauge = make_gauge([500.0], 6, 5, machine=own, random_state=seed + 50)
            shown = gauge_lengths(result.arm.forward(gauge.data), gauge.groups, gauge.pairs)
            scale = (shown / gauge.lengths - 1).mean()
            off.append(scale / np.array([result.scale_sd, result.scale_sd_corrected]))
        found[name] = np.sqrt(np.square(off).mean(axis=0))
    # Taken as independent, as behind a correction, what bends the arm would hide.
    (z, independent), (z_of_noise, same) = found.values()
    assert 0.4 < z < 1.7
    assert independent > 3 * z
    assert 0.4 < z_of_noise < 1.7
    assert same < 1.1 * z_of_noise


def test_a_touch_of_another_ball_is_an_outlier():
    test = make_features(6, 0, 0, 25, random_state=1)
    groups = test.groups.copy()
    groups[3] = 5
    result = calibrated(test, groups=groups)
    assert result.outliers[0] == 3
    assert len(result.outliers) <= 2
    assert result.typical_scatter_mm < 0.1
    # What a correction learns from is about the same forms.
    left = result.residuals(test.data, groups=groups)
    assert_allclose(left, result.residuals_mm, atol=1e-9)
    shown = result.arm.forward(test.data)
    assert_allclose(position_residuals(shown, groups, features=test.features), left, atol=1e-9)


@pytest.mark.parametrize(
    ("features", "words"),
    [
        ([(0, "cube")], "a feature is a cone, plane, sphere"),
        ([(99, "plane")], "features name 99, which has no rows"),
        ([(0, "plane", 3.0, 0.1)], "a plane has no size"),
        ([(0, "sphere", -3.0, 0.1)], "must be above 0"),
        ([(0, "sphere", 30.0)], "each of features must be"),
        ([(0, "sphere"), (0, "plane")], "name a label twice"),
    ],
)
def test_features_that_cannot_be_are_refused(features, words):
    test = make_features(2, 0, 0, 6)
    with pytest.raises(ValueError, match=words):
        calibrate(test.nominal_arm, test.data, test.groups, features=features)
    with pytest.raises(ValueError, match="features are groups of touches"):
        calibrate(test.nominal_arm, test.data, points=test.points, features=[(0, "plane")])
