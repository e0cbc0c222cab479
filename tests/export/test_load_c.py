"""Compiled and loaded: the same numbers in every thread and process, and no file of others."""

import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression

from sklearn_raacmm import ArmResidualRegressor, RBFNetRegressor
from sklearn_raacmm.export import export_c, fingerprint, load_c

from ._chains import COMPILERS, form_b, network

needs_compiler = pytest.mark.skipif(not COMPILERS, reason="neither gcc nor clang is on PATH")


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("SKLEARN_RAACMM_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="module")
def model(data):
    return form_b(data.arm).fit(data.data, data.target)


@needs_compiler
def test_gives_what_predict_gives(model, data):
    compiled = load_c(model, std=True)
    mean, std = model.predict(data.data, return_std=True)
    np.testing.assert_allclose(compiled.predict(data.data), mean, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(compiled.correct(data.data), compiled.predict(data.data))
    assert compiled.fingerprint == fingerprint(model)
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
    expected = model.predict(wide.astype(float))
    np.testing.assert_allclose(compiled.predict(wide), expected, rtol=0, atol=1e-12)


@needs_compiler
def test_models_of_every_shape(data):
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(40, 2)), rng.normal(size=40)
    for estimator in (network(), LinearRegression(), LinearRegression(fit_intercept=False)):
        for target in (y, y[:, None], np.stack([y, -y], axis=1)):
            if estimator.__class__ is RBFNetRegressor and target.shape == (40, 1):
                continue  # RBFNetRegressor gives (n,) back for one column
            estimator.fit(X, target)
            compiled = load_c(estimator)
            expected = estimator.predict(X)
            assert compiled.predict(X).shape == expected.shape
            assert np.shape(compiled.predict(X[0])) == expected[0].shape
            np.testing.assert_allclose(compiled.predict(X), expected, rtol=0, atol=1e-12)
            with pytest.raises(ValueError, match="no arm and three outputs"):
                compiled.correct(X)
    none = ArmResidualRegressor(data.arm, orders=[50], causes=[])
    none.fit(data.data, 1e-3 * rng.normal(size=data.target.shape))
    assert len(none.coef_) == 0  # a model of zero terms
    assert not load_c(none, std=True).correct(data.data).any()


@needs_compiler
def test_threads_share_it(model, data):
    compiled = load_c(model)
    rows = np.tile(data.data, (30, 1))
    expected = compiled.predict(rows)
    with ThreadPoolExecutor(8) as pool:
        found = np.array(list(pool.map(compiled.correct, rows)))
        many = list(pool.map(compiled.predict, [rows] * 8))
    np.testing.assert_array_equal(found, expected)
    for result in many:
        np.testing.assert_array_equal(result, expected)


READ = """
import pickle, sys
import numpy as np
compiled = pickle.load(open(sys.argv[1], "rb"))
np.save(sys.argv[2], compiled.predict(np.load(sys.argv[3])))
"""


@pytest.mark.exhaustive
@needs_compiler
def test_a_pickle_compiles_anew_elsewhere(model, data, tmp_path):
    compiled = load_c(model)
    (tmp_path / "pickle").write_bytes(pickle.dumps(compiled))
    np.save(tmp_path / "X.npy", data.data)
    elsewhere = {**os.environ, "SKLEARN_RAACMM_CACHE": str(tmp_path / "elsewhere")}
    files = [tmp_path / name for name in ("pickle", "out.npy", "X.npy")]
    subprocess.run([sys.executable, "-c", READ, *files], check=True, env=elsewhere)
    np.testing.assert_array_equal(np.load(tmp_path / "out.npy"), compiled.predict(data.data))
    assert len(list((tmp_path / "elsewhere").iterdir())) == 1


@needs_compiler
def test_compiles_once(model, data, own_cache, monkeypatch):
    load_c(model)
    assert [path.suffix for path in own_cache.iterdir()] == [".so"]
    assert own_cache.stat().st_mode & 0o777 == 0o700
    with monkeypatch.context() as patched:
        patched.setattr(subprocess, "run", None)
        load_c(model)
    other = form_b(data.arm, net=network(n_centers=5)).fit(data.data, data.target)
    both = load_c(model), load_c(other)
    assert len(list(own_cache.iterdir())) == 2
    for compiled, fitted in zip(both, (model, other), strict=True):
        expected = fitted.predict(data.data)
        np.testing.assert_allclose(compiled.predict(data.data), expected, rtol=0, atol=1e-12)


@needs_compiler
@pytest.mark.skipif(os.name == "nt", reason="permissions of POSIX")
def test_a_folder_of_others_is_refused(model, tmp_path):
    folder = tmp_path / "open"
    folder.mkdir()
    folder.chmod(0o777)
    with pytest.raises(ValueError, match=r"which others may write to: .*chmod 700"):
        load_c(model, cache_dir=folder)
    assert not list(folder.iterdir())


@needs_compiler
@pytest.mark.skipif(os.name == "nt", reason="permissions of POSIX")
@pytest.mark.parametrize("kind", ["file", "read_only"])
def test_without_a_folder_it_compiles_each_time(model, data, tmp_path, monkeypatch, kind):
    place = tmp_path / kind
    if kind == "file":
        place.write_text("not a folder")
    else:
        place.mkdir(mode=0o500)
        # To root, as which containers run, every folder can be written.
        monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != place)
    folder = place / "cache" if kind == "file" else place
    sentence = {"file": "file", "read_only": r"models cannot be written: .*read_only"}[kind]
    with pytest.raises(OSError, match=sentence):
        load_c(model, cache_dir=folder)
    monkeypatch.setenv("SKLEARN_RAACMM_CACHE", str(folder))
    expected = model.predict(data.data)
    np.testing.assert_allclose(load_c(model).predict(data.data), expected, rtol=0, atol=1e-12)


def test_without_a_compiler(model, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CC", "tcc")
    with pytest.raises(RuntimeError, match=r"No C compiler found: none of tcc, cc, gcc, clang is"):
        load_c(model)


@pytest.mark.skipif(os.name == "nt", reason="a script of POSIX")
def test_what_a_failing_compiler_says_is_shown(model, own_cache, tmp_path, monkeypatch):
    script = tmp_path / "failing"
    script.write_text("#!/bin/sh\nfor i in 1 2 3 4 5 6 7; do echo line $i >&2; done\nexit 3\n")
    script.chmod(0o700)
    monkeypatch.setenv("CC", str(script))
    with pytest.raises(RuntimeError) as error:
        load_c(model)
    assert "could not compile the model (exit status 3): line 1 | line 2" in str(error.value)
    assert "line 6" not in str(error.value)
    silent = tmp_path / "silent"
    silent.write_text("#!/bin/sh\nexit 0\n")  # says that all is well, and writes nothing
    silent.chmod(0o700)
    monkeypatch.setenv("CC", str(silent))
    with pytest.raises(RuntimeError, match="could not compile"):
        load_c(model)
    assert not list(own_cache.iterdir())


@needs_compiler
def test_bad_calls_are_refused(model, data):
    compiled = load_c(model)
    for rows in (data.data[:, :5], data.data[0, :5], data.data[None], 1.0):
        with pytest.raises(ValueError, match=r"takes rows of 6 numbers, .*; got shape \("):
            compiled.predict(rows)
    with pytest.raises(ValueError, match="without its deviation: std=True"):
        compiled.predict_std(data.data[0])
    with pytest.raises(TypeError, match="std must be"):
        load_c(model, std="yes")


@needs_compiler
def test_the_source_is_that_of_export_c(model, tmp_path):
    source, _ = export_c(model, tmp_path / "model.c")
    assert load_c(model)._state[0][0] == source.read_text()
