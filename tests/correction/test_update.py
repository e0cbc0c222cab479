"""A model brought up to date: the old one, the new one, and what lies between."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    calibrate,
    learn_correction,
    position_residuals,
    update_correction,
)
from sklearn_raacmm.correction import _update
from sklearn_raacmm.datasets import ArmErrors, make_single_point
from sklearn_raacmm.metrics import single_point_repeatability
from sklearn_raacmm.utils import FindingError

ARM = Arm.from_name("ur10", probe=(0, 0, 93))
ARCSEC = np.pi / 180 / 3600


def errors(angles, knock=0.0):
    """Encoders that are eccentric and have teeth; a knock shifts the eccentricity of joint 1."""
    turn = np.zeros_like(angles)
    turn[:, 0] = (10 + knock) * np.sin(angles[:, 0])
    turn[:, 1] = 12 * np.cos(angles[:, 1]) + 3 * np.sin(17 * angles[:, 1])
    turn[:, 3] = 8 * np.cos(2 * angles[:, 3] - 1)
    return np.einsum("nij,nj->ni", ARM.jacobian(angles), turn * ARCSEC)


def place_columns(angles):
    """What moves of the tool, and shifts and turns of the base, do to the probe, by differences."""
    points, step = ARM.forward(angles), 1e-3
    columns = []
    for axis in np.eye(3):
        columns.append((ARM.replace(probe=ARM.probe + step * axis).forward(angles) - points) / step)
    columns += [np.broadcast_to(axis, points.shape) for axis in np.eye(3)]
    reach = np.hypot(ARM.a, ARM.d).sum() + np.linalg.norm(ARM.probe)
    columns += [np.cross(axis, points) / reach for axis in np.eye(3)]
    return np.stack(columns, axis=2)


def rows(n, seed, knock=0.0, noise_mm=0.01):
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-2.5, 2.5, (n, 6))
    return angles, errors(angles, knock) + rng.normal(0, noise_mm, (n, 3))


@pytest.fixture(scope="module")
def model():
    return ArmResidualRegressor(ARM, orders=20).fit(*rows(500, 0))


def left(model, knock, seed=99):
    angles, _ = rows(400, seed)
    return np.linalg.norm(errors(angles, knock) - model.predict(angles), axis=1).mean()


def test_fewer_poses_than_freedoms_change_nothing(model):
    angles, y = rows(50, 1)
    with pytest.warns(UserWarning, match="3 new poses give 9 coordinates, .* the 9 freedoms"):
        few = update_correction(model, angles[:3], y[:3])
    assert_allclose(few.predict(angles), model.predict(angles), rtol=0)
    assert few is not model


def test_poses_alone_at_their_positions_are_not_of_another_unit(model):
    """Of 60 poses 6 share a position: the others are no distance from its middle, in any unit."""
    angles, y = rows(60, 1)
    updated = update_correction(model, angles, y, groups=np.arange(60) % 57)
    # The tool, three numbers, is found anew from nine of 0.01 mm each.
    assert left(updated, 0) < 0.02


def test_new_poses_that_show_nothing_new_change_next_to_nothing(model):
    angles, y = rows(60, 1)
    updated = update_correction(model, angles, y, date="2026-01-01")
    # Base and tool, nine numbers from 180 of 0.01 mm each, are found anew: 0.004 mm.
    assert left(updated, 0) < 0.006
    (entry,) = updated.updates_
    assert entry["date"] == "2026-01-01"
    assert entry["n_poses"] == 60
    assert entry["tau"] == {}
    assert entry["noise_sd_mm"] == pytest.approx(0.01, rel=0.2)


@pytest.mark.parametrize("n", [30, pytest.param(60, marks=pytest.mark.exhaustive)])
def test_a_knock_is_learned_from_few_poses(model, n):
    angles, y = rows(n, 2, knock=15)
    updated = update_correction(model, angles, y)
    assert left(updated, 15) < {30: 0.5, 60: 0.3}[n] * left(model, 15)
    # The knocked joint is the one that changed, and the old model is as it was.
    tau = updated.updates_[0]["tau"]
    assert max(tau, key=tau.get) == "harmonics of joint 1"
    assert not hasattr(model, "updates_")
    assert len(update_correction(updated, angles, y).updates_) == 2


def test_posterior_against_the_textbook(model, monkeypatch):
    """With the taus and the noise that were found it is one joint normal distribution.

    Every order may change by what harmonics are expected to be, but those above 8 by no more than
    there is of them; orders 1 and 2 may be new.
    """
    monkeypatch.setattr("sklearn_raacmm.correction._update.named_changes", lambda *_: None)
    angles, y = rows(40, 4, knock=15)
    updated = update_correction(model, angles, y)
    old, new = model.linear_model_, updated.linear_model_
    (entry,) = updated.updates_
    pairs = [tuple(pair) for pair in new.terms.harmonics.tolist()]
    known = [tuple(pair) for pair in old.terms.harmonics.tolist()]
    assert set(pairs) == set(known) | {(j, k) for j in range(6) for k in (1, 2)}
    assert max(order for _, order in pairs) > 8
    families = new.term_table()["family"].tolist()
    at = [2 * pairs.index(pair) + i for pair in known for i in (0, 1)]
    at += range(2 * len(pairs), len(new.coef))
    mean, half = np.zeros(len(new.coef)), np.zeros((len(new.coef), old.half.shape[1]))
    mean[at], half[at] = old.coef, old.half
    change = []
    for i, (joint, order) in enumerate(pairs):
        size = old.prior_sd["harmonics"]
        if order > 8:
            size = min(size, np.hypot(*mean[2 * i : 2 * i + 2]) / np.sqrt(2))
        change += 2 * [entry["tau"][f"harmonics of joint {joint + 1}"] * size]
    change += [entry["tau"][name] * old.prior_sd[name] for name in families]
    # The coefficients of the model, and those of a place that may be 5 mm off.
    P = np.zeros((len(mean) + 9,) * 2)
    P[: len(mean), : len(mean)] = half @ half.T + np.diag(np.square(change))
    P[len(mean) :, len(mean) :] = 25 * np.eye(9)
    mean = np.r_[mean, np.zeros(9)]

    def columns(angles):
        return np.concatenate([new.columns(angles), place_columns(angles)], axis=2)

    A = columns(angles).reshape(120, -1)
    gain = np.linalg.solve(A @ P @ A.T + entry["noise_sd_mm"] ** 2 * np.eye(120), A @ P).T
    mean, P = mean + gain @ (y.ravel() - A @ mean), P - gain @ A @ P
    far = rows(20, 5)[0]
    found, std = new.predict(far, return_std=True)
    assert_allclose(found, columns(far) @ mean, atol=2e-5)
    variance = np.einsum("nij,jk,nik->ni", columns(far), P, columns(far))
    assert_allclose(std, np.sqrt(variance), rtol=1e-3)


def test_single_points_update_too():
    data = make_single_point(n_positions=12, n_poses=20, random_state=0)
    old = data.groups < 9
    model = ArmResidualRegressor(data.arm, orders=6)
    model.fit(data.data[old], data.target[old], groups=data.groups[old])
    X, y, groups = data.data[~old], data.target[~old], data.groups[~old]
    updated = update_correction(model, X, y, groups=groups)
    before, after = (position_residuals(y - one.predict(X), groups) for one in (model, updated))
    assert np.linalg.norm(after, axis=1).mean() < np.linalg.norm(before, axis=1).mean()
    # Where the base stands no such test shows: it is in no deviation, before and after.
    old_std, std = (m.predict(data.data, return_std=True)[1] for m in (model, updated))
    assert np.median(std) < 3 * np.median(old_std)
    with pytest.raises(ValueError, match="give groups, the position of each new pose"):
        update_correction(model, X, y)


@pytest.mark.exhaustive
def test_on_the_ur10_another_day(ur10, ur10_b):
    """Fitted to 1000 poses of one series, brought up to date with 60 of another."""
    some = np.random.default_rng(0).choice(len(ur10.angles), 1000, replace=False)
    first = calibrate(ARM, ur10.angles[some], points=ur10.points[some])
    model = ArmResidualRegressor(first.arm).fit(ur10.angles[some], first.residuals_mm)
    new = np.random.default_rng(0).permutation(len(ur10_b.angles))
    known, rest = ((ur10_b.angles[part], ur10_b.points[part]) for part in (new[:60], new[60:]))
    result = calibrate(first.arm, known[0], points=known[1], correction=model, free=["probe"])
    updated = update_correction(model, known[0], result.residuals(*known))
    registered, now = (
        np.linalg.norm(result.residuals(*rest) - m.predict(rest[0]), axis=1).mean()
        for m in (model, updated)
    )
    assert registered < 0.32
    assert now < 0.2


@pytest.mark.filterwarnings("ignore:The correction is 0")  # there is nothing to correct
@pytest.mark.parametrize("seed", [2, pytest.param(3, marks=pytest.mark.exhaustive)])
def test_an_arm_without_errors_stays_as_it_is(seed):
    """An update made of the rounding of its residuals came to half a micrometre."""
    test = make_single_point(6, 10, machine="none", random_state=seed)
    model = ArmResidualRegressor(test.arm, orders=2, causes=["kinematics", "wobble"])
    model.fit(test.data, test.target, groups=test.groups)
    few = test.groups < 4
    new = test.data[few], test.target[few]
    updated = update_correction(model, *new, groups=test.groups[few])
    assert updated.updates_[-1]["tau"] == {}
    assert np.abs(updated.predict(test.data)).max() < 1e-6  # a nanometre


def test_intervals_hold_after_an_update(model):
    """At poses far from the new ones, too: 95 % of true residuals in 1.96 deviations."""
    inside = []
    for seed in range(4):
        angles, y = rows(30, 20 + seed, knock=15)
        updated = update_correction(model, angles, y)
        far, true = rows(300, 40 + seed, knock=15)
        mean, std = updated.predict(far, return_std=True, with_noise=True)
        inside.append(np.mean(np.abs(true - mean) < 1.96 * std))
        assert updated.linear_model_.std_scale > 0
    assert 0.88 < np.mean(inside) < 0.995


@pytest.mark.parametrize("n", [10, pytest.param(60, marks=pytest.mark.exhaustive)])
def test_an_update_is_no_reason_to_fade(model, n):
    """Between the new poses the old correction is worth no less; far outside it still fades."""
    angles, y = rows(n, 30, knock=15)
    updated = update_correction(model, angles, y)
    others, _ = rows(200, 31)
    share = updated.fading(others)
    assert np.mean(share) > 0.98
    assert np.quantile(share, 0.05) > 0.9


def warm_rows(n, seed, lag):
    """Residuals with the temperature and the direction of joint 2 as columns 7 and 8."""
    angles, y = rows(n, seed)
    rng = np.random.default_rng([seed, 1])
    extra = np.column_stack([rng.uniform(15, 25, n), rng.choice([-1.0, 1.0], n)])
    y = y + 11.7e-6 * (extra[:, :1] - 20) * ARM.forward(angles)
    y = y + ARM.jacobian(angles)[:, :, 1] * lag * ARCSEC * extra[:, 1:]
    return np.hstack([angles, extra]), y


def test_extra_columns_are_brought_up_to_date():
    """The backlash of joint 2 has grown: the update finds that, and that nothing else did."""
    model = ArmResidualRegressor(ARM, orders=20, extra=["temperature", "direction 2"])
    model.fit(*warm_rows(500, 0, lag=6))
    updated = update_correction(model, *warm_rows(60, 1, lag=16))
    X, y = warm_rows(300, 2, lag=16)
    old, new = (np.linalg.norm(y - m.predict(X), axis=1).mean() for m in (model, updated))
    assert new < 0.5 * old
    tau = updated.updates_[0]["tau"]
    assert max(tau, key=tau.get) == "direction"
    lags = {term["name"]: term["value"] for term in updated.terms_}
    assert lags["joint 2 lags"] == pytest.approx(16, abs=1.5)


def test_a_model_that_is_not_used_is_judged_anew(model):
    """It can be updated, and the new poses, which it has not seen, say how much of it is used."""
    refused = deepcopy(model)
    refused.fading_ = replace(model.fading_, most=0.0)
    angles, y = rows(60, 1)
    updated = update_correction(refused, angles, y)
    assert updated.fading_.most > 0.9
    assert left(updated, 0) < 0.3 * np.linalg.norm(errors(rows(400, 99)[0]), axis=1).mean()
    # Nothing fades where the new poses have shown so.
    assert updated.fading(angles).min() > 0.9


@pytest.mark.filterwarnings("ignore:The correction is 0")
def test_three_positions_put_a_model_that_was_of_no_use_into_use_after_a_knock():
    """A good table needs no correction until joint 3 is knocked: judged at other cones."""
    built = ArmErrors.only(length_mm=0.2, angle_deg=0.02, encoder_noise_arcsec=0.5, seating_um=4)
    test = make_single_point(6, 13, machine=built, random_state=1)
    machine = test.simulation.machine
    learned = learn_correction(test.nominal_arm, test.data, test.groups, cv=2)
    assert learned.model.helps_ is False
    knock = np.deg2rad(0.01) * np.eye(6)[2]
    poses, unseen = (make_single_point(3, 15, machine=machine, random_state=i) for i in (2, 3))
    updated = learned.update(poses.data + knock, poses.groups)
    angles = unseen.data + knock
    before = single_point_repeatability(test.arm.forward(angles), unseen.groups)
    after = single_point_repeatability(updated.correct(angles)[0], unseen.groups)
    assert after < 0.3 * before


def test_a_likelier_explanation_hands_nothing_over(model):
    """Residuals of the corrected arm: refused, and taken only where the finding is named."""
    angles, y = rows(60, 1)
    corrected = y - model.predict(angles)
    with pytest.raises(FindingError, match="if they have been corrected already") as caught:
        update_correction(model, angles, corrected)
    assert caught.value.finding.code == "corrected-already"
    assert 'accept "corrected-already"' in str(caught.value)
    with pytest.raises(FindingError, match="micrometres"):  # nothing is warned of beside it
        update_correction(model, angles, 1000 * y)
    with pytest.warns(UserWarning, match="corrected already"):
        taken = update_correction(model, angles, corrected, accept="corrected-already")
    assert [finding.weight for finding in taken.findings_] == ["doubt"]


def test_what_is_wrong_is_named_by_its_row_and_beside_what_is_as_likely(model):
    """A turn that is free explains the other sign nearly as well; many rows tell them apart."""
    angles, y = rows(61, 1)
    # Residual 31 is that of the angles that are in row 30 now.
    with pytest.raises(FindingError, match="of the row before, from row 30 on") as caught:
        update_correction(model, np.delete(angles, 30, axis=0), y[:60])
    assert caught.value.finding.rows == (30,)
    both = r"corrected twice .* nats[)], or if their axes are others: they are turned and mirrored"
    for n, said in ((60, both), (300, r"corrected twice .* nats[)][.] Give measured")):
        angles, y = rows(n, 1)
        with pytest.raises(FindingError, match=said):
            update_correction(model, angles, -y)


def test_rows_that_scatter_are_refused(model):
    """By a fifth of a millimetre they may be of this arm; by 5 mm they are those of another."""
    angles, y = rows(60, 1)
    whose = {"strange-poses": "are they of this arm", "another-arm": "whose arm it is"}
    for noise_mm, code in zip((0.2, 5.0), whose, strict=True):
        noise = np.random.default_rng(0).normal(0, noise_mm, (60, 3))
        with pytest.raises(FindingError, match=whose[code]) as caught:
            update_correction(model, angles, y + noise)
        assert caught.value.finding.code == code


def test_new_poses_that_nothing_is_wrong_with_are_taken(model):
    """A knock, a moved base and slips are changes, and no mistakes, in any order of the rows."""
    # A slip near the end is no reason to call the last rows late.
    late = [(0, 38), (1, 36), (3, 39), (20, 38)]
    for seed, slipped in [*((seed, seed) for seed in range(6)), *late]:
        angles, y = rows(40, 60 + seed, knock=15 * (seed % 2))
        y = y + place_columns(angles) @ np.random.default_rng(seed).normal(0, 0.3, 9)
        y[slipped] += 2.0
        shuffled = seed % 3 and slipped == seed
        some = np.random.default_rng(seed).permutation(40) if shuffled else np.arange(40)
        assert not update_correction(model, angles[some], y[some]).findings_


def test_poses_of_which_the_model_knows_nothing_raise_no_finding():
    """Its expectation is as uncertain as it is large: that it is absent says nothing."""
    angles, _ = rows(60, 0)
    y = errors(0.1 * angles) + np.random.default_rng(0).normal(0, 0.01, (60, 3))
    few = ArmResidualRegressor(ARM, orders=4).fit(0.1 * angles, y)
    assert not update_correction(few, *rows(60, 1)).findings_


def test_cones_name_the_joint_that_was_knocked():
    """It alone changes: at other cones nothing of the knock is left. Jitter changes nothing."""
    test = make_single_point(15, 20, random_state=7001)
    learnt, far = test.groups < 10, test.groups >= 13
    new = np.flatnonzero((test.groups >= 10) & ~far)[::2]
    X, y, groups = test.data, test.target, test.groups
    model = ArmResidualRegressor(test.arm).fit(X[learnt], y[learnt], groups=groups[learnt])

    def left(model, angles):
        rest = test.arm.forward(angles) - model.predict(angles)
        rest = position_residuals(rest[far], groups[far])
        return np.linalg.norm(rest, axis=1).mean()

    knocked = X + 30 * ARCSEC * np.eye(6)[3]
    shown = position_residuals(test.arm.forward(knocked[new]), groups[new])
    updated = update_correction(model, knocked[new], shown, groups=groups[new])
    assert list(updated.updates_[0]["tau"]) == ["offset of joint 4"]
    assert left(updated, knocked) < 1.1 * left(model, X) < 0.7 * left(model, knocked)
    noisy = X + np.random.default_rng(0).normal(0, 60 * ARCSEC, X.shape)
    shown = position_residuals(test.arm.forward(noisy[new]), groups[new])
    accepted = {"groups": groups[new], "accept": "strange-poses"}
    with pytest.warns(UserWarning, match="scatter by"):
        updated = update_correction(model, noisy[new], shown, **accepted)
    assert updated.updates_[0]["tau"] == {}
    assert left(updated, X) < 1.1 * left(model, X)


def test_a_jitter_that_is_barely_likelier_a_change_changes_nothing():
    """Of 40 jitters of this arm these four were, by a nat: updated by the third it left 6 times."""
    test = make_single_point(21, 20, random_state=7015)
    learnt = test.groups < 10
    new = np.flatnonzero((test.groups >= 10) & (test.groups < 13)).reshape(3, -1)[:, :10].ravel()
    X, groups = test.data, test.groups
    arm = calibrate(test.nominal_arm, X[learnt], groups[learnt]).arm
    y = position_residuals(arm.forward(X[learnt]), groups[learnt])
    model = ArmResidualRegressor(arm).fit(X[learnt], y, groups=groups[learnt])
    for seed in (3, 11, 15, 17):
        noisy = X[new] + np.random.default_rng([32, seed]).normal(0, 60 * ARCSEC, X[new].shape)
        shown = position_residuals(arm.forward(noisy), groups[new])
        given = {"groups": groups[new], "accept": "strange-poses"}
        with pytest.warns(UserWarning, match="scatter by"):
            updated = update_correction(model, noisy, shown, **given)
        assert updated.updates_[0]["tau"] == {}


def test_explanations_of_the_same_rows_share_their_covariance(model, monkeypatch):
    made = []

    class Counted(_update._Spread):
        def __init__(self, expected, *more):
            made.append((expected.rows.X.tobytes(), *more))
            super().__init__(expected, *more)

    monkeypatch.setattr(_update, "_Spread", Counted)
    angles, y = rows(60, 1)
    with pytest.raises(ValueError, match="sign"):
        update_correction(model, angles, -y)
    assert 0 < len(made) == len(set(made))


@pytest.mark.parametrize("arcsec", [200, pytest.param(600, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("joint", [2, pytest.param(4, marks=pytest.mark.exhaustive)])
def test_a_hard_knock_of_one_joint_makes_no_other_arm_of_it(model, joint, arcsec):
    """Before a tracker and in cones: as a change of all parts it would be larger than an arm's."""
    angles, y = rows(60, 1)
    far, _ = rows(300, 2)

    def knock(angles):
        return ARM.jacobian(angles)[:, :, joint - 1] * arcsec * ARCSEC

    updated = update_correction(model, angles, y + knock(angles))
    assert not updated.findings_
    off = np.linalg.norm(errors(far) + knock(far) - updated.predict(far), axis=1).mean()
    assert off < 0.03 * np.linalg.norm(knock(far), axis=1).mean()
    test = make_single_point(11, 20, random_state=400)
    X, learnt = test.data + arcsec * ARCSEC * np.eye(6)[joint - 1], test.groups < 8
    of_cones = ArmResidualRegressor(test.arm, orders=8)
    of_cones.fit(test.data[learnt], test.target[learnt], groups=test.groups[learnt])
    shown = position_residuals(test.arm.forward(X[~learnt]), test.groups[~learnt])
    given = {"groups": test.groups[~learnt]}
    assert not update_correction(of_cones, X[~learnt], shown, **given).findings_


def test_a_change_without_a_column_of_its_own_is_learned_by_others():
    """A model of wobble alone has no offsets of joints: its other columns take up what they can."""
    model = ArmResidualRegressor(ARM, orders=4, causes=["wobble"]).fit(*rows(500, 0))
    angles, y = rows(60, 1)
    knock = ARM.jacobian(angles)[:, :, 3] * 10 * ARCSEC
    updated = update_correction(model, angles, y + knock)
    other, _ = rows(400, 2)
    truth = errors(other) + ARM.jacobian(other)[:, :, 3] * 10 * ARCSEC
    off = [np.linalg.norm(truth - one.predict(other), axis=1).mean() for one in (model, updated)]
    assert off[1] < 0.95 * off[0]
