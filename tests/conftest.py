"""Fixtures of the whole suite: the real data sets, read once, and skipped clearly where absent."""

import hashlib
import importlib
import os
import shutil
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg  # noqa: F401  (SciPy's BLAS has to be there to be limited)
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

# Before pytest collects a module of the package for its examples: one that came first would be
# imported twice, and what the tests call would not know its classes.
import sklearn_raacmm  # noqa: F401
from sklearn_raacmm import Arm
from sklearn_raacmm.datasets import _acceptance, _generators
from sklearn_raacmm.utils import _rows

ROOT = Path(__file__).resolve().parent.parent
# Files, and functions that take a second of CPU time or more, found by ``pytest --durations``.
SLOW = {*(ROOT / "tests" / "slow.txt").read_text(encoding="utf-8").split()}

# The suite runs in parallel: two workers with two BLAS threads each on two cores wait for one
# another most of the time. `.ci/run kernels` asks for more.
threadpool_limits(int(os.environ.get("OPENBLAS_NUM_THREADS", 1)), user_api="blas")


def pytest_addoption(parser):
    parser.addoption(
        "--chunk-rows",
        type=int,
        metavar="N",
        help="compute everything in chunks of N rows, so that small data cross their borders, too",
    )
    parser.addoption(
        "--exhaustive",
        action="store_true",
        help="run the tests marked exhaustive, too, which take many minutes",
    )
    parser.addoption(
        "--part",
        metavar="K/N",
        help="of the tests marked exhaustive only every Nth, from the Kth on; K counts from 0",
    )


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Each worker takes a run of files, so that few fixtures of a file are made by both."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log)


def pytest_configure(config):
    _rows.LIMIT = config.getoption("--chunk-rows")
    if not hasattr(config, "workerinput"):  # the workers of xdist are started with this variable
        os.environ[CALIBRATED] = tempfile.mkdtemp()
    _acceptance.calibrated_arm = _generators.calibrated_arm = calibrated_once


def pytest_unconfigure(config):
    if not hasattr(config, "workerinput"):
        shutil.rmtree(os.environ.pop(CALIBRATED), ignore_errors=True)


# The folder of arms that were calibrated in this run of pytest.
CALIBRATED = "SKLEARN_RAACMM_CALIBRATED"
_calibrated_arm = _generators.calibrated_arm


def calibrated_once(machine):
    """Calibrate a simulated arm, or read what another file of tests or worker made of its equal.

    A calibration takes as long as ten usual tests, and many files simulate the same arm.
    """
    tables = [
        getattr(arm, name).tolist()
        for arm in (machine.nominal_arm, machine.true_arm)
        for name in ("a", "alpha", "d", "theta_offset", "probe", "up")
    ]
    what = repr((_rows.LIMIT, machine.errors, machine.calibration_seed, tables))
    path = Path(os.environ[CALIBRATED], hashlib.sha256(what.encode()).hexdigest())
    if not path.exists():
        _calibrated_arm(machine).to_json(path)  # in one step, should both workers be here
    return Arm.from_json(path)


def pytest_collection_modifyitems(config, items):
    for item in items:
        file = item.path.relative_to(ROOT).as_posix()
        if {file, f"{file}::{getattr(item, 'originalname', '')}"} & SLOW:
            item.add_marker(pytest.mark.slow)
    left_out = [item for item in items if item.get_closest_marker("exhaustive")]
    if config.getoption("--exhaustive"):
        k, n = map(int, (config.getoption("--part") or "0/1").split("/"))
        left_out = [item for i, item in enumerate(left_out) if i % n != k % n]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        gone = set(left_out)
        items[:] = [item for item in items if item not in gone]


def data_dir(name):
    """Folder of a real data set: SKLEARN_RAACMM_DATA, or ../shared/data beside the project."""
    folder = Path(os.environ.get("SKLEARN_RAACMM_DATA", ROOT.parent / "shared" / "data")) / name
    if not folder.is_dir():
        pytest.skip(f"real data not found: {folder} (set SKLEARN_RAACMM_DATA)")
    return folder


def read_panda(folder):
    """Angles (n, 7) rad, groups "placement/hole", placements and tool poses of a Panda's test.

    Tool poses (n, 7) are the controller's x, y, z in m and quaternion w, x, y, z; NaN in sockets
    where the authors' two files have different numbers of rows.
    """
    angles, groups, placements, poses = [], [], [], []
    for path in sorted(folder.glob("*/hole_[01].csv")):
        q = np.loadtxt(path, delimiter=",", ndmin=2)
        pose = np.loadtxt(path.with_name(f"{path.stem}_pose.csv"), delimiter=",", ndmin=2)
        placement, hole = path.parent.name, path.stem[-1]
        angles.append(q)
        groups += [f"{placement}/{hole}"] * len(q)
        placements += [placement] * len(q)
        poses.append(pose if len(pose) == len(q) else np.full((len(q), 7), np.nan))
    return SimpleNamespace(
        angles=np.concatenate(angles),
        groups=np.array(groups),
        placements=np.array(placements),
        tool_poses=np.concatenate(poses),
    )


def read_ur10(path):
    """Commanded angles (n, 6) rad, the tracker's points in mm, goals, and temperature in degC."""
    header, *lines = path.read_text(encoding="utf-8-sig").splitlines()
    table = np.array(
        [[float(field.replace(",", ".")) for field in line.split(";")] for line in lines]
    )
    # The second series has standard deviations between the coordinates.
    place = [header.split(";").index(f"measurement_{axis}") for axis in "xyz"]
    _, groups = np.unique(table[:, 1:4].round(6), axis=0, return_inverse=True)
    return SimpleNamespace(
        angles=table[:, 7:13],
        points=table[:, place],
        groups=groups.ravel(),
        temperature=table[:, 13],
    )


@pytest.fixture(scope="session")
def data_folder():
    """Return ``data_folder(name)``: the folder of a real data set, see `data_dir`."""
    return data_dir


@pytest.fixture(scope="session")
def panda():
    """Return ``panda(arm)``: a reader of "panda_2" or "panda_3", see `read_panda`."""
    read = {}

    def get(arm):
        if arm not in read:
            read[arm] = read_panda(data_dir("panda_ball_socket") / arm)
        return read[arm]

    return get


@pytest.fixture(scope="session")
def ur10():
    """The UR10's tracker series, see `read_ur10`."""
    return read_ur10(data_dir("ur10_tracker") / "measurements_grid.csv")


@pytest.fixture(scope="session")
def ur10_b():
    """The UR10's second series, see `read_ur10`."""
    path = data_dir("ur10_tracker") / "measurements_joint_configurations.csv"
    return read_ur10(path)


@pytest.fixture
def script(monkeypatch):
    """Return ``script(name)``: a module of doc/ or benchmarks/, which is forgotten afterwards."""
    folders = ROOT / "doc", ROOT / "benchmarks"
    for folder in folders:
        monkeypatch.syspath_prepend(folder)
    monkeypatch.setattr(os, "environ", os.environ.copy())  # scripts set the number of threads
    before = set(sys.modules)
    yield importlib.import_module
    for name in set(sys.modules) - before:
        if any((folder / f"{name}.py").exists() for folder in folders):
            del sys.modules[name]


@pytest.fixture(scope="session")
def matrices():
    """Homogeneous matrices (4, 4), in mm: `pose` and, of an arm at angles (n, n_joints), `ends`."""

    def pose(turn, shift):
        """Pose of a rotation vector and a shift."""
        found = np.eye(4)
        found[:3, :3], found[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), shift
        return found

    def ends(arm, q):
        """Poses (n, 4, 4) of the probe with the axes of the last frame."""
        found = np.tile(np.eye(4), (len(q), 1, 1))
        found[:, :3] = arm.frames(q)[:, -1]
        return found @ pose([0, 0, 0], arm.probe)

    return SimpleNamespace(pose=pose, ends=ends)
