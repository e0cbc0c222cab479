"""A correction that fades by small tables: nearly as in ``predict``, from far fewer numbers."""

import subprocess

import numpy as np
import pytest

from sklearn_raacmm import ArmResidualRegressor
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.export import _small_doubt, export_c, fingerprint, load_c, to_onnx
from sklearn_raacmm.export._models import build_program
from sklearn_raacmm.export._small_doubt import in_16_bits

from ._chains import COMPILERS, angles_everywhere, needs_compiler, of_arm


def fitted(mix, **params):
    data = make_single_point(n_positions=10, n_poses=30, machine=mix, random_state=3)
    model = of_arm(data.arm, "gravity", "kinematics", "wobble", **params)
    unit = np.rad2deg if params.get("angle_unit") == "deg" else np.array
    return model.fit(unit(data.data), data.target, groups=data.groups), unit(data.data)


@pytest.fixture(scope="module")
def models():
    return {
        "typical": fitted("typical"),
        "degrees": fitted("gravity", angle_unit="deg"),
    }


def poses(model, X):
    rows = angles_everywhere(6, 500)[:1500]
    return np.concatenate([X, np.rad2deg(rows) if model.angle_unit == "deg" else rows])


def numbers(program):
    return sum(np.size(v) for op in program.ops if op.name == "variances" for v in op.given["root"])


@pytest.mark.parametrize(
    ("name", "many"),
    [
        ("degrees", 24),
        ("typical", 4),
        pytest.param("typical", 24, marks=pytest.mark.exhaustive),
        pytest.param("degrees", 4, marks=pytest.mark.exhaustive),
    ],
)
def test_the_share_is_nearly_that_of_predict(models, monkeypatch, name, many):
    """By the formula of the documentation, at poses that took no part in the choice.

    With `many` 4, all waves of a joint about an axis add a function of that joint, as in models of
    high orders.
    """
    monkeypatch.setattr(_small_doubt, "_MANY", many)
    model, X = models[name]
    rows = poses(model, X)
    rad = np.deg2rad(rows) if model.angle_unit == "deg" else rows
    linear, fading = model.linear_model_, model.fading_
    doubt = np.square(linear.columns(rad) @ linear.fading_half).sum(axis=(1, 2))
    size = fading.size_mm**2
    expected = size / (size + fading.factor**2 * np.maximum(doubt - fading.known_mm**2, 0.0))
    small, exact = build_program(model, fade="small"), build_program(model)
    found = small.run(rows)["trust"][:, 0]
    np.testing.assert_allclose(exact.run(rows)["trust"][:, 0], expected, rtol=1e-9)
    np.testing.assert_allclose(found, expected, rtol=0, atol=0.02)
    assert np.ptp(expected) > 0.2
    assert numbers(small) < 0.5 * numbers(exact)
    # A series has the squares of its waves, of twice their order.
    most = max(np.abs(op.given["order"]).max() for op in small.ops if op.name == "waves")
    assert (most > linear.layout.table["order"].max()) == (many == 4)


def test_16_bits_a_number_are_taken_where_deviations_do_not_feel_it(models):
    """Not of this arm, whose lengths and zeros are known together only, and nearly cancel."""
    model, X = models["typical"]
    std = model.predict(X, return_std=True)[1]
    program = build_program(model, std=True, fade="small")
    root = max((op.given["root"] for op in program.ops if op.name == "variances"), key=np.size)
    assert root.dtype == np.float32
    np.testing.assert_allclose(program.run(X)["std"], std, rtol=3e-4)
    columns = model.linear_model_.columns(X)
    columns, others = (part.reshape(3 * len(part), -1) for part in (columns[::2], columns[1::2]))
    half = model.linear_model_.gauge_free_half
    assert in_16_bits(half, columns, others)[1] is None
    waves = slice(model.linear_model_.layout.n_waves)
    half, columns, others = half[waves], columns[:, waves], others[:, waves]
    whole, unit = in_16_bits(half, columns, others)
    exact = np.linalg.norm(columns @ half, axis=1)
    found = np.linalg.norm((columns * unit) @ whole, axis=1)
    np.testing.assert_allclose(found, exact, rtol=5e-4)


def test_rounding_of_columns_that_go_together_is_made_good():
    rng = np.random.default_rng(0)
    root = np.tril(rng.normal(size=(60, 60)))
    few = rng.normal(size=(10, 60))
    others, columns = (rng.normal(size=(n, 10)) @ few for n in (300, 200))
    whole, unit = in_16_bits(root, columns, others)
    assert np.all(np.triu(whole, 1) == 0)
    off, plain = (
        np.linalg.norm(columns @ (numbers * unit[:, None] - root))
        for numbers in (whole, np.rint(root / unit[:, None]))
    )
    assert off < 0.5 * plain


@needs_compiler
def test_every_file_gives_what_the_small_program_gives(models, tmp_path):
    onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")
    model, X = models["degrees"]
    rows = poses(model, X)
    expected = build_program(model, fade="small").run(rows)["y"]
    # C multiplies tables of the doubt in single precision.
    atol = 1e-5 * np.abs(expected).max()
    found = load_c(model).predict(rows)
    np.testing.assert_allclose(found, expected, rtol=0, atol=atol)
    session = onnxruntime.InferenceSession(to_onnx(model).SerializeToString())
    np.testing.assert_allclose(session.run(None, {"X": rows})[0], expected, rtol=0, atol=atol)
    source, header = export_c(model, tmp_path / "arm.c", poses=X)
    assert "fade small: the share of the correction is within" in header.read_text()
    whole = export_c(model, tmp_path / "exact.c", fade="exact")[0]
    assert source.stat().st_size < 0.7 * whole.stat().st_size
    assert fingerprint(model) in header.read_text()


@needs_compiler
def test_sums_of_single_precision_are_no_reason_to_refuse_a_file(tmp_path):
    """Of this arm they are 1.6e-5 of the largest correction off; the test program knows it, too."""
    data = make_single_point(n_positions=8, n_poses=15, random_state=11)
    model = ArmResidualRegressor(data.arm).fit(data.data, data.target, groups=data.groups)
    _, header = export_c(model, tmp_path / "arm.c", poses="random")
    told = header.read_text()
    assert "tables summed in double precision, at 32 rows" in " ".join(told.split("\n *"))
    assert "of predict, at 32 rows" not in told  # predict itself is as near as the share says
    program = [COMPILERS[0], "-std=c99", "-O2", *tmp_path.glob("*.c"), "-lm", "-o", tmp_path / "t"]
    subprocess.run(program, check=True)
    assert b"0 of 96 numbers differ" in subprocess.run([tmp_path / "t"], stdout=-1).stdout


@needs_compiler
def test_nothing_fades_where_that_is_asked_for(models, tmp_path):
    model, X = models["typical"]
    rows = poses(model, X)
    expected = model.fading_.most * model.linear_model_.predict(rows)[0]
    compiled = load_c(model, fade=False)
    np.testing.assert_allclose(compiled.predict(rows), expected, rtol=0, atol=1e-12)
    header = export_c(model, tmp_path / "arm.c", fade=False)[1].read_text()
    assert "nothing fades" in header
    assert "arm_trust" not in header
