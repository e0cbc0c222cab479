"""What goes wrong around the library: interrupts, full disks and memory, damaged files.

An interrupted refit leaves the old model, what was saved before stays whole, and what is damaged is
refused. That nothing that is read is run, ruff checks (rules S and TID251 in ``pyproject.toml``).
"""

import gc
import inspect
import json
import os
import pickle
import sys
import weakref

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from numpy.testing import assert_array_equal
from sklearn.base import clone
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
)
from sklearn_raacmm.export import export_c, to_onnx
from sklearn_raacmm.utils import write_whole

ARM = Arm.from_name("aacmm6")
NETWORK = RBFNetRegressor(5, length_scale=1.0, alpha=0.01)
CHAIN = make_pipeline(PoseFeatures(ARM, append_azimuth=True), CylindricalResidualTarget(NETWORK))


def data(n):
    angles = np.arange(1, n + 1)[:, None] * np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0, 13.0]) % 1 - 0.5
    return angles, 0.05 * np.cos(angles[:, :3])


# -- interrupts ------------------------------------------------------------------------------------

PACKAGE = f"{os.sep}sklearn_raacmm{os.sep}"


class Interrupt(BaseException):
    """What no `except Exception` catches, as Ctrl-C."""


def calls(function, at=None):
    """Number of calls of the package, or by it; None where the function is interrupted at one."""
    count = 0

    def count_call(frame, event, arg):
        nonlocal count
        # An exception in a generator that is being closed is lost.
        if event != "call" or frame.f_code.co_flags & inspect.CO_GENERATOR:
            return
        if any(f and PACKAGE in f.f_code.co_filename for f in (frame, frame.f_back)):
            count += 1
            if count == at:
                raise Interrupt

    sys.setprofile(count_call)
    try:
        function()
    except Interrupt:
        return None
    finally:
        sys.setprofile(None)
    return count


def refits():
    """A fitted model, a refit of it on other data, and what is predicted."""
    rng = np.random.default_rng(0)
    X, y = rng.uniform(-1, 1, (30, 6)), rng.normal(size=(30, 3))
    named = pd.DataFrame(rng.uniform(-1, 1, (20, 7)), columns=list("abcdefg"))
    pose = PoseFeatures(ARM).fit(X)
    pose.set_params(arm=Arm.from_name("panda"))
    yield pose, lambda: pose.fit(named), lambda: pose.transform(X)
    inner = make_pipeline(StandardScaler(), Ridge())
    chain = CylindricalResidualTarget(inner, azimuth=ARM.azimuth).fit(X, y)
    other = named.set_axis([f"x{i}" for i in range(7)], axis=1).assign(c=1.0, s=0.0)

    def refit():
        chain.set_params(azimuth="appended").fit(other, rng.normal(size=20))

    # Parameters are the user's own: only what was fitted has to be as before.
    yield chain, refit, lambda: chain.set_params(azimuth=ARM.azimuth).predict(X)


def state(estimator):
    return {name: value for name, value in vars(estimator).items() if name != "azimuth"}


@pytest.mark.parametrize("case", [0, 1], ids=["pose", "chain"])
def test_an_interrupted_refit_leaves_the_old_model(case):
    """Interrupted at every call, or at the first ones and an even choice of the others."""
    estimator, refit, predict = list(refits())[case]
    before, kept, expected = state(estimator), dict(vars(estimator)), predict()
    # Twice: what is computed once and then kept makes the second fit shorter.
    total = min(calls(list(refits())[case][1]) for _ in range(2))
    assert total > 11
    for at in sorted(
        {*range(1, 20), *np.linspace(20, max(20, 0.75 * total), 40, dtype=int).tolist()}
    ):
        was_interrupted = calls(refit, at) is None
        now = state(estimator)
        if was_interrupted and now.keys() == before.keys():
            assert all(now[name] is before[name] for name in now), f"call {at} of {total}"
            assert_array_equal(predict(), expected)
        else:
            # How many calls there are depends on what is kept between fits and on the collection
            # of garbage, in which Python ignores exceptions: the fit came to its end, or to the
            # swap of the old model for the new.
            assert at > total // 2, f"call {at} of {total} was never made"
            estimator.__dict__ = dict(kept)
    refit()
    assert state(estimator).keys() != before.keys() or np.abs(predict() - expected).max() > 1e-3


# -- memory ----------------------------------------------------------------------------------------

MODELS = {
    "network": NETWORK,
    "network that tunes itself": RBFNetRegressor(5, random_state=0),
    "chain": CHAIN,
    # Orders that these data never show: the number of columns stays the same.
    "harmonics": ArmResidualRegressor(ARM, orders=[50, 51], causes=["kinematics", "wobble"]),
}


@pytest.mark.parametrize("name", MODELS)
def test_a_fitted_model_does_not_keep_its_data(name):
    X, y = data(80)
    kept = [weakref.ref(array) for array in (X, y)]
    model = MODELS[name].fit(X, y)
    del X, y
    gc.collect()
    assert [ref() for ref in kept] == [None, None]
    # Nor a copy of X or y, nor three numbers a row: 100 rows more would show.
    small = len(pickle.dumps(model))
    large = len(pickle.dumps(model.fit(*data(180))))
    assert large - small < 100 * 3 * 8


# -- files -----------------------------------------------------------------------------------------


@pytest.mark.skipif(os.name == "nt", reason="limits of POSIX")
def test_full_disk_leaves_what_was_there(tmp_path):
    pytest.importorskip("onnx", reason="needs the extra onnx")
    resource = pytest.importorskip("resource")
    model = clone(CHAIN).fit(*data(40))
    ARM.to_json(tmp_path / "arm.json")
    export_c(model, tmp_path / "model.c")
    to_onnx(model, tmp_path / "model.onnx")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert len(before) == 4
    assert min(map(len, before.values())) > 300
    _, hard = limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    for act in (
        lambda: ARM.replace(name="other").to_json(tmp_path / "arm.json"),
        lambda: export_c(model, tmp_path / "model.c", name="other"),
        lambda: to_onnx(model, tmp_path / "model.onnx", card="other"),
    ):
        # The system itself refuses to write more, as it does where the disk is full.
        resource.setrlimit(resource.RLIMIT_FSIZE, (300, hard))  # bytes, less than any file
        try:
            with pytest.raises(OSError, match="File too large"):
                act()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.skipif(os.name == "nt", reason="permissions of POSIX")
def test_a_file_keeps_its_permissions_and_a_link_stays_a_link(tmp_path):
    path, link = tmp_path / "file.txt", tmp_path / "link.txt"
    mask = os.umask(0o022)
    try:
        write_whole({path: "first"})
        assert path.stat().st_mode & 0o777 == 0o644
        path.chmod(0o640)
        link.symlink_to(path)
        write_whole({link: "second"})
    finally:
        os.umask(mask)
    assert link.is_symlink()
    assert path.read_text() == "second"
    assert path.stat().st_mode & 0o777 == 0o640


def test_a_folder_in_place_of_a_file_is_named(tmp_path):
    with pytest.raises(IsADirectoryError, match=r"A file is to be written, .* folder: .*\.$"):
        ARM.to_json(tmp_path)
    with pytest.raises(FileNotFoundError, match="No such folder"):
        ARM.to_json(tmp_path / "nowhere" / "arm.json")


# -- files of arms ---------------------------------------------------------------------------------

TEXT = ARM.to_json()


def changed(**fields):
    return json.dumps(json.loads(TEXT) | fields)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TEXT.replace('"d_mm"', '"x_mm"'), "lacks the field 'd_mm'"),
        (changed(format="x"), "not an arm"),
        (changed(probe_mm=[0, 0, True]), "probe_mm must hold numbers"),
        (changed(alpha_rad=[float("nan")] * 6), r"alpha\[0\] = nan is out of bounds"),
        (changed(format_version="1"), "format_version '1'"),
        (changed(a_m=[1, 2, 3, 4, 5, 6]), "unknown field 'a_m'"),
        (changed(d_mm=[10**400] * 6), "d must hold numbers"),
        (changed(a_mm={"0": 1}), "a must|a_mm must"),
        (changed(probe_mm=[[0, 0, 1]]), r"3 numbers, got shape \(1, 3\)"),
        (changed(pose_joints=[3, 1e300]), "pose_joints must be two"),
        ('{"a":' * 10**5, "not valid JSON"),
        (TEXT.replace("[", "[\"__import__('os').abort()\",", 1), "a must hold numbers"),
        ("[]", None),
    ],
)
def test_damaged_arm_gets_one_clear_sentence(text, message, tmp_path):
    path = tmp_path / "arm.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=message or "not an arm") as caught:
        Arm.from_json(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


plain = st.none() | st.booleans() | st.integers() | st.floats() | st.text()
anything = st.recursive(plain, lambda x: st.lists(x) | st.dictionaries(st.text(), x), max_leaves=8)


@settings(
    derandomize=True,
    max_examples=60,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],  # a matter of what else the machine does
)
@given(st.sampled_from(sorted(json.loads(TEXT))), anything)
def test_any_file_is_an_arm_within_bounds_or_refused(field, value):
    try:
        arm = Arm.from_json(changed(**{field: value}))
    except ValueError:
        return
    for lengths in (arm.a, arm.d, arm.probe):
        assert np.all(np.abs(lengths) <= 1e5)
    for angles in (arm.alpha, arm.theta_offset):
        assert np.all(np.abs(angles) <= 2 * np.pi)
    assert np.all(np.isfinite(arm.forward(np.zeros((1, arm.n_joints)))))
