"""Networks in C: processors that round in another way, and standard deviations."""

import platform
import re
import subprocess

import numpy as np
import pytest

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.export import _networks, export_c

from ._chains import COMPILERS, in_c, needs_compiler

pytestmark = needs_compiler


@pytest.fixture(scope="module")
def model():
    X = np.random.default_rng(0).uniform(-2, 2, (60, 2))
    return RBFNetRegressor(11, length_scale=1.0, alpha=0.01).fit(X, np.sin(X[:, 0]))


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("flags", [["-mfpmath=387"], ["-m32"], ["-O3"]], ids=" ".join)
def test_other_processors(model, tmp_path, compiler, flags):
    """With registers of 80 bits, too."""
    if flags != ["-O3"] and platform.machine() not in ("x86_64", "AMD64"):
        pytest.skip("options of x86")
    X = np.random.default_rng(1).uniform(-60, 60, (200, 2))
    X[:100] /= 30
    source, _ = export_c(model, tmp_path / "arm.c", poses=X)
    program, main = tmp_path / "main", tmp_path / "arm_test.c"
    command = [compiler, "-std=c99", "-O2", *flags, "-o", program, main, source, "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode and flags == ["-m32"]:
        pytest.skip("no libraries for 32 bits")
    if done.returncode and "387" in done.stderr and compiler == "clang":
        pytest.skip("this clang has no such option")
    assert done.returncode == 0, done.stderr
    printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    assert float(re.search(r"gap is (\S+)\.$", printed)[1]) < 1e-13


@pytest.mark.parametrize("noise", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize(
    "degree", [*(pytest.param(d, marks=pytest.mark.exhaustive) for d in (-1, 1)), 0]
)
def test_the_standard_deviation_of_data_with_little_noise(tmp_path, noise, degree):
    """The small difference of large numbers: to 1e-3 of itself, at training rows and elsewhere."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (120, 3))
    y = np.sin(X[:, 0]) * X[:, 1] + np.cos(X[:, 2])
    model = RBFNetRegressor(degree=degree).fit(X, y + noise * y.std() * rng.normal(size=120))
    new = np.concatenate([X, rng.uniform(-2.5, 2.5, (100, 3))])
    expected = model.predict(new, return_std=True)[1]
    assert expected.min() < 0.1 * expected.max()  # they say something
    np.testing.assert_allclose(
        in_c(tmp_path, COMPILERS[0], model, new, True)[1][:, 0], expected, rtol=1e-3
    )


@pytest.mark.exhaustive
def test_centres_that_the_kernel_cannot_tell_apart(tmp_path):
    """Fewer directions than centres: all centres count, where once the last were left out."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (300, 2))
    y = np.sin(3 * X[:, 0]) * np.cos(2 * X[:, 1]) + 1e-3 * rng.normal(size=300)
    model = RBFNetRegressor(kernel="gaussian", alpha=1e-8, length_scale=0.7).fit(X, y)
    assert len(model.networks_[0].prior_root) < len(model.centers_)
    new = rng.uniform(-1.2, 1.2, (100, 2))
    expected = model.predict(new, return_std=True)[1]
    np.testing.assert_allclose(
        in_c(tmp_path, COMPILERS[0], model, new, True)[1][:, 0], expected, rtol=0.05
    )


def test_too_many_centres_for_a_table_are_refused(model, tmp_path, monkeypatch):
    monkeypatch.setattr(_networks, "MOST_CENTERS", 10)
    with pytest.raises(ValueError, match="a network of 11 centres would need a table of"):
        export_c(model, tmp_path / "arm.c", std=True)
    assert export_c(model, tmp_path / "arm.c")


def test_outliers_count_in_the_standard_deviation(tmp_path):
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (150, 2))
    y = np.sin(X[:, 0]) + X[:, 1] ** 2 + 0.02 * rng.normal(size=150)
    y[::15] += 3
    model = RBFNetRegressor(loss="tukey", random_state=0).fit(X, y)
    std, near = (model.predict(X, True, with_outliers=with_)[1] for with_ in (True, False))
    assert np.all(std > 10 * near)
    found = in_c(tmp_path, COMPILERS[0], model, X, True)[1][:, 0]
    np.testing.assert_allclose(found, std, rtol=1e-9)
