"""Simulated touches of balls and planes; public in `sklearn_raacmm.datasets`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from sklearn.utils import check_random_state, check_scalar

from sklearn_raacmm.datasets._arm_errors import ArmErrors
from sklearn_raacmm.datasets._generators import draw_cones, machine_and_stream, measure
from sklearn_raacmm.datasets._simulation import SimulatedArm, directions_at
from sklearn_raacmm.utils import floats

# Standard deviations of a certificate, mm: the size of a ball, and the length of a block.
_SIZE_SD_MM, _BLOCK_SD_MM = 0.001, 0.0005
# Half the side of a plate, and of the face of a block, mm.
_PLATE_MM, _FACE_MM = 100.0, 4.5


def make_features(
    n_spheres: int = 5,
    n_planes: int = 5,
    n_cones: int = 0,
    n_touches: int = 25,
    *,
    size: float = 30.0,
    blocks: ArrayLike = (),
    tip_diameter: float = 0.0,
    machine: SimulatedArm | ArmErrors | str = "typical",
    random_state: int | np.random.RandomState | None = 0,
) -> Any:
    """Simulate touches of balls and of plates, as a user without cones has them.

    Parameters
    ----------
    n_spheres, n_planes, n_cones : int, default=5, 5 and 0
        Features of each kind: balls of known size that are touched on their upper half, plates of
        200 mm that are touched all over and face all directions, and cones; at places as those of
        :func:`make_single_point`.
    n_touches : int, default=25
        Touches of each feature, and of each face of a block; at least 5.
    size : float, default=30.0
        Diameter of the balls, mm.
    blocks : array-like of shape (n_blocks,), default=()
        Lengths in mm of gauge blocks, whose two faces are two planes each.
    tip_diameter : float, default=0.0
        Diameter of the probe's own ball, mm.
    machine, random_state
        As in :func:`make_single_point`; with the same int the individual is the same.

    Returns
    -------
    data : :class:`~sklearn.utils.Bunch`
        As :func:`make_single_point`, where a position is a feature, and:

        features : list of (int, str) and (int, str, float, float)
            Label and kind of each feature, and of a ball its size with its standard deviation, mm,
            as :func:`calibrate` takes them.
        lengths : list of (int, int, float, float)
            The two faces of each block, its length, and its standard deviation, mm.

    Raises
    ------
    ValueError
        If a number is too small, the machine is unknown, or no reachable place is found.

    Examples
    --------
    >>> from sklearn_raacmm.datasets import make_features
    >>> test = make_features(n_spheres=2, n_planes=1, n_touches=10)
    >>> test.data.shape, test.features
    ((30, 6), [(0, 'sphere', 30.0, 0.001), (1, 'sphere', 30.0, 0.001), (2, 'plane')])
    """
    for name, n in (("n_spheres", n_spheres), ("n_planes", n_planes), ("n_cones", n_cones)):
        check_scalar(n, name, Integral, min_val=0)
    check_scalar(n_touches, "n_touches", Integral, min_val=5)
    blocks = np.atleast_1d(floats("blocks", blocks))
    if not (size > 0 and tip_diameter >= 0 and (blocks > 0).all()):
        raise ValueError(
            f"size and blocks must be above 0 mm and tip_diameter not below, got {size!r}, "
            f"{blocks!r:.60} and {tip_diameter!r}."
        )
    simulated, rng = machine_and_stream(machine, random_state, stream=4)
    n = n_spheres + n_planes + n_cones + len(blocks)
    if n == 0:
        raise ValueError("n_spheres, n_planes, n_cones and blocks are all 0: nothing is touched.")
    # Places, poses and noise are the same whatever is touched there.
    touched = check_random_state(rng.randint(2**31 - 1))
    places, poses = draw_cones(simulated, n, 2 * n_touches, rng)
    kinds = ["sphere"] * n_spheres + ["plane"] * n_planes + ["cone"] * n_cones
    groups: list[int] = []
    features: list[tuple[int, str] | tuple[int, str, float, float]] = []
    points, near, lengths = [], [], []
    for kind, place, own in zip([*kinds, *blocks], places, poses, strict=True):
        label = groups[-1] + 1 if groups else 0
        height, azimuth = touched.uniform(size=n_touches), touched.uniform(-np.pi, np.pi, n_touches)
        out = directions_at(height, azimuth)  # over the upper half
        one = [np.zeros((n_touches, 3))]
        if kind == "sphere":
            one = [(size + tip_diameter) / 2 * out]
            features.append((label, kind, size, _SIZE_SD_MM))
        elif kind == "plane":
            one = [_square(n_touches, _PLATE_MM, touched) @ _turn(touched)]
            features.append((label, kind))
        elif not isinstance(kind, str):
            turn, half = _turn(touched), (kind + tip_diameter) / 2
            one = [
                (_square(n_touches, _FACE_MM, touched) + np.array([0, 0, at])) @ turn
                for at in (-half, half)
            ]
            features += [(label, "plane"), (label + 1, "plane")]
            lengths.append((label, label + 1, float(kind), _BLOCK_SD_MM))
        for i, face in enumerate(one):
            points.append(place + face)
            near += [pose[None] for pose in own[i::2]]
            groups += [label + i] * n_touches
    every = np.concatenate(points)
    data = measure(simulated, every, near, rng, np.array(groups), features)
    data.update(features=features, lengths=lengths)
    return data


def _square(n, half, rng):
    """Points (n, 3) of a level square about the origin."""
    return np.column_stack([rng.uniform(-half, half, (n, 2)), np.zeros(n)])


def _turn(rng):
    """Rotation (3, 3) of what is level to any direction."""
    tilt, azimuth = rng.uniform(-np.pi / 2, np.pi / 2), rng.uniform(-np.pi, np.pi)
    return Rotation.from_euler("XZ", [-tilt, -azimuth]).as_matrix()
