"""Models that were updated, registered or take degrees: every way out of Python."""

import pickle
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from sklearn_raacmm import Arm, ArmResidualRegressor, RBFNetRegressor, update_correction
from sklearn_raacmm.error_model import Terms
from sklearn_raacmm.error_model._columns import columns_of
from sklearn_raacmm.export import describe, export_c, to_onnx
from sklearn_raacmm.export._models import build_program

from ._chains import COMPILERS, STRICT, ways_out

ARM = Arm.from_name("aacmm6")
pytestmark = pytest.mark.filterwarnings("ignore:.*poses lie where the model knows little")


def residuals(angles, arcsec):
    """Of an arm whose encoder 3 is eccentric."""
    error = np.zeros_like(angles)
    error[:, 2] = np.deg2rad(arcsec / 3600) * np.cos(angles[:, 2])
    return np.einsum("nij,nj->ni", ARM.jacobian(angles), error)


def linear(**params):
    return ArmResidualRegressor(ARM, orders=2, causes=["kinematics"], **params)


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (200, 6))
    return X, residuals(X, 20) + rng.normal(scale=0.01, size=(len(X), 3))


@pytest.fixture(scope="module")
def new():
    rng = np.random.default_rng(1)
    X = rng.uniform(-2, 2, (40, 6))
    return X, residuals(X, 40) + rng.normal(scale=0.01, size=(len(X), 3))


def agree(model, X, folder):
    expected = model.predict(X)
    assert np.ptp(expected, axis=0).min() > 1e-3
    for way, found, _ in ways_out(folder, model, X):
        np.testing.assert_allclose(found, expected, rtol=0, atol=2e-12, err_msg=way)


EXTRA = (
    "temperature", "force x", "force z", "payload", "direction 2", "temperature 3", "base height",
)  # fmt: skip


@pytest.fixture(scope="module")
def with_extra(data):
    """Angles with what was written down beside them, and residuals that depend on all of it."""
    X, y = data
    rng = np.random.default_rng(2)
    values = [
        rng.normal(20, 3, len(X)), rng.normal(0, 2, len(X)), rng.choice([1.0, 2.0, 5.0], len(X)),
        rng.uniform(0, 4, len(X)), rng.choice([-1.0, 1.0], len(X)), rng.normal(30, 5, len(X)),
        rng.uniform(300, 900, len(X)),
    ]  # fmt: skip
    X = np.column_stack([X, *values])
    terms = Terms(np.empty((0, 2), int), False, False, False, with_references(EXTRA, X[:, 6:]))
    columns = columns_of(ARM, terms).at(X)
    return X, y + columns @ rng.normal(0, 5, columns.shape[2])


def with_references(names, values):
    """What a model keeps of extra columns: the mean."""
    return tuple(zip(names, ((mean,) for mean in values.mean(axis=0)), strict=True))


def test_extra_columns_in_header_and_card(with_extra, tmp_path):
    X, y = with_extra
    model = linear(extra=EXTRA, angle_unit="deg")
    X = np.column_stack([np.rad2deg(X[:, :6]), X[:, 6:]])
    model.fit(X, y)
    card = describe(model, X, y)
    assert card["input"].startswith("6 joint angles in deg, then temperature, then force x")
    low, high = card["training"]["range_of_payload"]
    assert 0 <= low < 0.5 < 3.5 < high <= 4
    assert len(card["training"]["largest_joint_angles_deg"]) == 6
    header = export_c(model, tmp_path / "arm.c", card=card, poses=X)[1].read_text()
    assert "then temperature, force x, force z, payload, direction 2, temperature 3, b" in header
    assert "#define ARM_N_INPUTS 13\n" in header
    assert '#define ARM_INPUT_UNIT "deg"' in header
    assert "6 joints, standard DH" in header
    if not COMPILERS:
        pytest.skip("neither gcc nor clang is on PATH")
    command = [COMPILERS[0], "-std=c99", *STRICT, "-o", "t", "arm_test.c", "arm.c", "-lm"]
    assert subprocess.run(command, cwd=tmp_path, check=False).returncode == 0
    assert subprocess.run(["./t"], cwd=tmp_path, check=False).returncode == 0


def test_extra_columns_updated(with_extra, tmp_path):
    X, y = with_extra
    model = linear(extra=EXTRA).fit(X[:150], y[:150])
    assert len(model.linear_model_.terms.extra) == 7
    updated = update_correction(model, X[150:], 1.3 * y[150:], date="2026-01-02")
    updated = update_correction(updated, X[150:], 1.3 * y[150:], date="2026-02-03")
    assert np.abs(updated.predict(X) - model.predict(X)).max() > 0.01
    agree(updated, X[:40], tmp_path)
    assert_same_files(updated, X[:40])
    assert [entry["n_poses"] for entry in describe(updated, X, y)["updates"]] == [50, 50]


def assert_same_files(model, X):
    """Pickle gives back the same numbers and the same history, the program the same deviation."""
    again = pickle.loads(pickle.dumps(model))
    assert getattr(again, "updates_", ()) == getattr(model, "updates_", ())
    mean, std = model.predict(X, return_std=True)
    np.testing.assert_array_equal(again.predict(X, return_std=True), (mean, std))
    np.testing.assert_allclose(build_program(model, std=True).run(X)["std"], std, rtol=1e-9)


def test_a_registered_arm(data, tmp_path):
    """Another base and tool: the same model on the arm that the registration found."""
    model = linear().fit(*data)
    arm = ARM.replace(d=ARM.d + np.array([0.3, 0, 0, 0, 0, 0.1]), probe=(0.2, -0.1, 5.0))
    layout = columns_of(arm, model.linear_model_.terms)
    model.arm, model.linear_model_ = arm, replace(model.linear_model_, layout=layout)
    agree(model, data[0][:30], tmp_path)


def test_the_card_of_an_updated_model(data, new):
    X, y = new
    updated = update_correction(linear().fit(*data), X, y, date="2026-01-02")
    groups = np.arange(len(X)) // 5
    card = describe(updated, X, y, groups)
    (entry,) = card["updates"]
    assert (entry["date"], entry["n_poses"]) == ("2026-01-02", 40)
    text = str(card)
    assert "## updates\n\n- date: 2026-01-02; n poses: 40; tau: " in text
    assert "updates" not in describe(linear().fit(X, y), X, y, groups)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_tables_that_are_not_finite_are_refused(data, tmp_path, bad):
    pytest.importorskip("onnx", reason="needs the extra onnx")
    net = RBFNetRegressor(10, length_scale=1.5, alpha=0.05).fit(*data)
    model = linear().fit(*data)
    model.linear_model_.coef[3] = net.networks_[0].coef[3, 0] = bad
    for one in (model, net):
        with pytest.raises(ValueError, match=r"holds NaN or infinity, .* not finite, among the"):
            export_c(one, tmp_path / "arm.c")
        with pytest.raises(ValueError, match="holds NaN or infinity"):
            to_onnx(one, tmp_path / "arm.onnx")
    assert not list(tmp_path.iterdir())


def test_a_network_whose_centres_are_all_rows(tmp_path):
    rng = np.random.default_rng(0)
    X, new = rng.uniform(-1, 1, (150, 3)), rng.uniform(-1.3, 1.3, (40, 3))
    y = np.column_stack([np.sin(5 * X).sum(axis=1), np.cos(4 * X[:, 0]) + X[:, 1]])
    y += 0.1 * rng.standard_normal(y.shape)
    model = RBFNetRegressor(length_scale=0.5, alpha=[0.02, 0.03], degree=1).fit(X, y)
    assert all(network.all_rows for network in model.networks_)
    agree(model, new, tmp_path)
    assert_same_files(model, new)


def fitted(groups=None, **params):
    rng = np.random.default_rng(0)
    angles = rng.uniform(-2, 2, (200, 6))
    X = np.column_stack([angles, *[rng.normal(size=200) for _ in params.get("extra", ())]])
    y = np.einsum("nij,nj->ni", ARM.jacobian(angles), 1e-4 * np.cos(angles))
    y += rng.normal(0, 0.005, y.shape)
    return ArmResidualRegressor(ARM, orders=5, **params).fit(X, y, groups=groups)


@pytest.mark.parametrize("params", [
    {}, {"offsets": True}, {"extra": ["payload", "direction 2"]}, {"causes": []},
])  # fmt: skip
def test_a_moved_probe_is_exported_anew(params):
    """Also one that is shorter."""
    model = fitted(np.repeat(np.arange(10), 20) if "offsets" in params else None, **params)
    rng = np.random.default_rng(1)
    for probe in ((0, 0, 400), (30, -20, 60)):
        X = rng.uniform(-3, 3, (20, 6 + len(params.get("extra", ()))))
        moved = model.with_arm(ARM.replace(probe=probe))
        found = build_program(moved, std=True).run(X)
        mean, std = moved.predict(X, return_std=True)
        np.testing.assert_allclose(found["y"], mean, atol=1e-9)
        np.testing.assert_allclose(found["std"], std, rtol=1e-6)
        np.testing.assert_allclose(found["point"], moved.correct(X), atol=1e-9)


@pytest.mark.parametrize("found", [False, True])
def test_an_arm_that_leans(with_extra, tmp_path, found):
    """Weights of arm and payload pull along the vertical, stated or found by the data."""
    X, y = with_extra
    leaning = ARM.replace(up=(0.3, -0.5, 0.8))
    arm = ARM if found else leaning
    model = ArmResidualRegressor(arm, orders=1, causes=["gravity"], extra=EXTRA, fade=0).fit(X, y)
    if found:
        linear = model.linear_model_
        terms = linear.terms._replace(up=tuple(leaning.up.tolist()))
        model.linear_model_ = replace(linear, layout=columns_of(arm, terms))
        assert not np.allclose(model.predict(X), linear.predict(X)[0])
    agree(model, X[:30], tmp_path)
