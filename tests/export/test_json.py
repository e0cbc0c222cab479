"""JSON: the same predictions to the last bit, and nothing else than what was written."""

import copy
import json
from functools import partial

import joblib
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
    JointHarmonicRegressor,
    PoseFeatures,
    RBFNetRegressor,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.export import TRUSTED_TYPES, fingerprint, from_json, to_json
from sklearn_raacmm.export import _json as module


@pytest.fixture(scope="module")
def data():
    return make_single_point(n_positions=8, n_poses=15, random_state=0)


def network(**params):
    return RBFNetRegressor(**{"n_centers": 8, "length_scale": 1.5, "alpha": 0.03, **params})


@pytest.fixture(scope="module")
def models(data):
    arm = data.arm
    linear = JointHarmonicRegressor(arm, max_order=2)
    inner = make_pipeline(PoseFeatures(arm), StandardScaler(), network())
    found = {
        "outermost": CylindricalResidualTarget(inner, azimuth=arm.azimuth),
        "pipeline": make_pipeline(
            PoseFeatures(arm, append_azimuth=True, encoding="periodic"),
            CylindricalResidualTarget(make_pipeline(RobustScaler(), network(degree=1))),
        ),
        "linear": linear,
        "guarded": ArmResidualRegressor(
            arm, harmonics=linear, network=network(degree=-1), use="harmonics+network"
        ),
        "clipped": make_pipeline(MinMaxScaler(clip=True), MaxAbsScaler(), Ridge()),
        "search": GridSearchCV(network(), {"n_centers": [3, 5]}, cv=2),
    }
    return {name: model.fit(data.data, data.target) for name, model in found.items()}


@pytest.fixture(scope="module")
def guarded_text(models):
    return to_json(models["guarded"])


@pytest.mark.parametrize(
    "name", ["outermost", "pipeline", "linear", "guarded", "clipped", "search"]
)
def test_the_same_predictions(models, data, tmp_path, name):
    model = models[name]
    text = to_json(model, tmp_path / "model.json")
    assert (tmp_path / "model.json").read_text(encoding="utf-8") == text
    for source in (text, tmp_path / "model.json", str(tmp_path / "model.json")):
        again = from_json(source)
        np.testing.assert_array_equal(again.predict(data.data), model.predict(data.data))
    assert to_json(again) == text
    head = json.loads(text)
    assert head["fingerprint"] == fingerprint(model) == fingerprint(again)
    if name not in ("clipped", "search"):
        for got, expected in zip(
            again.predict(data.data, return_std=True),
            model.predict(data.data, return_std=True),
            strict=True,
        ):
            np.testing.assert_array_equal(got, expected)
    # A copy that can be fitted again.
    if name in ("linear", "pipeline"):
        fitted = copy.deepcopy(again).fit(data.data, data.target)
        np.testing.assert_array_equal(fitted.predict(data.data), model.predict(data.data))


def test_degrees_names_and_one_output(data):
    pandas = pytest.importorskip("pandas")
    X = pandas.DataFrame(np.rad2deg(data.data), columns=[f"gelenk ä{i}" for i in range(6)])
    azimuth = partial(data.arm.azimuth, angle_unit="deg")
    inner = make_pipeline(PoseFeatures(data.arm, angle_unit="deg"), network())
    model = CylindricalResidualTarget(inner, azimuth=azimuth).fit(X, data.target)
    again = from_json(to_json(model))
    np.testing.assert_array_equal(again.predict(X), model.predict(X))
    with pytest.raises(ValueError, match="feature names"):
        again.predict(X.rename(columns={"gelenk ä0": "other"}))
    Z = data.data[:, :2].copy()
    Z[:, 1] = 3.0  # does not vary: an infinite width
    for one in (network(length_scale="auto").fit(Z, data.target[:, 0]), LinearRegression()):
        one.fit(Z, data.target[:, 0])
        again = from_json(to_json(one))
        np.testing.assert_array_equal(again.predict(Z), one.predict(Z))
        assert again.predict(Z).ndim == 1


def test_a_parameter_is_not_written_as_fitted(models, data):
    """The pattern of a stage may have been fitted by itself: its numbers are not the model's."""
    model = copy.deepcopy(models["guarded"])
    model.harmonics = models["linear"]
    text = to_json(model)
    assert len(text) == len(to_json(models["guarded"]))
    again = from_json(text)
    assert not hasattr(again.harmonics, "linear_model_")
    np.testing.assert_array_equal(again.predict(data.data), model.predict(data.data))


def test_numbers_are_exact_and_text_is_text(models):
    text = to_json(models["pipeline"])
    assert "NaN" not in text
    content = json.loads(text)["model"]
    (_, target) = content["state"]["steps"][1]["tuple"]
    steps = target["state"]["regressor_"]["state"]["steps"]
    coef = steps[1]["tuple"][1]["state"]["posterior_"]["state"]["coef"]
    expected = models["pipeline"][-1].regressor_[-1].posterior_.coef
    assert coef["shape"] == list(expected.shape)
    assert coef["array"] == expected.ravel().tolist()


def changed(text, change):
    """The text with `change` made to its model, and a checksum that fits."""
    head = json.loads(text)
    change(head["model"])
    head["checksum"] = module._checksum(head["model"])
    return json.dumps(head)


def numbers_of(node, name):
    """Where an array of a network stands: among its own attributes or in its posterior."""
    own = node["state"]["posterior_"]["state"]
    return (own if name in own else node["state"])[name]


def drop_a_row(name):
    def change(node):
        entry = numbers_of(node, name)
        entry["shape"][0] -= 1
        size = int(np.prod(entry["shape"]))
        entry["array"] = entry["array"][:size]

    return change


def put(name, value):
    def change(node):
        numbers_of(node, name)["array"][0] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (drop_a_row("center_indices_"), r"center_indices_ of RBFNetRegressor has shape"),
        (drop_a_row("centers"), r"coef of NetworkPosterior has shape"),
        (drop_a_row("coef"), r"of NetworkPosterior has shape"),
        (drop_a_row("length_scale"), r"length_scale of NetworkPosterior has shape \(5,\)"),
        (put("coef", "NaN"), "coef of NetworkPosterior holds NaN or infinity"),
        (put("centers", "Infinity"), "centers of NetworkPosterior holds NaN or infinity"),
        (put("coef", None), "something that is no number"),
        (drop_a_row("polynomial"), r"tail_map of NetworkPosterior has shape"),
        (lambda node: node["state"]["posterior_"]["state"].pop("noise_variance"), "is missing"),
        (lambda node: node["state"].pop("kernel"), "RBFNetRegressor has no kernel"),
        (lambda node: node.update(estimator="Popen"), "'Popen' is none of PoseFeatures"),
        (lambda node: node.update(estimator=["x"]), "is none of"),
        (lambda node: node.clear(), "None is none of"),
        (lambda node: numbers_of(node, "coef").update(shape=[2, 2]), "cannot reshape"),
        (lambda node: numbers_of(node, "coef").update(dtype="O"), "'O'"),
    ],
)
def test_damaged_files_are_refused(data, change, message):
    text = to_json(network().fit(data.data, data.target))
    with pytest.raises(ValueError, match=message) as error:
        from_json(changed(text, change))
    assert "\n" not in str(error.value)


def fading(node):
    return node["state"]["fadings_"][0]["state"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda node: fading(node).update(factor=-2.0), "factor of Fading must be a finite"),
        (lambda node: fading(node).update(size_mm="0.1"), "size_mm of Fading must be"),
        (lambda node: fading(node).update(known_mm=None), "known_mm of Fading must be"),
        (lambda node: fading(node).update(size_mm={"number": "NaN"}), "got nan"),
        (lambda node: fading(node).pop("factor"), "factor"),
        (lambda node: fading(node).update(half=1.0), "half"),
        (lambda node: node["state"]["fadings_"].pop(), "how each of its stages fades"),
        (lambda node: node["state"].update(fadings_=[1, 2]), "how each of its stages fades"),
        (lambda node: node["state"].pop("fadings_"), "how each of its stages fades"),
        (lambda node: node["state"].update(use_="all"), "use_ of ArmResidualRegressor must be one"),
        (lambda node: node["state"].update(linear_model_=None), "linear_model_ .* is no LinearMod"),
        (lambda node: node["state"].update(network_=None), "network_ .* is no RBFNetRegressor"),
        (lambda node: node["state"].update(cap_mm_="1"), "cap_mm_ of ArmResidualRegressor must be"),
        (lambda node: node["state"].update(cap_mm_={"number": "NaN"}), "cap_mm_ .* got nan"),
        (lambda node: node["state"].update(angle_unit="turns"), "'angle_unit' parameter"),
        (lambda node: node["state"].update(joints=["all"]), "'joints' parameter"),
    ],
)
def test_damaged_stages_are_refused(guarded_text, change, message):
    text = guarded_text
    with pytest.raises(ValueError, match=message) as error:
        from_json(changed(text, change))
    assert "holds no model that can be built" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_linear_model_without_its_fading_is_refused(models):
    text = to_json(models["linear"])
    with pytest.raises(ValueError, match="how each of its stages fades"):
        from_json(changed(text, lambda node: node["state"].pop("fading_")))


def test_a_changed_digit_is_noticed(models, tmp_path):
    text = to_json(models["linear"])
    place = text.index('"coef"')
    digit = next(i for i in range(place + 60, len(text)) if text[i] in "12345678")
    other = text[:digit] + str(int(text[digit]) + 1) + text[digit + 1 :]
    with pytest.raises(ValueError, match="the JSON text is damaged: its checksum is not that"):
        from_json(other)
    path = tmp_path / "model.json"
    for content, message in (
        (text[:-200].encode(), "is not valid JSON"),
        (b"{}", "its format is not"),
        (text.replace('"format_version": 1', '"format_version": 2').encode(), "has format_version"),
        (text.encode("utf-16"), "is not valid JSON"),
        (b"[NaN]", "NaN is no number of JSON"),
        (b'{"a":' * 10**5, "is not valid JSON"),
    ):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=message) as error:
            from_json(path)
        assert str(path) in str(error.value)
    path.write_bytes(b"\xef\xbb\xbf" + text.encode())  # a mark that editors put there
    assert from_json(path).coef_.shape == models["linear"].coef_.shape


def test_what_cannot_be_written(data):
    with pytest.raises(NotFittedError):
        to_json(network())
    with pytest.raises(ValueError, match=r"KernelRidge is a KernelRidge, which cannot be written"):
        to_json(KernelRidge().fit(data.data, data.target))
    model = network(random_state=np.random.RandomState(0)).fit(data.data, data.target)
    with pytest.raises(ValueError, match=r"RBFNetRegressor.random_state is a RandomState"):
        to_json(model)


@pytest.mark.parametrize("attribute", ["centers", "coef", "length_scale"])
def test_other_files_of_a_network_that_lost_a_row(data, tmp_path, attribute):
    model = network().fit(data.data, data.target)
    vars(model.posterior_)[attribute] = getattr(model.posterior_, attribute)[:-1]
    joblib.dump(model, tmp_path / "model")
    with pytest.raises(ValueError, match=r"The file is damaged: .* of NetworkPosterior has shape"):
        joblib.load(tmp_path / "model")
    skops = pytest.importorskip("skops.io", reason="needs the extra skops")
    with pytest.raises(ValueError, match=r"The file is damaged: .* of NetworkPosterior has shape"):
        skops.loads(skops.dumps(model), trusted=TRUSTED_TYPES)


@pytest.mark.parametrize("attribute", ["coef", "half"])
def test_other_files_of_a_linear_model_that_lost_a_row(models, tmp_path, attribute):
    model = copy.deepcopy(models["linear"])
    vars(model.linear_model_)[attribute] = getattr(model.linear_model_, attribute)[:-1]
    joblib.dump(model, tmp_path / "model")
    with pytest.raises(ValueError, match=r"The file is damaged: .* of LinearModel has shape"):
        joblib.load(tmp_path / "model")
    skops = pytest.importorskip("skops.io", reason="needs the extra skops")
    with pytest.raises(ValueError, match=r"The file is damaged: .* of LinearModel has shape"):
        skops.loads(skops.dumps(model), trusted=TRUSTED_TYPES)
