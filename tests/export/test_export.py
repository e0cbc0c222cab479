"""C99: the compiled model is the model, and the text cannot be anything but that."""

import copy
import ctypes
import os
import re
import subprocess
import warnings
from dataclasses import replace

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.kernel_ridge import KernelRidge
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from sklearn_raacmm import Arm, CylindricalResidualTarget, PoseFeatures, RBFNetRegressor
from sklearn_raacmm.export import describe, export_c, fingerprint
from sklearn_raacmm.export._load_c import answers_in_c
from sklearn_raacmm.export._models import build_program

from ._chains import (
    COMPILERS,
    STRICT,
    angles_everywhere,
    form_a,
    form_b,
    library,
    needs_compiler,
    network,
    no_azimuth,
    of_arm,
    ways_out,
)

# Chains are fitted without groups: what they learn is not the question here.
pytestmark = pytest.mark.filterwarnings("ignore:No groups were given")

C99 = ["-std=c99", "-O1", *STRICT]
AACMM = Arm.from_name("aacmm6")


def compiled(model, X, std=False, dtype="double"):
    """What the compiled source gives: y, and where they exist point and std."""
    return answers_in_c(build_program(model, std), dtype, X)


@pytest.fixture(scope="module")
def small(data):
    return network(n_centers=3).fit(data.data, data.target)


def rounding(net, features):
    """What 64-bit arithmetic can promise: a share of the largest sum of terms without signs."""
    if not hasattr(net, "kernel"):
        return 1e-12
    terms = [(np.abs(part.radial(features)) @ np.abs(part.coef)).max() for part in net.networks_]
    return 1e-12 + 1e-13 * max(terms)


@pytest.mark.parametrize(
    ("form", "joints", "encoding"), [(form_a, "pose", "angle"), (form_b, "all", "periodic")]
)
def test_every_way_out_agrees_with_predict(tmp_path, data, form, joints, encoding):
    net = RBFNetRegressor(random_state=0)
    model = form(data.arm, net=net, joints=joints, encoding=encoding).fit(data.data, data.target)
    X = np.concatenate([data.data, angles_everywhere(6)])
    expected = model.predict(X)
    assert np.ptp(expected, axis=0).min() > 0.01
    for way, found, _ in ways_out(tmp_path, model, X):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12, err_msg=way)
    # A coordinate of a metre is rounded to 1e-13 at every joint.
    points = build_program(model).run(X)["point"]
    np.testing.assert_allclose(points, data.arm.forward(X) - expected, rtol=0, atol=5e-12)


# Each kernel, and each degree of the polynomial, once.
KINDS = [("gaussian", -1), ("matern52", 0), ("matern32", 1), ("matern12", 0)]
KINDS += [pytest.param(k, 0, marks=pytest.mark.exhaustive) for k in ("gaussian", "matern32")]


@pytest.mark.parametrize(("kernel", "degree"), KINDS)
def test_every_kernel_and_tail(tmp_path, data, kernel, degree):
    net = network(kernel=kernel, degree=degree)
    model = form_b(data.arm, net=net, encoding="periodic").fit(data.data, data.target)
    X = np.concatenate([data.data, angles_everywhere(6)])
    mean, std = model.predict(X, return_std=True)
    inner = model[-1].regressor_
    atol = rounding(inner[-1], inner[0].transform(model[0].transform(X)[:, :-2]))
    for way, found, deviations in ways_out(tmp_path, model, X, std=True):
        np.testing.assert_allclose(found, mean, rtol=0, atol=atol, err_msg=way)
        np.testing.assert_allclose(deviations, std, rtol=1e-3, err_msg=way)


ALONE = [
    network(),
    network(inputs="ranks", length_scale=0.5),
    LinearRegression(fit_intercept=False),
    make_pipeline(StandardScaler(), Ridge()),
]


@pytest.mark.parametrize("model", ALONE, ids=str)
def test_without_an_arm(tmp_path, model):
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (60, 4))
    X[:, 2] = 5.0  # does not vary
    Y = np.stack([np.sin(X[:, 0]), X[:, 1] * X[:, 3]], axis=1)
    new = np.concatenate([X[:5], rng.uniform(-4, 4, (100, 4))])
    for y in (Y, Y[:, 0]):
        expected = model.fit(X, y).predict(new).reshape(len(new), -1)
        for way, found, _ in ways_out(tmp_path, model, new):
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12, err_msg=way)


@needs_compiler
def test_a_network_without_centres_is_its_constant(data):
    flat = np.tile([0.1, -0.2, 0.05], (len(data.data), 1))
    inner = make_pipeline(PoseFeatures(data.arm), RBFNetRegressor())
    model = CylindricalResidualTarget(inner, azimuth=None).fit(data.data, flat)
    assert len(model.regressor_[-1].centers_) == 0
    found = compiled(model, np.concatenate([data.data, np.full((1, 6), np.nan)]), std=True)
    np.testing.assert_allclose(found["y"][:-1], flat, atol=1e-15)
    expected = model.predict(data.data, return_std=True)[1]
    np.testing.assert_allclose(found["std"][:-1], expected, atol=1e-12)
    assert np.isnan(found["y"][-1]).all()


@needs_compiler
def test_single_precision_is_good_to_its_digits(data, chain):
    X = np.concatenate([data.data, angles_everywhere(6)[:300]]).astype(np.float32)
    exact = X.astype(float)
    found, expected = compiled(chain, X, dtype="float"), chain.predict(exact)
    np.testing.assert_allclose(found["y"], expected, rtol=0, atol=2e-5)
    points = data.arm.forward(exact) - expected
    np.testing.assert_allclose(found["point"], points, rtol=0, atol=3e-3)


@pytest.mark.parametrize(("form", "kernel"), [(form_a, "gaussian"), (form_b, "matern52")])
def test_refuses_with_nan_what_predict_refuses(tmp_path, data, form, kernel):
    """Infinity, too, where a radial function of it is 0."""
    model = form(data.arm, net=network(kernel=kernel)).fit(data.data, data.target)
    X = np.tile(data.data[:1], (18, 1))
    # Joints 1, 5 and 6 are no part of the pose.
    X[np.arange(18), np.arange(18) % 6] = np.repeat([np.nan, np.inf, -1.1e50], 6)
    with pytest.raises(ValueError, match=r"NaN|infinity"):
        model.predict(X)
    for way, *found in ways_out(tmp_path, model, X, std=True):
        assert np.isnan(found).all(), way


@pytest.mark.parametrize("what", ["base axis", "theta_dis is undefined"])
def test_poses_where_the_model_is_not_defined(tmp_path, what):
    """A probe on the axis of the base has no azimuth, a wrist at the shoulder no elevation."""
    if what == "base axis":
        arm = Arm(a=[300, 300], alpha=[0, 0], d=[100, 0], pose_joints=(1, 2), pose_frames=(0, 1))
        form, pose = form_b, np.array([[0.0, np.pi]])
    else:
        arm = Arm(
            a=[0, 300, 300], alpha=[np.pi / 2, 0, 0], d=[100, 0, 0],
            pose_joints=(2, 3), pose_frames=(1, 3), probe=(0, 50, 0),
        )  # fmt: skip
        form, pose = form_a, np.array([[0.3, 0.2, np.pi]])
    rng = np.random.default_rng(0)
    model = form(arm).fit(rng.uniform(-1, 1, (40, arm.n_joints)), rng.normal(size=(40, 3)))
    with pytest.raises(ValueError, match=what):
        model.predict(pose)
    for way, found, _ in ways_out(tmp_path, model, pose):
        assert np.isnan(found).all(), way


def test_a_direction_that_is_given_is_checked(tmp_path):
    rng = np.random.default_rng(0)
    phi = rng.uniform(-3, 3, 50)
    X = np.column_stack([rng.normal(size=(50, 2)), np.cos(phi), np.sin(phi)])
    model = CylindricalResidualTarget(network()).fit(X, rng.normal(size=(50, 3)))
    expected = model.predict(X)
    X[0, 2:] *= 1.001
    with pytest.raises(ValueError, match="norm"):
        model.predict(X)
    expected[0] = np.nan
    for way, found, _ in ways_out(tmp_path, model, X):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12, err_msg=way)


@pytest.mark.parametrize("compiler", COMPILERS)
def test_compiles_as_cpp(tmp_path, data, chain, compiler):
    """It has its own rules on constants and names; the functions keep their C names."""
    both = of_arm(data.arm, "kinematics", "wobble", orders=2).fit(data.data, data.target)
    for model in (chain, both):
        source, _ = export_c(model, tmp_path / "arm.c", std=True)
        command = [compiler, "-x", "c++", *STRICT, "-c", "-o", tmp_path / "arm.o", source]
        subprocess.run(command, check=True)
        names = subprocess.run(["nm", tmp_path / "arm.o"], capture_output=True, check=True).stdout
        assert b" T arm_correct_std\n" in names


@needs_compiler
def test_two_models_in_one_program(data, tmp_path):
    """Words of the language are prefixes as good as others."""
    first = form_a(data.arm).fit(data.data, data.target)
    second = form_b(data.arm, joints="all").fit(data.data, data.target)
    sources = [export_c(m, tmp_path / f"{n}.c")[0] for m, n in ((first, "class"), (second, "int"))]
    out, q = tmp_path / "both.so", np.array([0.1, 1, 0.3, 1.2, 0.5, 0.6])
    subprocess.run([COMPILERS[0], *C99, "-shared", "-fPIC", "-o", out, *sources, "-lm"], check=True)
    both, got, place = ctypes.CDLL(out), np.empty((2, 3)), ctypes.c_void_p
    both.class_correct(place(q.ctypes.data), place(got[0].ctypes.data))
    both.int_correct(place(q.ctypes.data), place(got[1].ctypes.data))
    expected = [model.predict(q[None])[0] for model in (first, second)]
    np.testing.assert_allclose(got, expected, atol=1e-12)


# -- the text ------------------------------------------------------------------------------------


def test_fingerprint_and_bytes_follow_what_is_computed(data, chain, tmp_path):
    digest = fingerprint(chain)
    assert re.fullmatch("[0-9a-f]{64}", digest)
    header = export_c(chain, tmp_path / "arm.c", std=True, dtype="float", card="note")[1]
    assert f'#define ARM_FINGERPRINT "{digest}"' in header.read_text()
    renamed = clone(chain).set_params(posefeatures__arm=data.arm.replace(name="other"))
    assert fingerprint(renamed.fit(data.data, data.target)) == digest
    arm = data.arm.replace(d=data.arm.d + np.eye(6)[5] * 1e-9)
    moved = clone(chain).set_params(posefeatures__arm=arm).fit(data.data, data.target)
    assert fingerprint(moved) != digest
    again = clone(chain).fit(data.data, data.target)
    first, second = (
        [path.read_bytes() for path in export_c(model, tmp_path / "arm.c", std=True)]
        for model in (chain, again)
    )
    assert first == second
    assert b"\r" not in first[0]
    coef = again[-1].regressor_[-1].networks_[0].coef
    coef[0, 0] = np.nextafter(coef[0, 0], 1)
    assert fingerprint(again) != digest


def said_by(compiler, source, *flags):
    """What the compiler says of a file that it refuses; nothing of one that it takes."""
    command = [compiler, *C99, *flags, "-c", "-o", os.devnull, source]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode != 0) == bool(done.stderr)
    return done.stderr


@pytest.mark.parametrize("compiler", COMPILERS)
def test_files_of_two_exports_do_not_compile_together(chain, small, tmp_path, compiler):
    for name, model, params in (
        ("same", small, {}),
        ("other_model", chain, {}),
        ("other_type", small, {"dtype": "float"}),
        ("other_name", small, {"name": "leg"}),
        ("other_card", small, {"card": "note"}),
    ):
        source, header = export_c(small, tmp_path / "arm.c")
        folder = tmp_path / name
        folder.mkdir()
        _, other = export_c(model, folder / "arm.c", **params)
        header.write_bytes(other.read_bytes())  # the source stays: half of a copy
        said = said_by(compiler, source)
        assert ("arm.c and arm.h are of different exports" in said) == (name != "same")
        assert name != "same" or not said


@pytest.mark.parametrize("compiler", COMPILERS)
def test_fast_math_is_refused(small, tmp_path, compiler):
    source, _ = export_c(small, tmp_path / "arm.c")
    assert "-ffast-math takes away" in said_by(compiler, source, "-ffast-math")


def macros(header):
    lines = [line.split(maxsplit=2) for line in header.read_text().splitlines()]
    return {line[1]: line[2] for line in lines if line[:1] == ["#define"] and len(line) > 2}


def test_what_the_header_defines(data, tmp_path):
    model = form_b(data.arm, net=network(shared=True)).fit(data.data, data.target)
    header = export_c(model, tmp_path / "arm.c")[1]
    found = macros(header)
    assert found["ARM_FINGERPRINT"] == f'"{fingerprint(model)}"'
    assert (found["ARM_N_INPUTS"], found["ARM_N_OUTPUTS"]) == ("6", "3")
    assert (found["ARM_INPUT_UNIT"], found["ARM_OUTPUT_UNIT"]) == ('"rad"', '"mm"')
    assert (found["ARM_OK"], found["ARM_NOT_FINITE"]) == ("0", "2")
    # 20 centres of 3 features and 3 weights, and less than 100 numbers beside them.
    assert 0 <= int(found["ARM_TABLE_BYTES"]) - 8 * 24 * 6 < 1000
    half = macros(export_c(model, tmp_path / "arm.c", dtype="float")[1])
    assert 0.5 <= int(half["ARM_TABLE_BYTES"]) / int(found["ARM_TABLE_BYTES"]) < 0.6
    assert "functions of math.h: atan2, cos, exp, sin, sqrt\n" in header.read_text()


NASTY = '*/ int x; /* ??/ \\ \n#error é ü\r\0\u2028 "q" */'


def test_comments_hold_no_code(data, tmp_path):
    arm = data.arm.replace(name=NASTY)
    model = form_b(arm).fit(data.data, data.target)
    card = f"{NASTY}\n{'long ' * 100}\n{NASTY}"
    source, header = export_c(model, tmp_path / "a.c", card=card)
    assert not any(said_by(compiler, source) for compiler in COMPILERS)
    for path in (source, header):
        text = path.read_text(encoding="ascii")  # nothing else is in it
        assert "??" not in text.replace("? ?", "")
        assert "\\" not in text
        assert max(map(len, text.splitlines())) <= 110  # long facts are wrapped
        # Without comments, nothing of the name is left.
        code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
        assert "int x" not in code
        assert [line[:9] for line in code.splitlines() if "#error" in line] == (
            ['#error "a', '#error "-'] if path is source else []  # our own
        )


# -- what cannot be exported ---------------------------------------------------------------------


def test_names_the_step_that_cannot_be_exported(data, tmp_path):
    X, y = data.data, data.target
    arm = data.arm

    def refused(model, X=X):
        with pytest.raises(ValueError) as error:  # the message is what is tested
            export_c(model.fit(X, y), tmp_path / "arm.c")
        assert not list(tmp_path.iterdir())
        return str(error.value)

    message = refused(form_b(arm, net=KernelRidge()))
    assert "kernelridge is a KernelRidge" in message
    assert "RBFNetRegressor" in message
    assert "polynomialfeatures" in refused(form_a(arm, scaler=PolynomialFeatures()))
    scaled = make_pipeline(StandardScaler(), PoseFeatures(arm), network())
    assert "posefeatures comes after another transformer" in refused(scaled)
    behind = CylindricalResidualTarget(network(), azimuth=arm.azimuth)
    assert "comes after another transformer" in refused(make_pipeline(StandardScaler(), behind))
    free = form_a(arm).set_params(azimuth=no_azimuth)
    assert "only the method of an Arm" in refused(free)
    mixed = form_a(arm).set_params(azimuth=AACMM.azimuth)
    assert "different arms" in refused(mixed)
    mixed = form_a(arm, angle_unit="deg")
    with pytest.warns(UserWarning, match="if they are radians"):
        assert "different angle units" in refused(mixed)
    ridge = form_b(arm, net=Ridge()).fit(X, y)
    with pytest.raises(ValueError, match="ridge is a Ridge, which has no standard deviation"):
        export_c(ridge, tmp_path / "arm.c", std=True)


def test_a_number_that_is_no_float_is_refused(small, tmp_path):
    large = copy.deepcopy(small)
    large.networks_[0].coef[0, 0] = 1e300
    with pytest.raises(ValueError, match=r"1e\+300.*not a finite float"):
        export_c(large, tmp_path / "arm.c", dtype="float")
    assert not list(tmp_path.iterdir())


# -- the arm's own error model --------------------------------------------------------------------


@pytest.fixture(autouse=True)
def _far_away():
    """Poses everywhere, which the models warn of."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*poses lie where the model knows little")
        yield


def agree(model, X, std=True):
    """Compare with predict to a share of the terms' size: coefficients may nearly cancel."""
    mean, deviations = model.predict(X, return_std=True)
    linear, found = model.linear_model_, compiled(model, X, std)
    terms = np.abs(linear.columns(X)) @ np.abs(linear.coef)
    atol = 1e-12 + 1e-13 * terms.max()
    np.testing.assert_allclose(found["y"], mean, rtol=0, atol=atol)
    points = linear.arm.forward(X) - mean
    np.testing.assert_allclose(found["point"], points, rtol=0, atol=5e-12 + atol)
    if std:
        # To rounding where the correction depends on it.
        rtol = 1e-3 if model.fading_.factor == 0 else 1e-6
        np.testing.assert_allclose(found["std"], deviations, rtol=rtol, atol=1e-12)


@needs_compiler
@pytest.mark.parametrize(
    "fade", [0.5, *(pytest.param(fade, marks=pytest.mark.exhaustive) for fade in (0.0, 2.0))]
)
def test_fading(data, fade):
    model = of_arm(data.arm, "kinematics", "wobble", orders=2, fade=fade)
    model.fit(data.data, data.target)
    X = np.concatenate([data.data, angles_everywhere(6, 100)])
    agree(model, X)
    agree(model, X, std=False)
    bad = np.where(np.eye(6), [np.nan, np.inf, -np.inf, 1.1e50, -1e60, 1.8e308], data.data[0])
    found = compiled(model, bad)
    assert np.isnan([found["y"], found["point"]]).all()
    model.fading_ = replace(model.fading_, most=0.5, known_mm=model.fading_.size_mm)
    agree(model, X)
    near_mm = np.median(model.linear_model_.predict_with_doubt(X)[2])
    model.fading_ = replace(model.fading_, far=0.3, near_mm=near_mm)
    agree(model, X)
    model.fading_ = replace(model.fading_, most=0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        agree(model, data.data)
    with pytest.warns(UserWarning, match="The correction is 0"):
        found = model.predict(data.data)
    assert not np.any(found)


@needs_compiler
@pytest.mark.parametrize("std", [False, True])
def test_c_says_which_poses_the_model_does_not_know(data, tmp_path, std):
    model = of_arm(data.arm, "kinematics", "wobble", orders=2, fade=2.0)
    model.fit(data.data, data.target)
    X = np.concatenate([data.data, angles_everywhere(6, 50), np.full((1, 6), np.nan)])
    source, _ = export_c(model, tmp_path / "arm.c", std=std, fade="exact")
    loaded, place = library(tmp_path, COMPILERS[0], source), ctypes.c_void_p
    loaded.arm_trust.restype = ctypes.c_double
    out, given = np.empty_like(X[:, :3]), [place(row.ctypes.data) for row in X]
    trust = np.array([loaded.arm_trust(row) for row in given])
    status = [loaded.arm_correct(row, place(out.ctypes.data)) for row in given]
    of_all = (place(X.ctypes.data), place(out.ctypes.data), ctypes.c_size_t(len(X)))
    assert loaded.arm_correct_n(*of_all) == 2  # the largest
    # What is left, by the formula of the documentation and what Python has.
    deviation = model.linear_model_.predict(X[:-1], return_std=True)[1]
    size = model.fading_.size_mm**2
    expected = size / (size + 4.0 * np.sum(deviation**2, axis=1))
    np.testing.assert_allclose(trust[:-1], expected, rtol=1e-6)
    assert np.isnan(trust[-1])
    np.testing.assert_array_equal(status, [*np.where(expected < 0.5, 1, 0), 2])
    assert 0 < np.mean(expected < 0.5) < 1


@needs_compiler
def test_a_joint_model_in_the_frame_of_the_azimuth(data):
    model = CylindricalResidualTarget(of_arm(data.arm, "kinematics"), azimuth=data.arm.azimuth)
    # The arm's own columns stand in its base frame: turned by the azimuth y are not of its points.
    with pytest.warns(UserWarning, match="not the deviations of the arm's own points"):
        model.fit(data.data, data.target)
    found = compiled(model, data.data)["y"]
    np.testing.assert_allclose(found, model.predict(data.data), rtol=0, atol=1e-12)
    behind = make_pipeline(StandardScaler(), of_arm(data.arm, "kinematics"))
    with pytest.raises(ValueError, match=r"armresidualregressor comes after another transformer"):
        build_program(behind.fit(data.data, data.target))


def test_a_chain_without_a_step_gets_a_sentence(tmp_path):
    nothing = make_pipeline("passthrough").fit(np.ones((4, 3)))
    with pytest.raises(ValueError, match="no step that computes anything"):
        export_c(nothing, tmp_path / "nothing.c")


@needs_compiler
def test_a_model_of_zero_terms(data, tmp_path):
    """Nothing is found in noise, and nothing is what is written."""
    rng = np.random.default_rng(0)
    y = 1e-3 * rng.normal(size=data.target.shape)
    model = of_arm(data.arm, orders=[50]).fit(data.data, y)
    assert len(model.coef_) == 0
    card = describe(model, data.data, y)
    header = export_c(model, tmp_path / "arm.c", std=True, card=card)[1].read_text()
    assert fingerprint(model) in header
    found = compiled(model, data.data, std=True)
    assert not np.any([found["y"], found["std"]])
    np.testing.assert_allclose(found["point"], data.arm.forward(data.data), atol=1e-11)
