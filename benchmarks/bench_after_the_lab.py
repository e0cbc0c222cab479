"""A correction on another day, with another probe, at a first test, and on a new arm of the make.

    python benchmarks/bench_after_the_lab.py transfer --panda    # three minutes, as the others

``series``: a model of series A of a real UR10 on series B, with tracker and target set up anew:
mean deviation at the other poses of B, median of five draws. ``months``: a simulated robot with
errors that no column describes; then every offset has moved by 10 arc seconds, its eccentricity by
4, the arm is 3 K warmer, base and tool are new. ``probes``: learnt with a probe of 100 mm at 14
cones, or with 100 and 250 mm at 7 each; longer ones are registered by 15 poses in two cones, and
judged at 8 others. ``registers``: few poses of the probe that was learnt with, and of others.
``stated``: probes 100 to 250 mm from the one learnt with at 12 cones, whose vectors are stated: at
8 other cones what is left of the deviation, mean and worst, and inside intervals of 95 %.
``plan``: mean 2S at 8 other cones after a first test of 8 cones with 12 poses.
``transfer``: robots of one make share gears and compliances; models of four are the start for a new
one. The misleading make has other gears, hardly any eccentricity, and compliances of the other
sign. ``mounts``: 2S at positions left out of arms on walls and ceilings, where ``up`` is stated and
where the data find it; also over that of the same arm upright, of the worst arm. ``knocks``: one
change of ten arms each, shown by three cones of ten poses; 2S at eight other cones. And of robots
that a tracker sees in 20 poses; mean deviation at 300 others.
"""

from copy import copy
from itertools import product
from types import SimpleNamespace

import numpy as np
from _arm_folds import (
    ARCSEC,
    DATA,
    MIXES,
    MOVED,
    NOMINAL_PANDA,
    UR10,
    learn,
    learn_tracked,
    mean_deviation,
    read_panda,
    read_ur10,
    run_part,
    scatter,
    show,
)
from scipy.spatial.transform import Rotation

from sklearn_raacmm import (
    ArmResidualRegressor,
    calibrate,
    check_correction,
    learn_correction,
    plan_poses,
    position_residuals,
    update_correction,
)
from sklearn_raacmm.correction._change import LEAST_GAIN_NATS, transferred_model
from sklearn_raacmm.datasets import SimulatedArm, make_single_point
from sklearn_raacmm.metrics import single_point_repeatability
from sklearn_raacmm.utils import Groups

NOISE_MM = 0.03
# What has changed: joint from 0, arc seconds, and whether it is an eccentricity or an offset.
KNOCKS = {
    "offset of joint 2": (1, 30.0, False),
    "offset of joint 4": (3, 30.0, False),
    "offset of joint 5": (4, 40.0, False),
    "eccentricity of joint 3": (2, 30.0, True),
}
JITTER_ARCSEC = 60.0
PROBES_MM = (100, 150, 250, 400)
STATED_MM = ((100, 0, 0), (0, 175, 0), (170, 180, 0), (0, 0, 150))
# Of registrations: how far the probe is from the one learnt with, and cones and poses in each.
OTHER_PROBES_MM = (0.0, 0.02, 0.05, 0.1, 40.0)
FEW_POSES = ((1, 3), (1, 5), (2, 5))


def left_another_day(model, arm, known, others):
    """What is left at other poses: without correction, registered without it, through it, updated.

    `known` and `others` are angles and points.
    """
    angles, points = known
    alone = calibrate(arm, angles, points=points, free=["probe"])
    through = calibrate(arm, angles, points=points, free=["probe"], correction=model)
    updated = update_correction(model, angles, through.residuals(*known))
    bare, registered = alone.residuals(*others), through.residuals(*others)
    old, new = (m.predict(others[0]) for m in (model, updated))
    return [bare, bare - old, registered - old, registered - new]


def known_of_series_b(arm, model, n, seeds, data_home=DATA):
    """Medians of the same over draws of n poses of series B."""
    angles, points, _ = read_ur10("B", data_home)
    draws = []
    for seed in seeds:
        known = np.zeros(len(angles), bool)
        known[np.random.default_rng(seed).permutation(len(angles))[:n]] = True
        parts = [(angles[some], points[some]) for some in (known, ~known)]
        draws.append([mean_deviation(left) for left in left_another_day(model, arm, *parts)])
    return np.median(draws, axis=0)


def series(options):
    angles, points, _ = read_ur10("A")
    first, model = learn_tracked(UR10, angles, points)
    seeds, counts = range(options.seeds or 5), (10, 20, 60, 200)
    rows = {n: known_of_series_b(first.arm, model, n, seeds) for n in counts}
    ways = ("no correction", "registered without it", "registered through it", "updated")
    return show("poses of B known; mm", ways, rows)


class WornRobot:
    """A robot with errors of its own, before and after the months."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.amplitude, self.phase = rng.normal(0, 30, (6, 3)), rng.uniform(0, 6, (6, 3))
        self.cross = rng.normal(0, 3, (6, 6))
        self.offsets = rng.choice([-10.0, 10.0], 6)
        self.wear, self.wear_phase = rng.normal(0, 4, 6), rng.uniform(0, 6, 6)
        self.tool = rng.normal(0, 20, 3)
        self.turn = Rotation.from_rotvec(rng.normal(0, 0.5, 3)).as_matrix()

    def measure(self, angles, rng, months):
        """Points in the tracker's frame."""
        turns = np.cos(angles) @ self.cross * np.sin(np.roll(angles, 1, axis=1))
        for k in range(3):
            turns += self.amplitude[:, k] / (k + 1) * np.cos((k + 1) * angles - self.phase[:, k])
        turns[:, 0] += 10 * np.sin(17 * angles[:, 0])
        turns[:, 2] += 8 * np.cos(100 * angles[:, 2])
        arm = UR10
        if months:
            turns += self.offsets + self.wear * np.cos(angles - self.wear_phase)
            arm = arm.replace(probe=arm.probe + self.tool)
        points = arm.forward(angles)
        points = points - np.einsum("nij,nj->ni", arm.jacobian(angles), turns * ARCSEC)
        points *= 1 + 11.7e-6 * 3 * months
        if months:
            points = points @ self.turn.T + [1500, -300, 200]
        return points + rng.normal(0, NOISE_MM, points.shape)


def one_robot(seed, n_new):
    """Mean deviation, mm: no correction, registered, updated, new fits of a fifth and of all."""
    robot, rng = WornRobot(seed), np.random.default_rng([1, seed])
    old, new, far = (rng.uniform(-2, 2, (n, 6)) for n in (1500, n_new, 500))
    first, model = learn_tracked(UR10, old, robot.measure(old, rng, 0))
    points, true = robot.measure(new, rng, 1), robot.measure(far, rng, 1)
    few = new[: n_new // 5], points[: n_new // 5]
    bare, _, registered, updated = left_another_day(model, first.arm, few, (far, true))
    left = [bare, registered, updated]
    for angles, measured in (few, (new, points)):
        fresh, own = learn_tracked(UR10, angles, measured)
        left.append(fresh.residuals(far, true) - own.predict(far))
    return [mean_deviation(rest) for rest in left]


def months(options):
    names = ("no correction", "registered", "updated", "new fit, a fifth", "new fit, all")
    robots = range(options.seeds or 2)
    rows = {n: np.mean([one_robot(seed, n) for seed in robots], axis=0) for n in (100, 300, 500)}
    return show("poses of a new fit; mm", names, rows)


def with_probe(machine, length):
    """The same simulated arm with another probe."""
    other, more = copy(machine), np.array([0.0, 0.0, length - 100.0])
    for name in ("nominal_arm", "true_arm"):
        arm = getattr(machine, name)
        setattr(other, name, arm.replace(probe=arm.probe + more))
    other.reach = machine.reach + more[2]
    return other


def cone_test(machine, seed, n_positions, n_poses):
    test = make_single_point(n_positions, n_poses, machine=machine, random_state=seed)
    return test.data, test.groups


def left_um(arm, model, angles, groups):
    points = arm.forward(angles)
    if model is not None:
        points = points - model.predict(angles)
    return 1000 * single_point_repeatability(points, groups)


def fitted(arm, angles, groups):
    found = calibrate(arm, angles, groups, **MOVED)
    y = position_residuals(found.arm.forward(angles), groups)
    return found.arm, ArmResidualRegressor(found.arm).fit(angles, y, groups=groups)


def fitted_to_two(machine, seed):
    """The model of 7 cones with a probe of 100 mm and 7 others with one of 250 mm."""
    tests = [
        cone_test(with_probe(machine, length), seed + 50 * i, 7, 30)
        for i, length in enumerate((100, 250))
    ]
    angles = np.concatenate([test[0] for test in tests])
    groups = np.concatenate([test[1] + 7 * i for i, test in enumerate(tests)])
    tools = np.repeat([0, 1], [len(test[0]) for test in tests])
    found = calibrate(machine.nominal_arm, angles, groups, tools=tools)
    y = found.residuals(angles, groups=groups, tools=tools)
    probes = np.array([found.arms[tool].probe for tool in tools])
    return ArmResidualRegressor(found.arm).fit(angles, y, groups=groups, probes=probes)


def with_longer_probes(seed):
    machine = SimulatedArm("typical", random_state=seed)
    arm, model = fitted(machine.nominal_arm, *cone_test(machine, seed, 14, 30))
    of_two = fitted_to_two(machine, seed)
    rows = []
    for length in PROBES_MM:
        own, more = with_probe(machine, length), np.array([0, 0, length - 100.0])
        angles, groups = cone_test(own, 100 + seed, 2, 8)

        def registered(start, way, more=more, angles=angles, groups=groups):
            start = start.replace(probe=start.probe + more)
            known = angles[:15], groups[:15]
            return calibrate(start, *known, correction=way, free=["probe"]).arm

        # A model that stays with the probe that it was fitted with.
        stays = SimpleNamespace(predict=model.predict)
        alone, old, moved = (registered(arm, way) for way in (None, stays, model))
        both = registered(of_two.arm_, of_two)
        test = cone_test(own, 200 + seed, 8, 25)
        new_arm, new = fitted(own.nominal_arm, *cone_test(own, 300 + seed, 14, 30))
        ways = [(alone, None), (old, model), (moved, model.with_arm(moved))]
        ways += [(both, of_two.with_arm(both)), (new_arm, new)]
        rows.append([left_um(*way, *test) for way in ways])
    return rows


def probes(options):
    table = np.mean([with_longer_probes(seed) for seed in range(options.seeds or 4)], axis=0)
    ways = ("uncorrected", "not moved", "moved", "learnt with two, moved", "new fit")
    return show("probe, mm; 2S in um", ways, dict(zip(PROBES_MM, table, strict=True)))


def stated(options):
    found = {}
    for seed in range(300, 300 + (options.seeds or 8)):
        machine = SimulatedArm(MIXES[seed % len(MIXES)], random_state=seed)
        arm, model = fitted(machine.nominal_arm, *cone_test(machine, seed, 12, 20))
        for more in STATED_MM:
            own = copy(machine)
            own.true_arm = machine.true_arm.replace(probe=machine.true_arm.probe + more)
            own.reach = machine.reach + np.linalg.norm(more)
            angles, groups = cone_test(own, 400 + seed, 8, 20)
            other = arm.replace(probe=arm.probe + more)
            y = position_residuals(other.forward(angles), groups)
            moved = model.with_arm(other, stated=True)
            mean, std = moved.predict(angles, return_std=True, with_noise=True)
            left = position_residuals(y - mean, groups)
            of_none, held = mean_deviation(left) / mean_deviation(y), np.abs(left) < 1.96 * std
            found.setdefault(more, []).append((of_none, np.mean(held)))
    rows = {}
    for more, values in found.items():
        of_none, inside = np.transpose(values)
        rows[f"off by {more} mm"] = of_none.mean(), of_none.max(), inside.mean(), inside.min()
    show("stated probes", ("of none", "worst", "inside", "least"), rows)


def registers(options):
    """The probe found by few poses alone, and by a registration, which may keep the old one."""
    found = {}
    for seed in range(options.seeds or 6):
        machine = SimulatedArm(MIXES[seed % len(MIXES)], random_state=seed)
        learned = learn_correction(machine.nominal_arm, *cone_test(machine, seed, 12, 20), cv=3)
        way = np.random.default_rng([60, seed]).normal(size=3)
        for off, (n_cones, n_poses) in product(OTHER_PROBES_MM, FEW_POSES):
            own, more = copy(machine), off * way / np.linalg.norm(way)
            own.true_arm = machine.true_arm.replace(probe=machine.true_arm.probe + more)
            new = cone_test(own, 100 + seed, n_cones, n_poses)
            test = cone_test(own, 200 + seed, 8, 20)
            known = {"free": ["probe"], "correction": learned.model}
            alone = calibrate(learned.arm, *new, **known).arm
            registered = learned.register(*new)
            kept = np.array_equal(registered.arm.probe, learned.arm.probe)
            left = [left_um(alone, learned.model.with_arm(alone), *test)]
            left += [left_um(registered.arm, registered.model, *test), 100 * kept]
            found.setdefault(f"{n_cones * n_poses} poses, off by {off:g} mm", []).append(left)
    ways = ("by the poses alone", "registered", "old probe kept, %")
    show("2S in um", ways, {name: np.mean(values, axis=0) for name, values in found.items()})


def read(machine, plan, seed, angles=None):
    """Angles and labels of a plan as the machine reads them, the probe seated anew each time."""
    angles = plan.angles if angles is None else angles
    rng, cones = np.random.RandomState(seed), plan.positions[plan.groups - 1]
    cones = cones + machine.errors.seating_um / 1000 * rng.normal(size=cones.shape)
    return machine.read(machine.solve(angles, cones), rng), plan.groups


def plan(options):
    found = {}
    for seed in range(options.seeds or 8):
        machine = SimulatedArm("typical", random_state=seed)
        leaning, free = (
            plan_poses(machine.nominal_arm, 8, 12, lean_deg=lean, random_state=seed)
            for lean in (60.0, None)
        )
        other = plan_poses(machine.nominal_arm, 8, 25, lean_deg=60, random_state=99)
        spread = np.concatenate([machine.find_poses(p, 12, seed) for p in leaning.positions])
        judged = cone_test(machine, 1000 + seed, 8, 25), read(machine, other, 1)
        tests = {
            "by chance": cone_test(machine, seed, 8, 12),
            "spread cones": read(machine, leaning, 2, spread),
            "planned, lean 60": read(machine, leaning, 2),
            "planned": read(machine, free, 2),
        }
        for name, test in tests.items():
            learned = fitted(machine.nominal_arm, *test)
            found.setdefault(name, []).append([left_um(*learned, *rows) for rows in judged])
    rows = {name: np.mean(values, axis=0) for name, values in found.items()}
    return show("first test; 2S in um", ("poses by chance", "of another plan"), rows)


class Robot:
    """An individual of a make; its nominal table is the UR10's."""

    def __init__(self, make, seed, misleading=False, up=(0, 0, 1)):
        common, own = (np.random.default_rng(part) for part in ([7, make], [8, make, seed]))
        self.nominal = UR10.replace(up=up)
        change = {f: getattr(self.nominal, f) + own.normal(0, 0.2, 6) for f in ("a", "d")}
        for field, sd in (("alpha", 3e-4), ("theta_offset", 5e-4)):
            change[field] = getattr(self.nominal, field) + own.normal(0, sd, 6)
        self.arm = self.nominal.replace(**change)
        ratios = (50, 80, 100, 101, 120, 128, 160)
        self.gears = np.repeat(common.choice(ratios, 2, replace=False), 3)
        self.teeth = common.uniform(6, 15, 6) * own.uniform(0.7, 1.3, 6)
        self.teeth_phase = own.uniform(0, 6.28, 6)
        self.eccentric = own.normal(0, 25, (6, 2)) * [1, 0.4]
        self.phase = own.uniform(0, 6.28, (6, 2))
        self.compliance = common.uniform(20, 80, 6) * own.uniform(0.9, 1.1, 6)
        self.cross = common.normal(0, 3, (6, 6)) + own.normal(0, 2, (6, 6))
        self.turn = Rotation.from_rotvec(own.normal(0, 0.5, 3)).as_matrix()
        if misleading:
            self.eccentric, self.teeth = 0.1 * self.eccentric, 2 * self.teeth
            self.compliance = -3 * self.compliance

    def measure(self, angles, rng, noise_mm=NOISE_MM):
        """Points in the tracker's frame."""
        turns = np.cos(angles) @ self.cross * np.sin(np.roll(angles, 1, axis=1))
        for k in range(2):
            turns += self.eccentric[:, k] * np.cos((k + 1) * angles - self.phase[:, k])
        turns += self.teeth * np.cos(self.gears * angles - self.teeth_phase)
        jacobian = self.arm.jacobian(angles)
        # The torque of a weight at the probe.
        turns += self.compliance * (self.arm.up @ jacobian) / 1200
        points = self.arm.forward(angles) - np.einsum("nij,nj->ni", jacobian, turns * ARCSEC)
        return points @ self.turn.T + [1500, -300, 200] + rng.normal(0, noise_mm, points.shape)

    def learn(self, n, rng):
        """Model of this arm from some poses."""
        angles = rng.uniform(-2, 2, (n, 6))
        return learn_tracked(self.nominal, angles, self.measure(angles, rng))[1]


def compare_starts(starts, arm, near, far):
    """What a new fit leaves, and what each start leaves and whether it is believed.

    `near` and `far` are angles, residuals and labels, or None, of what is learnt and judged.
    """
    (angles, y, groups), (others, true, labels) = near, far

    def left(model):
        rest = true - model.predict(others)
        return mean_deviation(rest) if labels is None else scatter(rest, labels)

    row = {"calibrated": mean_deviation(true)}
    row["new fit"] = left(ArmResidualRegressor(arm).fit(angles, y, groups=groups))
    for name, models in starts.items():
        moved = transferred_model(models, arm, angles, y, groups=groups)
        row[name] = left(moved)
        row[f"{name}, believed"] = moved.updates_[0]["gain_nats"] >= LEAST_GAIN_NATS
    return row


def show_starts(title, table):
    columns = next(iter(table.values()))[0]
    rows = {n: [np.mean([row[c] for row in rows]) for c in columns] for n, rows in table.items()}
    return show(title, columns, rows)


def transfer_robots(seeds):
    rng, counts = np.random.default_rng(0), (10, 20, 40, 100, 400)
    earlier = [Robot(0, 100 + i).learn(600, rng) for i in range(4)]
    misleading = [Robot(3, 200 + i, misleading=True).learn(600, rng) for i in range(4)]
    starts = {"of 4": earlier, "of 1": earlier[:1], "misleading": misleading}
    table = {n: [] for n in counts}
    for seed in range(seeds):
        robot, rng = Robot(0, seed), np.random.default_rng([5, seed])
        far, new = rng.uniform(-2, 2, (500, 6)), rng.uniform(-2, 2, (max(counts), 6))
        far_points, points = robot.measure(far, rng, 0.0), robot.measure(new, rng)
        for n in counts:
            found = calibrate(robot.nominal, new[:n], points=points[:n])
            judged = far, found.residuals(far, far_points), None
            near = new[:n], found.residuals_mm, None
            table[n].append(compare_starts(starts, found.arm, near, judged))
    return show_starts("robots: poses; mm", table)


def transfer_measuring_arms(seeds):
    """Single-point tests; the deviation is that within 6 other positions."""
    earlier = []
    for seed in range(100, 104):
        test = make_single_point(24, 20, random_state=seed)
        model = ArmResidualRegressor(test.arm).fit(test.data, test.target, groups=test.groups)
        earlier.append(model)
    starts = {"of 4": earlier, "of 1": earlier[:1]}
    table = {n: [] for n in (1, 2, 4, 8)}
    for seed in range(seeds):
        test = make_single_point(16, 20, random_state=seed)
        for n, rows in table.items():
            parts = [
                (test.data[some], test.target[some], test.groups[some])
                for some in (test.groups < n, test.groups >= 10)
            ]
            rows.append(compare_starts(starts, test.arm, *parts))
    return show_starts("arms: positions; mm", table)


def transfer_pandas(draws):
    for old, new in (("panda_2", "panda_3"), ("panda_3", "panda_2")):
        angles, groups, _ = read_panda(old)
        starts = {"of 1": [fitted(NOMINAL_PANDA, angles, groups)[1]]}
        angles, groups, _ = read_panda(new)
        labels, table = np.unique(groups), {n: [] for n in (1, 2, 4)}
        for draw in range(draws):
            order = np.random.default_rng(draw).permutation(len(labels))
            for n, rows in table.items():
                known = np.isin(groups, labels[order[:n]])
                found = calibrate(NOMINAL_PANDA, angles[known], groups[known], **MOVED)
                parts = [
                    (angles[some], found.residuals(angles[some], groups=groups[some]), groups[some])
                    for some in (known, ~known)
                ]
                rows.append(compare_starts(starts, found.arm, *parts))
        show_starts(f"{new} from {old}; mm", table)


def transfer(options):
    found = transfer_robots(options.seeds or 5)
    found |= transfer_measuring_arms(options.seeds or 5)
    if options.panda:
        transfer_pandas(2)
    return found


MOUNTS = {"upright": (0, 0, 1), "ceiling": (0, 0, -1), "45 degrees": (1, 0, 1), "wall": (1, 0, 0)}


def left_by(arms, X, y, groups, train):
    """Mean 2S, um, at positions left out: without a model, and with one for each of some arms."""
    lefts = [y[~train], *(learn(arm, X, y, groups, train)[1] for arm in arms)]
    return [1000 * single_point_repeatability(left, groups[~train]) for left in lefts]


def mounted_measuring_arm(seed, up):
    """A single-point test with gravity, every third of 24 cones left out."""
    machine = SimulatedArm("gravity", random_state=seed, up=up)
    test = make_single_point(24, 25, machine=machine, random_state=seed)
    arms = test.arm, test.arm.replace(up=(0, 0, 1))
    return left_by(arms, test.data, test.target, test.groups, test.groups % 3 > 0)


def mounted_robot(seed, up):
    """A robot and a tracker: 300 poses learnt, and 24 others at each of 12 points."""
    robot, rng = Robot(0, seed, up=up), np.random.default_rng([10, seed])
    start = rng.uniform(-2, 2, (12, 6))
    groups = np.repeat(np.arange(12), 24)
    aim = robot.nominal.forward(start)[groups]
    near = start[groups] + rng.normal(0, 0.5, (len(groups), 6))
    others, _ = robot.nominal.solve(aim, near)
    found = np.isfinite(others[:, 0])
    X = np.vstack([rng.uniform(-2, 2, (300, 6)), others[found]])
    train = np.arange(len(X)) < 300
    groups = np.r_[np.arange(100, 400), groups[found]]
    points = robot.measure(X, rng)
    result = calibrate(robot.nominal, X[train], points=points[train])
    y = result.residuals(X, points)
    return left_by((result.arm, result.arm.replace(up=(0, 0, 1))), X, y, groups, train)


def mounts(options):
    names = ("no correction", "up stated", "up found")
    for title, measure in (("cone test", mounted_measuring_arm), ("tracker", mounted_robot)):
        every = {
            mount: np.array([measure(seed, up) for seed in range(options.seeds or 5)])
            for mount, up in MOUNTS.items()
        }
        show(f"{title}: 2S, um", names, {m: values.mean(axis=0) for m, values in every.items()})
        worst = {m: (values / every["upright"]).max(axis=0) for m, values in every.items()}
        show(f"{title}: over upright, worst arm", names, worst)


def changed_angles(kind, angles, rng):
    """What the encoders say after a change, where they said `angles` before."""
    angles = angles.copy()
    if kind == "jitter":
        return angles + rng.normal(0, JITTER_ARCSEC * ARCSEC, angles.shape)
    if kind != "nothing":
        joint, size, waves = KNOCKS[kind]
        wave = np.cos(angles[:, joint] - rng.uniform(0, 2 * np.pi)) if waves else 1.0
        angles[:, joint] += size * ARCSEC * wave
    return angles


def named_alone(kind, model, known, others):
    """2S at other positions with the change itself by least squares beside the old model, um.

    Of an eccentricity the waves of orders 1 and 2, which a check names as one.
    """
    joint, _, waves = KNOCKS[kind]
    (angles, y, groups), (far, y_far, far_groups) = known, others

    def columns(angles):
        turn = model.arm_.jacobian(angles)[:, :, joint, None]
        phase = angles[:, None, joint, None] * np.array([1, 2])
        return turn * np.concatenate([np.cos(phase), np.sin(phase)], axis=2) if waves else turn

    own = Groups(np.unique(groups, return_inverse=True)[1]).centred(columns(angles))
    left = position_residuals(y - model.predict(angles), groups)
    coef = np.linalg.lstsq(own.reshape(left.size, -1), left.ravel(), rcond=None)[0]
    return repeatability_um(y_far - model.predict(far) - columns(far) @ coef, far_groups)


def repeatability_um(left, groups):
    return 1e3 * np.mean(single_point_repeatability(left, groups, aggregate=None))


def one_knocked_arm(seed):
    """For each kind of change: 2S before it, after it, updated and named alone; the last check."""
    test = make_single_point(21, 20, machine=MIXES[seed % len(MIXES)], random_state=7000 + seed)
    learnt, far = test.groups < 10, test.groups >= 13
    new = np.flatnonzero((test.groups >= 10) & ~far).reshape(3, -1)[:, :10].ravel()
    arm = calibrate(test.nominal_arm, test.data[learnt], test.groups[learnt]).arm
    model = ArmResidualRegressor(arm)
    y = position_residuals(arm.forward(test.data), test.groups)
    model.fit(test.data[learnt], y[learnt], groups=test.groups[learnt])
    found = {}
    was = repeatability_um(y[far] - model.predict(test.data[far]), test.groups[far])
    for kind in (*KNOCKS, "jitter", "nothing"):
        parts = []
        for rows in (new, far):
            angles = changed_angles(kind, test.data[rows], np.random.default_rng([32, seed]))
            if kind == "jitter" and rows is far:  # what is judged is the arm, not its noise
                angles = test.data[rows]
            groups = test.groups[rows]
            parts.append((angles, position_residuals(arm.forward(angles), groups), groups))
        (angles, y_new, groups), (others, y_far, far_groups) = parts
        updated = update_correction(model, angles, y_new, groups=groups, accept="strange-poses")
        of = (repeatability_um(y_far - m.predict(others), far_groups) for m in (model, updated))
        alone = named_alone(kind, model, *parts) if kind in KNOCKS else was
        holds = check_correction(updated, angles, y_new, groups=groups).holds
        found[kind] = [was, *of, alone, float(holds)]
    return found


def one_knocked_robot(seed, n_new=20):
    """For each kind of change: mean deviation before it, after it, and updated, um."""
    robot, rng = Robot(seed % 3, 900 + seed), np.random.default_rng([50, seed])
    learnt, far, new = (rng.uniform(-2, 2, (n, 6)) for n in (300, 300, n_new))
    first, model = learn_tracked(robot.nominal, learnt, robot.measure(learnt, rng))

    def shown(kind, angles, noise_mm=NOISE_MM):
        """What the encoders say, and the tracker."""
        read = changed_angles(kind, angles, np.random.default_rng([32, seed]))
        return read, robot.measure(angles, np.random.default_rng([3, seed]), noise_mm)

    def left(registered, correction, kind):
        angles, points = shown(kind, far, 0.0)
        return 1e3 * mean_deviation(
            registered.residuals(angles, points) - correction.predict(angles)
        )

    found, was = {}, left(first, model, "nothing")
    for kind in (*KNOCKS, "nothing"):
        angles, points = shown(kind, new)
        given = {"points": points, "free": ["probe"], "correction": model}
        through = calibrate(first.arm, angles, **given)
        updated = update_correction(model, angles, through.residuals(angles, points))
        found[kind] = [was, *(left(through, one, kind) for one in (model, updated))]
    return found


def knocks(options):
    arms = [one_knocked_arm(seed) for seed in range(options.seeds or 10)]
    columns = ("2S before, um", "old model", "updated", "the change alone", "check holds")
    columns += ("worst over the change alone", "worst over old", "holds above 1.2 of before")
    rows = {}
    for kind in arms[0]:
        found = np.array([arm[kind] for arm in arms])
        was, old, updated, alone, holds = found.T
        false = np.sum((holds > 0) & (updated > 1.2 * was))
        worst = np.max(updated / alone), np.max(updated / old)
        rows[kind] = [*found.mean(axis=0), *worst, false]
    show("three cones of ten poses after a change", columns, rows)
    robots = [one_knocked_robot(seed) for seed in range(options.seeds or 6)]
    rows = {kind: np.mean([robot[kind] for robot in robots], axis=0) for kind in robots[0]}
    columns = ("mean deviation before, um", "old model, registered", "updated")
    show("20 poses by a tracker after a change", columns, rows)


def main():
    parts = series, months, probes, stated, registers, plan, transfer, mounts, knocks
    run_part(__doc__, parts, seeds=None, panda=False)


if __name__ == "__main__":
    main()
