"""Open data of real arms, measured and published by others; public in `sklearn_raacmm.datasets`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from datetime import datetime
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.datasets import get_data_home

# The public `fetch_file` does the same, but refuses addresses of local files.
from sklearn.datasets._base import RemoteFileMetadata, _fetch_remote
from sklearn.utils import Bunch

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.calibration import calibrate
from sklearn_raacmm.datasets._simulation import directions_of
from sklearn_raacmm.measurements import position_residuals
from sklearn_raacmm.utils import digest_of, param_checks

# Checksum of each file, by its name.
_LINES = Path(__file__).with_name("_sha256.txt").read_text(encoding="utf-8").splitlines()
SHA256 = {name: checksum for checksum, name in map(str.split, _LINES)}
PANDA_URL = (
    "https://raw.githubusercontent.com/platonics-delft/kinematics_calibration/"
    "05a05ab4cbbe328c8f5bfcc76479c752ed07b82e/data"
)
UR10_URL = (
    "https://raw.githubusercontent.com/christianlandgraf/ipa-robot-accuracy/"
    "507fba69bdaf6c43c2faf306e70a7e37c5e39b89/Series_A"
)
HOLES_MM, HOLES_SD_MM = 50.0, 0.1  # between the two sockets of a placement; the sd is our guess
_GOAL, _JOINTS, _TEMPERATURE, _POINT = slice(1, 4), slice(7, 13), 13, slice(14, 17)

_CONSTRAINTS = {"data_home": [str, PathLike, None], "download_if_missing": ["boolean"]}


@param_checks.validate_params(
    _CONSTRAINTS | {"arm": [param_checks.StrOptions({"panda_2", "panda_3"})]},
    prefer_skip_nested_validation=True,
)
def fetch_panda_ball_socket(
    arm: str = "panda_3",
    *,
    data_home: str | PathLike[str] | None = None,
    download_if_missing: bool = True,
) -> Any:
    """Load the single-point test of a real arm: a Franka Panda with a ball in sockets.

    Downloads up to 100 kB the first time: data of the MUKCa project, arXiv:2503.12584 (MIT
    licence).

    Parameters
    ----------
    arm : {"panda_3", "panda_2"}, default="panda_3"
        Which of the two robots: 387 poses at 6 placements of a pair of sockets, or 559 poses at 9,
        with outliers.
    data_home : str or path-like, default=None
        Folder to keep the files in, under ``panda_ball_socket``. None: the folder of
        :func:`sklearn.datasets.get_data_home`, usually ``~/scikit_learn_data``.
    download_if_missing : bool, default=True
        If False, raise an OSError where a file is not there or damaged.

    Returns
    -------
    data : :class:`~sklearn.utils.Bunch`
        As :func:`make_single_point`: ``data`` (n_poses, 7), ``target``, ``groups``, ``points``,
        ``arm``, calibrated on all rows and the known lengths (to judge a correction, calibrate
        without the placements left out, as ``benchmarks/make_results.py``),
        ``nominal_arm`` and names; and:

        placements : ndarray of shape (n_poses,)
            Label of the placement of the two sockets. Split by it, not by socket: the other socket
            is 50 mm away.
        lengths : list of (label, label, length, standard deviation)
            The 50 mm between the two sockets of each placement, for
            :func:`~sklearn_raacmm.calibrate`. The standard deviation of 0.1 mm is our guess.
        DESCR : str
            Description, source, licence, citation.

    Raises
    ------
    OSError
        If a file cannot be had, or is not byte for byte what its authors published.

    Warns
    -----
    UserWarning
        Before another try, and before a damaged file is replaced by a whole one.

    Examples
    --------
    >>> from sklearn_raacmm.datasets import fetch_panda_ball_socket
    >>> test = fetch_panda_ball_socket("panda_3")  # doctest: +SKIP
    >>> test.data.shape, test.target.shape  # doctest: +SKIP
    ((387, 7), (387, 3))
    """
    where = data_folder(data_home, "panda_ball_socket"), PANDA_URL, download_if_missing
    names = [name for name in SHA256 if name.startswith(arm)]
    tables = [np.loadtxt(cached_file(name, *where), delimiter=",", ndmin=2) for name in names]
    # Of "panda_3/backleft/hole_0.csv" the label is "backleft/0".
    labels = [f"{name.split('/')[1]}/{name[-len('0.csv')]}" for name in names]
    angles = np.concatenate(tables)
    groups = np.repeat(labels, [len(table) for table in tables])
    pairs = zip(labels[::2], labels[1::2], strict=True)
    lengths = [(a, b, HOLES_MM, HOLES_SD_MM) for a, b in pairs]
    nominal = Arm.from_name("panda", probe=(0, 0, 241))
    # Two sockets of panda_2 have moved.
    accept = "moved-position"
    calibrated = calibrate(nominal, angles, groups, lengths=lengths, accept=accept).arm
    points = calibrated.forward(angles)
    return Bunch(
        data=angles,
        target=position_residuals(points, groups),
        groups=groups,
        placements=np.array([label.split("/")[0] for label in groups]),
        points=points,
        arm=calibrated.replace(name=f"{arm}, calibrated"),
        nominal_arm=nominal,
        lengths=lengths,
        feature_names=[f"q{i}" for i in range(1, 8)],
        target_names=["dx", "dy", "dz"],
        DESCR=_description("_panda_ball_socket.rst"),
    )


@param_checks.validate_params(_CONSTRAINTS, prefer_skip_nested_validation=True)
def fetch_ur10_tracker(
    *,
    data_home: str | PathLike[str] | None = None,
    download_if_missing: bool = True,
) -> Any:
    """Load a real robot measured by a laser tracker: a UR10 at 619 goal positions.

    Downloads 2.4 MB the first time: data of C. Landgraf et al., IEEE CASE 2021 (MIT licence).

    Parameters
    ----------
    data_home, download_if_missing
        As in :func:`fetch_panda_ball_socket`; the folder is ``ur10_tracker``.

    Returns
    -------
    data : :class:`~sklearn.utils.Bunch`
        As :func:`make_single_point`: ``data`` (11911, 6), the commanded joint angles, rad,
        ``groups``, the numbers of the goal positions, ``temperature``, ``directions`` by the pose
        that was measured before, ``points``, ``arm``, calibrated on all rows (to judge a correction
        see ``benchmarks/make_results.py``), ``nominal_arm`` and names; and:

        target : ndarray of shape (11911, 3)
            Residuals dx, dy, dz in the arm's base frame, mm: what the calibrated arm shows minus
            what the tracker measured.
        tracker_points : ndarray of shape (11911, 3)
            Measured points in the tracker's frame, mm.
        time : ndarray of datetime64 of shape (11911,)
            When each pose was measured, to a second. Ten poses do not stand in this order.
        DESCR : str
            Description, source, licence, citation.

    Raises
    ------
    OSError
        If the file cannot be had, or is not byte for byte what its authors published.

    Examples
    --------
    >>> from sklearn_raacmm.datasets import fetch_ur10_tracker
    >>> test = fetch_ur10_tracker()  # doctest: +SKIP
    >>> test.data.shape, test.target.shape  # doctest: +SKIP
    ((11911, 6), (11911, 3))
    """
    where = data_folder(data_home, "ur10_tracker"), UR10_URL, download_if_missing
    path = cached_file("measurements_grid.csv", *where)
    # Semicolons between fields, decimal commas.
    lines = path.read_text(encoding="utf-8-sig").replace(",", ".").splitlines()[1:]
    table = np.loadtxt(lines, delimiter=";", usecols=range(_POINT.stop))
    angles, tracker_points = table[:, _JOINTS], table[:, _POINT]
    goals = np.unique(table[:, _GOAL].round(6), axis=0, return_inverse=True)[1].ravel()
    times = [datetime.strptime(line.split(";", 1)[0], "%Y%m%d%H%M%S") for line in lines]
    time = np.array(times, dtype="datetime64[s]")
    order = np.argsort(time, kind="stable")
    directions = np.empty_like(angles)
    directions[order] = directions_of(angles[order])
    nominal = Arm.from_name("ur10", probe=(0, 0, 93))
    result: Any = calibrate(nominal, angles, points=tracker_points)
    points = result.arm.forward(angles)
    return Bunch(
        data=angles,
        target=points - (tracker_points - result.base_translation) @ result.base_rotation,
        groups=goals,
        points=points,
        tracker_points=tracker_points,
        temperature=table[:, _TEMPERATURE],
        directions=directions,
        time=time,
        arm=result.arm.replace(name="ur10, calibrated"),
        nominal_arm=nominal,
        feature_names=[f"q{i}" for i in range(1, 7)],
        target_names=["dx", "dy", "dz"],
        DESCR=_description("_ur10_tracker.rst"),
    )


def data_folder(data_home, name):
    """Folder of a data set below scikit-learn's data folder or `data_home`."""
    if data_home is not None and Path(data_home).is_file():
        raise NotADirectoryError(f"data_home={str(data_home)!r} is a file; a folder is needed.")
    return Path(get_data_home(data_home)) / name


def cached_file(name, folder, address, download_if_missing, *, n_retries=3, delay=1.0):
    """Path of a file of `SHA256` below a folder, downloaded where it is not there or damaged."""
    path, url, sha256 = folder / name, f"{address.rstrip('/')}/{name}", SHA256[name]
    if not download_if_missing:
        if not path.is_file():
            raise OSError(f"{path} is not there, and download_if_missing=False.")
        if (checksum := digest_of(path.read_bytes())) != sha256:
            raise OSError(
                f"{path} has the SHA-256 checksum {checksum}, but {sha256} is expected: it was cut "
                "short or changed, and download_if_missing=False."
            )
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        remote = RemoteFileMetadata(path.name, url, sha256)
        return _fetch_remote(remote, path.parent, n_retries, delay)
    except OSError as error:
        raise OSError(f"{url} cannot be downloaded: {error}") from error


def _description(name):
    return Path(__file__).with_name(name).read_text(encoding="utf-8")
