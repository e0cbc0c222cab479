"""Models in files: the same predictions elsewhere, and a warning where the version is another."""

import copy
import io
import json
import os
import pickle
import re
import shutil
import subprocess
import sys
import warnings
from pathlib import Path
from zipfile import ZipFile

import joblib
import numpy as np
import pytest
from sklearn.base import clone
from sklearn.exceptions import InconsistentVersionWarning
from sklearn.preprocessing import FunctionTransformer

import sklearn_raacmm
from sklearn_raacmm import Arm, ArmResidualRegressor, Correction, RBFNetRegressor
from sklearn_raacmm.correction._files import OtherContentError, dump_model, read_model
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.export import TRUSTED_TYPES
from sklearn_raacmm.utils import _estimators, stored_classes

from .export._chains import form_a, form_b

# Chains are fitted without groups: what they learn is not the question here.
pytestmark = pytest.mark.filterwarnings("ignore:No groups were given")

# Of the correction in ``correction/written_by_0.1.0.dev0``, at three poses by the version that
# wrote it: mean and standard deviation in mm, and the share that is used.
WAS_PREDICTED = [
    [0.00029315, 0.00014399, -0.00106702],
    [0.00331334, 0.00012723, -0.00052035],
    [0.00275179, 0.00060706, -0.00096543],
]
WAS_STD = [
    [0.00684169, 0.00762915, 0.00187501],
    [0.00621386, 0.00693957, 0.00317885],
    [0.00458388, 0.00683347, 0.00283288],
]
WAS_SHARE = [0.40246836, 0.40323801, 0.4046418]
OTHER_PYTHONS = [f"python3.{minor}" for minor in range(11, 16) if minor != sys.version_info[1]]


@pytest.fixture(scope="module")
def data():
    return make_single_point(n_positions=6, n_poses=12, random_state=0)


@pytest.fixture(scope="module")
def fitted(data):
    """Every public estimator, fitted, in chains or by itself."""
    X, y, arm = data.data, data.target, data.arm
    return {
        "outermost": form_a(arm).fit(X, y),
        "pipeline": form_b(arm).fit(X, y),
        "harmonics": ArmResidualRegressor(arm, orders=3).fit(X, y, groups=data.groups),
    }


def test_a_file_gives_the_same_predictions(fitted, data, tmp_path):
    for name, model in fitted.items():
        joblib.dump(model, tmp_path / name)
        loaded = joblib.load(tmp_path / name)
        for got, expected in zip(
            loaded.predict(data.data, return_std=True),
            model.predict(data.data, return_std=True),
            strict=True,
        ):
            np.testing.assert_array_equal(got, expected, err_msg=name)


def test_another_version_is_warned_of(fitted, monkeypatch):
    monkeypatch.setattr(_estimators, "__version__", "0.0.7")
    texts = {name: pickle.dumps(model) for name, model in fitted.items()}
    monkeypatch.undo()
    estimators = set()
    for text in texts.values():
        with pytest.warns(InconsistentVersionWarning) as caught:
            pickle.loads(text)
        for warning in caught:
            assert warning.message.original_sklearn_version == "0.0.7"
            assert (
                f"saved by sklearn_raacmm 0.0.7 and is loaded by {sklearn_raacmm.__version__}"
                in (str(warning.message))
            )
            estimators.add(warning.message.estimator_name)
    assert estimators == {
        name for name in sklearn_raacmm.__all__ if hasattr(getattr(sklearn_raacmm, name), "fit")
    }


def test_the_version_stays_in_the_file(fitted):
    model = fitted["harmonics"]
    assert "version" not in " ".join(vars(pickle.loads(pickle.dumps(model))))
    assert clone(model).get_params().keys() == model.get_params().keys()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        copied = copy.deepcopy(model)
        assert vars(copied).keys() == vars(model).keys()
    assert not caught


def test_a_file_without_a_version_is_warned_of():
    network = RBFNetRegressor()
    with pytest.warns(InconsistentVersionWarning, match=r"before 0\.1\.0"):
        network.__setstate__(dict(vars(network)))


def test_a_model_of_another_number_of_columns_is_damaged(fitted):
    linear = fitted["harmonics"].linear_model_
    with pytest.raises(ValueError, match="The file is damaged: coef of LinearModel has shape"):
        object.__new__(type(linear)).__setstate__(
            linear.__getstate__() | {"coef": linear.coef[:-1]}
        )


def test_a_field_that_a_file_does_not_have_is_no_default(fitted):
    linear = fitted["harmonics"].linear_model_
    for name in linear.__getstate__():
        state = {key: value for key, value in linear.__getstate__().items() if key != name}
        with pytest.raises(ValueError, match=f"The file does not say {name} of the linear model"):
            object.__new__(type(linear)).__setstate__(state)


def test_an_earlier_folder_is_read(skops):
    """Written before the prior of the table was given; what it predicted then is kept here."""
    folder = Path(__file__).parent / "correction" / "written_by_0.1.0.dev0"
    model = Correction.load(folder).model
    angles = make_single_point(8, 10, machine="eccentricity", random_state=0).data[:3]
    mean, std = model.predict(angles, return_std=True)
    np.testing.assert_allclose(mean, WAS_PREDICTED, rtol=1e-4)
    np.testing.assert_allclose(std, WAS_STD, rtol=1e-5)
    np.testing.assert_allclose(model.fading(angles), WAS_SHARE, rtol=1e-5)
    linear = model.linear_model_
    assert linear.noise_of_rows == pytest.approx((1 - 0.083056252) * linear.noise_variance)
    share = np.square(linear.lever_mm) @ linear.noise_of_joints / linear.noise_variance
    assert share == pytest.approx(0.083056252)


def interpreters():
    """This Python, and others that have the package: SKLEARN_RAACMM_PYTHONS, or on PATH."""
    yield sys.executable
    named = os.environ.get("SKLEARN_RAACMM_PYTHONS", "").split(os.pathsep)
    for python in [*filter(None, named), *filter(None, map(shutil.which, OTHER_PYTHONS))]:
        found = subprocess.run(
            [python, "-c", "import sklearn_raacmm"], capture_output=True, cwd="/", check=False
        )
        if found.returncode == 0:
            yield python


LOAD = """
import sys, warnings, joblib, numpy as np, sklearn.exceptions, threadpoolctl
threadpoolctl.threadpool_limits(1, user_api="blas")  # as these tests do: two add up otherwise
warnings.simplefilter("error")
warnings.simplefilter("ignore", sklearn.exceptions.InconsistentVersionWarning)
X = np.load(sys.argv[1])
predicted = {name: model.predict(X) for name, model in joblib.load(sys.argv[2]).items()}
np.savez(sys.argv[3], **predicted)
"""


@pytest.mark.exhaustive
def test_loads_in_another_process_and_on_another_python(fitted, data, tmp_path):
    np.save(tmp_path / "X.npy", data.data)
    joblib.dump(fitted, tmp_path / "models")
    files = [tmp_path / name for name in ("X.npy", "models", "predicted.npz")]
    for python in interpreters():
        atol = 0 if python == sys.executable else 1e-12  # here to the last bit
        subprocess.run([python, "-c", LOAD, *files], check=True, cwd="/")
        with np.load(files[2]) as predicted:
            for name, model in fitted.items():
                expected = model.predict(data.data)
                np.testing.assert_allclose(predicted[name], expected, rtol=0, atol=atol)


@pytest.fixture
def skops():
    return pytest.importorskip("skops.io", reason="needs the extra skops")


def test_skops_needs_no_other_trust(skops, fitted, data):
    needed = set()
    rough = RBFNetRegressor(length_scale=0.3, alpha=0.01).fit(data.data, data.target)
    assert rough.stop_reason_ == "all rows, all rows, all rows"
    shared = RBFNetRegressor(10, length_scale=1.0, alpha=0.01, shared=True)
    for model in [*fitted.values(), rough, shared.fit(data.data, data.target)]:
        for text in (skops.dumps(model), dump_model(model)):
            untrusted = skops.get_untrusted_types(data=text)
            needed |= set(untrusted)
            with pytest.raises(TypeError, match="Untrusted types found"):
                skops.loads(text)
            loaded = skops.loads(text, trusted=TRUSTED_TYPES)
            np.testing.assert_array_equal(loaded.predict(data.data), model.predict(data.data))
        # Of a folder: whichever module of a subpackage a class stands in, the file is read.
        assert not [name for name in untrusted if "._" in name]
    public = {name for name in TRUSTED_TYPES if "._" not in name}
    assert needed == set(TRUSTED_TYPES)
    assert {re.sub(r"\._\w+", "", name) for name in needed} == public


def test_own_models_are_read_without_skops(skops, fitted, data):
    kinds = stored_classes()
    network = RBFNetRegressor(10, length_scale=1.0, alpha=0.01).fit(data.data, data.target)
    for model in (fitted["harmonics"], network):
        text = dump_model(model)
        read, loaded = read_model(text, kinds), skops.loads(text, trusted=TRUSTED_TYPES)
        assert_same(vars(read), vars(loaded))
        np.testing.assert_array_equal(read.predict(data.data), model.predict(data.data))
        with pytest.raises(OtherContentError, match=type(model).__name__):
            read_model(text, {"sklearn_raacmm.arm.Arm": Arm})
    # A pipeline is scikit-learn's: such a file is left to skops.
    with pytest.raises(OtherContentError):
        read_model(dump_model(fitted["outermost"]), kinds)


def assert_same(one, other):
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        one, other = list(one.values()), list(other.values())
    if isinstance(one, list | tuple):
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    elif type(one) in stored_classes().values():
        assert_same(vars(one), vars(other))
    else:
        assert one == other or one != one  # NaN is no other


def test_a_file_runs_nothing(skops, tmp_path):
    """Neither functions, nor classes that nobody has named, nor arrays that would be unpickled."""
    pickled = io.BytesIO()
    np.save(pickled, np.array([print], dtype=object), allow_pickle=True)
    arrays = {"__class__": "ndarray", "__module__": "numpy", "__loader__": "NdArrayNode"}
    for node in (
        {"__class__": "system", "__module__": "os", "__loader__": "FunctionNode"},
        {"__class__": "Popen", "__module__": "subprocess", "__loader__": "ObjectNode"},
        {"__class__": "eval", "__module__": "builtins", "__loader__": "TypeNode"},
        {
            "__class__": "Popen",
            "__module__": "subprocess",
            "__loader__": "TupleNode",
            "content": [],
        },
        arrays | {"__class__": "load", "type": "numpy", "file": "plain.npy"},
        arrays | {"type": "numpy", "file": "pickled.npy"},
    ):
        with ZipFile(tmp_path / "model", "w") as file:
            file.writestr("schema.json", json.dumps(node))
            file.writestr("pickled.npy", pickled.getvalue())
            plain = io.BytesIO()
            np.save(plain, np.zeros(2))
            file.writestr("plain.npy", plain.getvalue())
        with pytest.raises(ValueError, match=r"Node|Popen|eval|load|pickle"):
            read_model((tmp_path / "model").read_bytes(), {})


def test_an_arm_from_skops_is_as_immutable_as_any(skops, data):
    loaded = skops.loads(skops.dumps(data.arm), trusted=TRUSTED_TYPES)
    assert loaded == data.arm
    assert hash(loaded) == hash(data.arm)
    with pytest.raises(ValueError, match="read-only"):
        loaded.d[0] = 0.0


@pytest.mark.parametrize("name", ["forward", "frames", "jacobian", "azimuth"])
def test_a_method_of_an_arm_is_the_same_after_skops(skops, name):
    arm = Arm.from_name("ur10")
    content = skops.dumps(FunctionTransformer(getattr(arm, name)))
    again = skops.loads(content, trusted=skops.get_untrusted_types(data=content))
    assert (again.func.__self__, again.func.__name__) == (arm, name)


def test_an_earlier_folder_knows_the_scale_of_its_calibration(skops):
    """Its root had no scale in it: what the calibration left open is drawn beside it."""
    folder = Path(__file__).parent / "correction" / "written_by_0.1.0.dev0"
    correction = Correction.load(folder)
    linear = correction.model.linear_model_
    assert len(linear.seen) == 7  # three shifts, three turns and the scale: it has no gravity
    assert np.all(linear.ranges == [[-np.pi] * 6, [np.pi] * 6])
    whole = correction.facts["scale_sd"]
    assert np.hypot(linear.scale_sd, correction.scale_sd) == pytest.approx(whole)
    angles = make_single_point(8, 10, machine="eccentricity", random_state=0).data
    lengths, std = correction.distances(angles[:10], angles[-10:])
    assert np.all(std > 0.9 * whole * lengths)
    again = pickle.loads(pickle.dumps(correction.model))
    np.testing.assert_array_equal(again.predict(angles), correction.model.predict(angles))
