"""ONNX: what the runtime computes is what predict computes."""

import builtins
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import Arm, ArmResidualRegressor, PoseFeatures
from sklearn_raacmm.export import _export, fingerprint, to_onnx

onnx = pytest.importorskip("onnx", reason="needs the extra onnx")
onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")
PAGE = Path(__file__).parents[2] / "doc" / "deployment.md"
pytestmark = [
    pytest.mark.filterwarnings("ignore:.*poses lie where the model knows little"),
    pytest.mark.filterwarnings("ignore:No groups were given"),
]


def run(converted, X):
    session = onnxruntime.InferenceSession(
        converted.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    return session.run(None, {session.get_inputs()[0].name: X})[0]


def test_elevation_to_the_last_digits():
    # The runtime has no arc tangent in float64: straight up, straight down and level, too.
    arm = Arm(
        a=[0, 300, 200], alpha=[np.pi / 2, 0, 0], d=[100, 0, 0],
        pose_joints=(2, 3), pose_frames=(1, 3),
    )  # fmt: skip
    elbow = np.r_[np.linspace(-np.pi, np.pi, 401), np.pi / 2 + np.array([-1e-8, 0, 1e-8])]
    X = np.column_stack([np.zeros_like(elbow), elbow, np.zeros_like(elbow)])
    model = make_pipeline(PoseFeatures(arm), LinearRegression()).fit(X, X[:, 1])
    model[-1].coef_, model[-1].intercept_ = np.array([0.0, 0.0, 1.0]), 0.0  # the elevation alone
    expected = np.where(np.abs(elbow) > np.pi / 2, np.sign(elbow) * np.pi - elbow, elbow)
    np.testing.assert_allclose(run(to_onnx(model), X)[:, 0], expected, rtol=0, atol=1e-14)


def test_without_onnx_the_error_says_what_to_install(monkeypatch, chain):
    importing = builtins.__import__

    def nothing(name, *args, **kwargs):
        if name.partition(".")[0] == "onnx":
            raise ImportError(name)
        return importing(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", nothing)
    with pytest.raises(ImportError, match=r"pip install -e \"\.\[onnx\]\""):
        to_onnx(chain)


def test_the_file_and_its_metadata(data, chain, tmp_path):
    """Test rows with answers: the check of the page, in a runtime that knows nothing of us."""
    for name in ("first.onnx", "second.onnx"):
        to_onnx(chain, tmp_path / name, card="what it is: ü", std=True)
    onnx.checker.check_model(tmp_path / "first.onnx", full_check=True)
    content = (tmp_path / "first.onnx").read_bytes()
    assert content == (tmp_path / "second.onnx").read_bytes()
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    assert session.get_inputs()[0].shape[1] == 6
    assert {node.domain for node in onnx.load_from_string(content).graph.node} == {""}  # ai.onnx
    facts = session.get_modelmeta().custom_metadata_map
    assert facts["model_card"] == "what it is: ü"
    assert facts["fingerprint"] == fingerprint(chain)
    rows = json.loads(facts["test_rows"])
    X, y, std = (np.array(rows[key][:28], dtype=float) for key in ("X", "y", "std"))
    assert rows["y"][28:] == [[None] * 3] * 4
    assert {value for row in rows["X"][28:] for value in row if not isinstance(value, float)} == {
        None, "Infinity", "-Infinity"
    }  # fmt: skip
    got = session.run(None, {"X": X})
    np.testing.assert_allclose(got[0], y, rtol=0, atol=1e-12)
    np.testing.assert_allclose(got[1], std, rtol=1e-9)
    np.testing.assert_allclose(y, chain.predict(X), rtol=0, atol=1e-14)


def test_a_file_that_does_not_keep_its_promise_is_refused(chain, monkeypatch):
    compute = _export.run_onnx
    monkeypatch.setattr(_export, "run_onnx", lambda *args: {"y": 1.001 * compute(*args)["y"]})
    with pytest.raises(ValueError, match=r"the ONNX file is up to .* away from predict, 0.001 of"):
        to_onnx(chain)


def test_the_script_of_the_page(data, tmp_path):
    """The JavaScript of the deployment page, run by node."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not on PATH")
    asked = [node, "-e", 'require.resolve("onnxruntime-node")']
    if subprocess.run(asked, capture_output=True, check=False).returncode:
        pytest.skip("onnxruntime-node is not installed: npm install it, and name it in NODE_PATH")
    model = ArmResidualRegressor(data.arm, orders=2, causes=["kinematics"])
    to_onnx(model.fit(data.data, data.target), tmp_path / "my_arm.onnx")
    (script,) = re.findall(r"```js\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    given = re.search(r"Float64Array\.of\((.*?)\)", script)[1]
    X = np.concatenate([[np.fromstring(given, sep=",")], data.data[:5]])  # the page's row, and more
    several = script.replace(given, ", ".join(map(repr, X.ravel().tolist())))
    (tmp_path / "correct.js").write_text(several)
    command = [node, "correct.js"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    got = np.reshape(json.loads(done.stdout), (-1, 3))
    np.testing.assert_allclose(got, model.predict(X), rtol=0, atol=1e-12)
