"""JSON: the same predictions in any language, and nothing else than what was written."""

import json
import runpy
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from sklearn.exceptions import NotFittedError
from sklearn.kernel_ridge import KernelRidge
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import MaxAbsScaler, MinMaxScaler, RobustScaler, StandardScaler

from sklearn_raacmm import (
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
)
from sklearn_raacmm.export import _json, fingerprint, from_json, to_json

plain_python = runpy.run_path(str(Path(__file__).parents[2] / "doc" / "read_json.py"))["run"]


def network(**params):
    return RBFNetRegressor(**{"n_centers": 8, "length_scale": 1.5, "alpha": 0.03, **params})


@pytest.fixture(scope="module")
def models(data):
    arm = data.arm
    inner = make_pipeline(PoseFeatures(arm), StandardScaler(), network())
    found = {
        "outermost": CylindricalResidualTarget(inner, azimuth=arm.azimuth),
        "pipeline": make_pipeline(
            PoseFeatures(arm, append_azimuth=True, encoding="periodic"),
            CylindricalResidualTarget(make_pipeline(RobustScaler(), network(degree=1))),
        ),
        "linear": ArmResidualRegressor(arm, orders=2),
        "both": ArmResidualRegressor(arm, orders=2, causes=["kinematics"]),
        "clipped": make_pipeline(MinMaxScaler(clip=True), MaxAbsScaler(), Ridge()),
        "search": GridSearchCV(network(), {"n_centers": [3, 5]}, cv=2),
    }
    return {name: model.fit(data.data, data.target) for name, model in found.items()}


@pytest.fixture(scope="module")
def text(models):
    return to_json(models["both"], std=True)


@pytest.mark.parametrize("name", ["outermost", "pipeline", "linear", "both", "clipped", "search"])
def test_the_same_predictions(models, data, tmp_path, name):
    model, std = models[name], name != "clipped"
    text = to_json(model, tmp_path / "model.json", std=std)
    assert (tmp_path / "model.json").read_text(encoding="utf-8") == text
    expected = model.predict(data.data)
    for source in (text, tmp_path / "model.json", str(tmp_path / "model.json")):
        again = from_json(source)
        np.testing.assert_allclose(again.predict(data.data), expected, rtol=0, atol=1e-12)
    assert json.loads(text)["fingerprint"] == fingerprint(model) == again.fingerprint
    if std:
        best = getattr(model, "best_estimator_", model)
        got, of_model = again.predict(data.data, True), best.predict(data.data, return_std=True)
        np.testing.assert_allclose(got[1], of_model[1], rtol=1e-9)
    # By plain Python, which needs nothing but the text.
    head = json.loads(text)
    read = np.array([plain_python(head, row)["y"] for row in data.data[:20].tolist()])
    np.testing.assert_allclose(read, expected[:20], rtol=0, atol=1e-12)


def test_the_same_model_gives_the_same_text(models):
    for name in ("both", "pipeline"):
        assert to_json(models[name], std=True) == to_json(models[name], std=True)


def test_its_test_rows_are_what_predict_gives(models, data):
    again = from_json(to_json(models["pipeline"], std=True, poses=data.data))
    X, y, std = (again.test_rows[key] for key in ("X", "y", "std"))
    mean, spread = models["pipeline"].predict(X[:28], return_std=True)
    np.testing.assert_allclose(y[:28], mean, rtol=0, atol=1e-14)
    np.testing.assert_allclose(std[:28], spread, rtol=1e-9)
    assert np.isnan(y[28:]).all()
    assert set(map(str, X[28:].ravel())) >= {"nan", "inf", "-inf"}


def test_degrees_and_one_output(data):
    X = np.rad2deg(data.data)
    azimuth = partial(data.arm.azimuth, angle_unit="deg")
    inner = make_pipeline(PoseFeatures(data.arm, angle_unit="deg"), network())
    model = CylindricalResidualTarget(inner, azimuth=azimuth).fit(X, data.target)
    again = from_json(to_json(model, card="what it is: ü"))
    np.testing.assert_allclose(again.predict(X), model.predict(X), rtol=0, atol=1e-12)
    assert (again.about["angle_unit"], again.about["card"]) == ("deg", "what it is: ü")
    Z = data.data[:, :2].copy()
    Z[:, 1] = 3.0  # does not vary: an infinite width
    for one in (network(length_scale="auto"), LinearRegression()):
        one.fit(Z, data.target[:, 0])
        again = from_json(to_json(one))
        np.testing.assert_allclose(again.predict(Z), one.predict(Z), rtol=0, atol=1e-12)
        assert again.predict(Z).shape == (len(Z),)
    with pytest.raises(
        ValueError, match=r"takes rows of 2 numbers, \(n, 2\); got shape \(120, 6\)"
    ):
        again.predict(data.data)
    with pytest.raises(ValueError, match="no standard deviation: write it with std=True"):
        again.predict(Z, return_std=True)


def changed(text, change, fingerprint=True):
    """The text with `change` made to it, a checksum that fits, and perhaps a fingerprint."""
    head = json.loads(text)
    change(head)
    if fingerprint:
        try:
            head["fingerprint"] = None
            _json.program_of_text(json.dumps(_json.checked(head)))
        except ValueError as error:
            head["fingerprint"] = str(error).rpartition(" ")[2]
    return json.dumps(_json.checked(head))


def operation(head, name):
    return next(entry for entry in head["operations"] if entry[0] == name)


def array_of(head, name, key):
    return head["arrays"][operation(head, name)[2][key]]


def put(name, key, value):
    def change(head):
        array = array_of(head, name, key)
        while isinstance(array[0], list):
            array = array[0]
        array[0] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda head: operation(head, "affine").__setitem__(0, "system"),
            "'system' is no operation",
        ),
        (lambda head: operation(head, "affine").__setitem__(0, ["x"]), "is no operation"),
        (
            lambda head: operation(head, "affine").__setitem__(1, [10**6]),
            "takes value 1000000, which",
        ),
        (lambda head: operation(head, "affine").__setitem__(1, [-1]), "takes value -1, which"),
        (
            lambda head: operation(head, "affine")[2].pop("shift"),
            "has the constants matrix in place",
        ),
        (lambda head: operation(head, "affine")[2].update(shift=0.5), "list indices"),
        (
            lambda head: array_of(head, "affine", "shift").pop(),
            "sizes do not agree in an operation",
        ),
        (lambda head: array_of(head, "radial", "centers").pop(), "sizes do not agree"),
        (lambda head: array_of(head, "frames", "table").pop(), "sizes do not agree"),
        (lambda head: array_of(head, "frames", "table")[0].pop(), "inhomogeneous"),
        (lambda head: operation(head, "radial")[2].update(kernel="cosine"), "cosine"),
        (put("affine", "matrix", None), "holds something that is no number"),
        (put("affine", "matrix", "1"), "holds something that is no number"),
        (put("take", "index", 10**6), "sizes do not agree in an operation 'take'"),
        (put("affine", "matrix", 1.5), "away from predict"),
        (lambda head: head.update(n_inputs=5), "sizes do not agree"),
        (lambda head: head.update(n_inputs="6"), "n_inputs must be a positive whole number"),
        (lambda head: head["outputs"].update(y=10**6), "output 'y' is value 1000000 of"),
        (lambda head: head["outputs"].pop("y"), "there is no output y"),
        (lambda head: head.pop("operations"), "KeyError"),
        (lambda head: head.pop("test_rows"), "KeyError"),
    ],
)
def test_damaged_files_are_refused(text, change, message):
    with pytest.raises(ValueError, match=message) as error:
        from_json(changed(text, change))
    assert "\n" not in str(error.value)


def test_the_fingerprint_is_that_of_the_operations(text):
    with pytest.raises(ValueError, match=r"its fingerprint is '0000.*, that of its operations is"):
        from_json(changed(text, lambda head: head.update(fingerprint="0" * 64), False))
    with pytest.raises(ValueError, match="that of its operations is"):
        from_json(changed(text, put("affine", "matrix", 1.5), False))


def test_numbers_that_are_not_finite_are_refused(text, models, data):
    for bad in ("NaN", "Infinity", "1e999"):
        place = text.index('"arrays"') + 16
        digits = text.index("[", place) + 1
        with pytest.raises(ValueError, match=r"no number of JSON|not finite|no number"):
            from_json(text[:digits] + bad + ", " + text[digits:])
    model = network().fit(data.data, data.target)
    model.networks_[0].noise_variance[0] = -1.0
    with pytest.raises(ValueError, match=r"variances must not be negative, got \[-1\.\]"):
        to_json(model, std=True)
    for name, value in (("factor", -2.0), ("size_mm", np.nan), ("size_mm", np.inf)):
        import copy

        damaged = copy.deepcopy(models["linear"])
        object.__setattr__(damaged.fading_, name, value)
        with pytest.raises(ValueError, match=f"^{name} of Fading must be"):
            to_json(damaged)


def test_a_changed_digit_is_noticed(models, tmp_path):
    text = to_json(models["linear"])
    place = text.index('"arrays"')
    digit = next(i for i in range(place + 60, len(text)) if text[i] in "12345678")
    other = text[:digit] + str(int(text[digit]) + 1) + text[digit + 1 :]
    with pytest.raises(ValueError, match="the JSON text is damaged: its checksum is not that"):
        from_json(other)
    path = tmp_path / "model.json"
    for content, message in (
        (text[:-200].encode(), "is not valid JSON"),
        (b"{}", "its format is not"),
        (text.replace('"format_version": 2', '"format_version": 1').encode(), "has format_version"),
        (text.encode("utf-16"), "is not valid JSON"),
        (b"[NaN]", "NaN is no number of JSON"),
        (b'{"a":' * 10**5, "is not valid JSON"),
    ):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=message) as error:
            from_json(path)
        assert str(path) in str(error.value)
    path.write_bytes(b"\xef\xbb\xbf" + text.encode())  # a mark that editors put there
    assert from_json(path).n_outputs_ == 3


def test_what_cannot_be_written(data):
    with pytest.raises(NotFittedError):
        to_json(network())
    with pytest.raises(ValueError, match=r"KernelRidge is a KernelRidge, which cannot be exported"):
        to_json(KernelRidge().fit(data.data, data.target))
    with pytest.raises(ValueError, match="ridge is a Ridge, which has no standard deviation"):
        to_json(make_pipeline(StandardScaler(), Ridge()).fit(data.data, data.target), std=True)
