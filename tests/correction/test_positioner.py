"""Learning of an arm whose part is carried by a positioner, with a tracker fixed to the table."""

import numpy as np
import pytest

from sklearn_raacmm import Arm, learn_correction

ARCSEC = np.pi / 180 / 3600
NOISE_MM, N = 0.02, 300
ROBOT = Arm.from_name("ur10", probe=(20, 30, 192.2))
TILTS = Arm.from_degrees([0, 0], [90, -90], [0, 300], convention="modified", probe=(0, 0, 50))
TURNS = Arm.from_degrees([0], [0], [700], probe=(0, 0, 50))


class Cell:
    """A UR10 and a positioner as they were built: lengths, angles and base are a little off.

    Joints turn by their encoders' eccentricity, and by the torque of weights at some frames.
    """

    def __init__(self, table, seed, matrices):
        self.matrices, pose = matrices, matrices.pose
        self.rng = rng = np.random.default_rng(seed)
        base = [0.0, 0.0, 0.5], [1000.0, 200.0, -300.0]
        self.arm, self.n = ROBOT.seen_from(table, pose(*base)), table.n_joints
        self.robot, self.table = self.built(ROBOT), self.built(table)
        self.base = pose(base[0] + rng.normal(0, 0.003, 3), base[1] + rng.normal(0, 3, 3))
        self.size, self.phase = rng.uniform(5, 15, (2, 8)), rng.uniform(-3, 3, (2, 8))

    def built(self, arm):
        off = {"a": 0.3, "d": 0.3, "alpha": 0.002, "theta_offset": 0.002}
        n = arm.n_joints
        return arm.replace(
            **{field: getattr(arm, field) + self.rng.normal(0, sd, n) for field, sd in off.items()}
        )

    def turned(self, arm, q, weights, compliance):
        """True angles of an arm whose encoders show q, under weights at frames in N."""
        n, first = arm.n_joints, int(arm.convention == "modified")
        waves = np.cos(q + self.phase[0, :n]), np.cos(2 * q + self.phase[1, :n])
        q = q + ARCSEC * (self.size[0, :n] * waves[0] + self.size[1, :n] * waves[1])
        frames, torques = arm.frames(q), np.zeros(q.shape)
        axes, origins = (frames[:, first : n + first, :, k] for k in (2, 3))
        for k, weight in weights.items():
            levers = frames[:, k, None, :, 3] - origins[:, :k]
            moments = np.cross(levers, -weight * arm.up)
            torques[:, :k] += np.einsum("njc,njc->nj", axes[:, :k], moments)
        return q + compliance * torques

    def poses(self, n):
        q = self.rng.uniform(-1, 1, (n, 6)) * [1.5, 1, 1.2, 2, 2, 3]
        e = self.rng.uniform(-1, 1, (n, 2))[:, -self.n :] * np.array([1, 3])[-self.n :]
        return np.hstack([e[:, ::-1], np.add(q, [3.6, -1.2, 1.2, -1, -1.5, 0])])

    def points(self, angles):
        """Where the probe is, as seen from the table, (n, 3) mm."""
        weights, stiff = {2: 100, 3: 60, 5: 30, 6: 20}, np.array([2, 6, 6, 3, 3, 3]) * 1e-9
        q = self.turned(self.robot, angles[:, self.n :], weights, stiff)
        e = self.turned(self.table, angles[:, self.n - 1 :: -1], {self.n: 300}, 3e-9)
        table, robot = self.matrices.ends(self.table, e), self.matrices.ends(self.robot, q)
        seen = np.linalg.inv(table) @ self.base @ robot
        return seen[:, :3, 3]


@pytest.mark.parametrize(("table", "seed"), [(TILTS, 0), (TURNS, 1)], ids=["tilts", "turns"])
def test_what_is_left_at_places_unseen_is_near_the_share_of_the_noise(table, seed, matrices):
    cell = Cell(table, seed, matrices)
    angles, unseen = cell.poses(N), cell.poses(1000)
    points = cell.points(angles) + cell.rng.normal(0, NOISE_MM, (N, 3))
    found = learn_correction(cell.arm, angles, points=points, cv=2)
    y, model = found.calibration.residuals(unseen, cell.points(unseen)), found.model
    mean, std = model.predict(unseen, return_std=True, with_noise=True)
    left, bare = (np.sqrt(np.mean(np.square(one))) for one in (y - mean, y))
    assert left < 1.4 * NOISE_MM * np.sqrt(model.n_determined_ / (3 * N))
    assert left < 0.1 * bare
    inside = np.abs(y + cell.rng.normal(0, NOISE_MM, y.shape) - mean) < 1.96 * std
    assert 0.9 < inside.mean() < 0.98
    assert model.linear_model_.terms.up == ()  # no other vertical was found than the stated one
