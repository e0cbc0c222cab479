"""The JavaScript of the deployment page, run by node: the same numbers as predict."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from sklearn_raacmm import ArmResidualRegressor
from sklearn_raacmm.datasets import make_single_point

PAGE = Path(__file__).parents[2] / "doc" / "deployment.md"


def test_the_script_of_the_page(tmp_path):
    pytest.importorskip("onnx", reason="needs the extra onnx")
    from sklearn_raacmm.export import to_onnx

    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not on PATH")
    asked = [node, "-e", 'require.resolve("onnxruntime-node")']
    if subprocess.run(asked, capture_output=True, check=False).returncode:
        pytest.skip("onnxruntime-node is not installed: npm install it, and name it in NODE_PATH")
    data = make_single_point(n_positions=6, n_poses=15, random_state=0)
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
