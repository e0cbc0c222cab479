"""Compiled and loaded: the same numbers, in every thread."""

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.export import fingerprint, load_c

from ._chains import needs_compiler

# Chains are fitted without groups: what they learn is not the question here.
pytestmark = pytest.mark.filterwarnings("ignore:No groups were given")


@needs_compiler
def test_gives_what_predict_gives(chain, data):
    compiled = load_c(chain, std=True)
    mean, std = chain.predict(data.data, return_std=True)
    np.testing.assert_allclose(compiled.predict(data.data), mean, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(compiled.correct(data.data), compiled.predict(data.data))
    assert compiled.fingerprint == fingerprint(chain)
    assert (compiled.n_features_in_, compiled.n_outputs_) == (6, 3)
    for i in range(10):
        row = data.data[i]
        np.testing.assert_array_equal(compiled.correct(row), compiled.correct(data.data)[i])
        np.testing.assert_array_equal(compiled.correct(row.tolist()), compiled.correct(row))
        point = data.arm.forward(row[None])[0] - mean[i]
        np.testing.assert_allclose(compiled.point(row), point, rtol=0, atol=1e-11)
        got, spread = compiled.predict_std(row)
        np.testing.assert_array_equal(got, compiled.correct(row))
        np.testing.assert_allclose(spread, std[i], rtol=1e-3)
        assert compiled.status(row) == 0
    bad = np.where(np.arange(6) == 2, np.nan, data.data[0])
    assert np.isnan(compiled.correct(bad)).all()
    assert compiled.status(bad) == 2
    # Rows that are every second column of something, and another type.
    wide = np.repeat(data.data, 2, axis=1).astype(np.float32)[:, ::2]
    expected = chain.predict(wide.astype(float))
    np.testing.assert_allclose(compiled.predict(wide), expected, rtol=0, atol=1e-12)


@needs_compiler
@pytest.mark.parametrize("estimator", [LinearRegression(), RBFNetRegressor(10)])
def test_one_output_has_the_shape_of_predict(estimator, data):
    for y in (data.target[:, 0], data.target[:, :1]):
        model = estimator.fit(data.data, y)
        compiled, expected = load_c(model), model.predict(data.data)
        np.testing.assert_allclose(compiled.predict(data.data), expected, rtol=0, atol=1e-9)
        assert compiled.predict(data.data).shape == expected.shape
        assert np.shape(compiled.predict(data.data[0])) == expected[0].shape


@needs_compiler
def test_threads_share_it(chain, data):
    compiled = load_c(chain)
    rows = np.tile(data.data, (30, 1))
    expected = compiled.predict(rows)
    with ThreadPoolExecutor(8) as pool:
        found = np.array(list(pool.map(compiled.correct, rows)))
        many = list(pool.map(compiled.predict, [rows] * 8))
    np.testing.assert_array_equal(found, expected)
    for result in many:
        np.testing.assert_array_equal(result, expected)


def test_without_a_compiler(chain, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CC", "tcc")
    with pytest.raises(RuntimeError, match=r"No C compiler found: none of tcc, cc, gcc, clang is"):
        load_c(chain)


@pytest.mark.skipif(os.name == "nt", reason="a script of POSIX")
def test_what_a_failing_compiler_says_is_shown(chain, tmp_path, monkeypatch):
    script = tmp_path / "failing"
    script.write_text("#!/bin/sh\nfor i in 1 2 3 4 5 6 7; do echo line $i >&2; done\nexit 3\n")
    script.chmod(0o700)
    monkeypatch.setenv("CC", str(script))
    with pytest.raises(RuntimeError) as error:
        load_c(chain)
    assert "could not compile the model (exit status 3): line 1 | line 2" in str(error.value)
    assert "line 6" not in str(error.value)
    silent = tmp_path / "silent"
    silent.write_text("#!/bin/sh\nexit 0\n")  # says that all is well, and writes nothing
    silent.chmod(0o700)
    monkeypatch.setenv("CC", str(silent))
    with pytest.raises(RuntimeError, match="could not compile"):
        load_c(chain)


@needs_compiler
def test_bad_calls_are_refused(chain, data):
    compiled = load_c(chain)
    for rows in (data.data[:, :5], data.data[0, :5], data.data[None], 1.0):
        with pytest.raises(ValueError, match=r"takes rows of 6 numbers, .*; got shape \("):
            compiled.predict(rows)
    with pytest.raises(ValueError, match="without its deviation: std=True"):
        compiled.predict_std(data.data[0])
    flat = load_c(LinearRegression().fit(data.data, data.target[:, 0]))
    for call in (flat.correct, flat.point):
        with pytest.raises(ValueError, match="no arm and three outputs"):
            call(data.data[0])
