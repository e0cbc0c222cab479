"""What a check of a correction is worth: false alarms, found changes, and stated deviations.

    python benchmarks/bench_check.py changes --real       # two minutes
    python benchmarks/bench_check.py kinds --real         # ten minutes
    python benchmarks/bench_check.py deviations           # two minutes

``changes``: a simulated measuring arm with eccentric encoders, whose model has learned 500 poses,
is checked with 40 poses of another day against a tracker (noise 15 um): without a change, after a
knock of one joint (1 to 5 in turn), with a loose probe, and 5 K warmer.

``kinds``: arms whose errors no model describes completely. Simulated single-point tests: 12 cones
are learnt, and 6 others of the same arm, 10 poses each, are checked on another day, as they are and
with one joint knocked (2 to 4 in turn). Tracker series: the base settles by 40 um or drifts by that
much.

``deviations``: the arms of ``kinds`` measure spheres of 25 points and lengths. What the corrections
leave of the arm's true errors changes the fitted diameter and the length: root mean square of the
error over the stated standard deviation, which should be 1, by what such a test shows of all poses
together, by all that the model knows (``with_unseen=True``), and as though points were independent.

With ``--real`` the same is asked of other poses of a real UR10 and two Pandas: no model of them is
complete. The data are downloaded, or read from the folder that SKLEARN_RAACMM_DATA names.
"""

import argparse
import warnings
from dataclasses import replace
from functools import partial

import numpy as np
from _arm_folds import DATA, arm_model
from bench_after_the_lab import read

from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate, check_correction
from sklearn_raacmm.datasets import (
    ArmErrors,
    SimulatedArm,
    fetch_panda_ball_socket,
    make_single_point,
)

ARCSEC = np.pi / 180 / 3600
RATE = 0.01
TYPICAL = ArmErrors()
KINDS = {
    "typical": TYPICAL,
    "soft elbow": replace(TYPICAL, softening_arcsec=30.0),
    "wobble": replace(TYPICAL, wobble_arcsec=12.0, runout_um=8.0),
    "hysteresis": replace(TYPICAL, play_arcsec=6.0),
    "gravity": ArmErrors.from_name("gravity"),
}


def knock(arm, arcsec):
    def change(angles, rng, run):
        return arm.jacobian(angles)[
            :, :, run % 5
        ] * arcsec * ARCSEC, f"offset of joint {run % 5 + 1}"

    return change


def changes_of_a_day(arm, noise_mm):
    """Name, function of the change, and what is fitted to the same poses."""
    both = ("base", "probe")
    yield "none", lambda q, rng, run: (0.0, "nothing"), ()
    yield "none, base and probe refitted", lambda q, rng, run: (0.0, "nothing"), both
    for arcsec in (5, 10, 20):
        yield f"knock of {arcsec} arc seconds", knock(arm, arcsec), ()
    yield "knock of 20 arc seconds, base and probe refitted", knock(arm, 20), both
    loose = 4 / 3 * noise_mm
    yield f"loose probe, {1000 * loose:.0f} um more noise", lambda q, rng, run: (
        rng.normal(0, loose, (len(q), 3)), "noise"), ()  # fmt: skip
    yield "5 K warmer, steel", lambda q, rng, run: (-arm.forward(q) * 11.7e-6 * 5, "scale"), ()


def table(arm, model, poses, noise_mm, runs):
    """Print the rates; `poses(run)` gives angles and residuals of another day."""
    print(f"{'change':50}{'alarms':>9}{'named rightly':>16}")
    for name, change, refitted in changes_of_a_day(arm, noise_mm):
        n_runs = 4 * runs if name.startswith("none") else runs
        alarms = right = 0
        for run in range(n_runs):
            rng = np.random.default_rng([1, run])
            angles, y = poses(run)
            # Of a knock of joint 1 or 5 nothing may be left beside a fitted base and probe.
            moved, cause = change(angles, rng, 1 + run % 3 if refitted else run)
            check = check_correction(
                model, angles, y + moved, refitted=refitted, false_alarm_rate=RATE
            )
            alarms += not check.holds
            right += not check.holds and check.suspect == cause
        print(f"{name:50}{alarms / n_runs:8.1%}{f'{right} of {alarms}':>17}", flush=True)


def poses_of_simulated_arm(arm, seed, n=40):
    """Angles and residuals of an arm with eccentric encoders."""
    rng = np.random.default_rng([2, seed])
    angles = rng.uniform(-2, 2, (n, 6))
    turn = np.zeros_like(angles)
    turn[:, 0] = 8 * np.sin(angles[:, 0])
    turn[:, 1] = 12 * np.cos(angles[:, 1])
    turn[:, 3] = 8 * np.cos(2 * angles[:, 3] - 1)
    y = np.einsum("nij,nj->ni", arm.jacobian(angles), turn * ARCSEC)
    return angles, y + rng.normal(0, 0.015, y.shape)


def simulated_tracker():
    """The simulated arm of tracker series, its model, and its poses of a day."""
    arm = Arm.from_name("aacmm6")
    model = arm_model(arm, orders=12).fit(*poses_of_simulated_arm(arm, 10**6, 500))
    return arm, model, partial(poses_of_simulated_arm, arm)


def ur10(n_learned):
    """The UR10, its model of some poses, and 40 others of its series in their order."""
    angles, points = read("A", DATA / "ur10_tracker")
    order = np.random.default_rng(0).permutation(len(angles))
    rows, others = order[:n_learned], order[n_learned:]
    first = calibrate(Arm.from_name("ur10", probe=(0, 0, 93)), angles[rows], points=points[rows])
    model = arm_model(first.arm).fit(angles[rows], first.residuals_mm)

    def poses(run):
        some = np.sort(np.random.default_rng([3, run]).choice(others, 40, replace=False))
        return angles[some], first.residuals(angles[some], points[some])

    return first.arm, model, poses


def changes(options):
    """Part ``changes``."""
    print("Simulated measuring arm, 40 poses")
    arm, model, poses = simulated_tracker()
    table(arm, model, poses, 0.015, options.runs)
    if options.real:
        arm, model, poses = ur10(3000)
        noise_mm = model.linear_model_.noise_scale * model.noise_sd_
        print(f"UR10, 40 other poses of its series, noise {1000 * noise_mm:.0f} um")
        table(arm, model, poses, noise_mm, options.runs)


class Count:
    """Alarms and right names of one kind."""

    def __init__(self):
        self.n = self.alarms = self.right = self.small = 0

    def add(self, check, cause):
        """Count one check, whose right cause is known."""
        self.n += 1
        self.alarms += not check.holds
        self.right += not check.holds and check.suspect == cause
        self.small += not (check.holds or check.matters)

    def __str__(self):
        named = f"{self.right} of {self.alarms}" if self.right else ""
        return f"{self.alarms:4} of {self.n:4} {self.alarms / self.n:6.1%}{named:>14}{self.small:7}"


def say(kind, change, count):
    print(f"{kind:14}{change:28}{count}", flush=True)


def single_points(kind, errors, arms, days):
    """Rates of one kind of arm."""
    counts = {name: Count() for name in ("none", "knock of 10 arc seconds")}
    for seed in range(arms):
        machine = SimulatedArm(errors, random_state=seed)
        known = make_single_point(12, 30, machine=machine, random_state=seed)
        model = ArmResidualRegressor(known.arm).fit(known.data, known.target, groups=known.groups)
        for day in range(days):
            new = make_single_point(6, 10, machine=machine, random_state=1000 * (day + 1) + seed)
            joint = 1 + (seed + day) % 3
            knock = known.arm.jacobian(new.data)[:, :, joint] * 10 * ARCSEC
            for name, moved, cause in (
                ("none", 0.0, "nothing"),
                ("knock of 10 arc seconds", knock, f"offset of joint {joint + 1}"),
            ):
                check = check_correction(
                    model, new.data, new.target + moved, groups=new.groups, false_alarm_rate=RATE
                )
                counts[name].add(check, cause)
    for name, count in counts.items():
        say(kind, name, count)


def changes_of_a_series(arm, angles, rng, run):
    """Changes of tracker series, and the causes that are to be named."""
    shift = rng.normal(size=3)
    shift *= 0.04 / np.linalg.norm(shift)
    joint = 1 + run % 3
    yield "none", 0.0, "nothing"
    yield "base settled by 40 um", shift, "base"
    yield "base drifts by 40 um", np.linspace(-0.5, 0.5, len(angles))[:, None] * shift * 2, "drift"
    knock = arm.jacobian(angles)[:, :, joint] * 10 * ARCSEC
    yield "knock of 10 arc seconds", knock, f"offset of joint {joint + 1}"


def series(kind, arm, model, poses, runs):
    counts = {}
    for run in range(runs):
        angles, y = poses(run)
        for name, moved, cause in changes_of_a_series(
            arm, angles, np.random.default_rng([7, run]), run
        ):
            check = check_correction(model, angles, y + moved, false_alarm_rate=RATE)
            counts.setdefault(name, Count()).add(check, cause)
    for name, count in counts.items():
        say(kind, name, count)


def pandas(runs):
    """Half of the places learnt, the others checked; without "high" of panda_2, which moved."""
    for name in ("panda_2", "panda_3"):
        data, count = fetch_panda_ball_socket(name, data_home=DATA), Count()
        knocked = Count()
        labels = np.unique(data.groups)
        labels = labels[~((name == "panda_2") & np.char.startswith(labels.astype(str), "high"))]
        for run in range(runs):
            rng = np.random.default_rng([5, run])
            mixed = rng.permutation(labels)
            known, rest = (np.isin(data.groups, h) for h in np.array_split(mixed, 2))
            found = calibrate(data.arm, data.data[known], data.groups[known])
            model = arm_model(found.arm)
            model.fit(data.data[known], found.residuals_mm, groups=data.groups[known])
            if not model.helps_:
                continue
            y = found.residuals(data.data[rest], groups=data.groups[rest])
            joint = 1 + run % 3
            knock = found.arm.jacobian(data.data[rest])[:, :, joint] * 40 * ARCSEC
            for moved, where, cause in (
                (0.0, count, "nothing"), (knock, knocked, f"offset of joint {joint + 1}"),
            ):  # fmt: skip
                where.add(
                    check_correction(
                        model, data.data[rest], y + moved, groups=data.groups[rest],
                        false_alarm_rate=RATE,
                    ), cause,
                )  # fmt: skip
        say(name, "none", count)
        say(name, "knock of 40 arc seconds", knocked)


def kinds(options):
    """Part ``kinds``."""
    print(f"{'':14}{'change':28}{'alarms':>20}{'named rightly':>14}{'small':>7}")
    series("tracker", *simulated_tracker(), options.runs)
    for kind, errors in KINDS.items():
        single_points(kind, errors, options.arms, options.days)
    if options.real:
        series("UR10", *ur10(5956), options.runs)
        pandas(max(options.runs // 10, 5))


def sphere(machine, rng):
    """Poses at 25 points of a sphere of 50 mm somewhere."""
    for _ in range(100):
        place = rng.uniform([300, -500, 0], [900, 500, 400])
        normals = rng.normal(size=(25, 3))
        normals[:, 2] = np.abs(normals[:, 2])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        try:
            poses = [machine.find_poses(place + 25 * n, 1, rng.randint(2**31)) for n in normals]
        except ValueError:
            continue
        return np.concatenate(poses), normals
    raise ValueError("no place for a sphere was found")


def of_diameter(normals):
    """Derivatives (3 n,) of the diameter that least squares fit, by the points."""
    design = np.column_stack([normals, np.ones(len(normals))])
    weights = 2 * np.linalg.pinv(design)[3]
    return (weights[:, None] * normals).ravel()


def of_length(points):
    line = points[1] - points[0]
    line = line / np.linalg.norm(line)
    return np.r_[-line, line]


def one_arm(errors, seed, n_spheres):
    """Errors over standard deviations of diameters and lengths: shown, all, independent."""
    machine = SimulatedArm(errors, random_state=seed)
    known = make_single_point(12, 30, machine=machine, random_state=seed)
    model = ArmResidualRegressor(known.arm).fit(known.data, known.target, groups=known.groups)
    rng = np.random.RandomState(seed)
    found = []
    for _ in range(n_spheres):
        poses, normals = sphere(machine, rng)
        far = sphere(machine, rng)[0][:1]
        row = []
        for angles, is_sphere in ((poses, True), (np.vstack([poses[:1], far]), False)):
            g = of_diameter(normals) if is_sphere else of_length(known.arm.forward(angles))
            true = known.arm.forward(angles) - machine.forward(angles)
            for unseen in (False, True):
                mean, cov = model.predict(angles, return_cov=True, with_unseen=unseen)
                error = g @ (true - mean).ravel()
                row.append(error / np.sqrt(g @ cov @ g))
            row.append(error / np.sqrt(np.square(g) @ cov.diagonal()))
        found.append(row)
    return found


def deviations(options):
    """Part ``deviations``."""
    ways = [f"{what}, {way}" for what in ("diameter", "length")
            for way in ("shown", "all", "independent")]  # fmt: skip
    print(f"{'':14}" + "".join(f"{way:>23}" for way in ways))
    for kind, errors in KINDS.items():
        z = np.concatenate([
            one_arm(errors, seed, options.spheres) for seed in range(options.arms)
        ])  # fmt: skip
        rms = np.sqrt(np.mean(np.square(z), axis=0))
        print(f"{kind:14}" + "".join(f"{value:23.2f}" for value in rms), flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", choices=["changes", "kinds", "deviations"])
    parser.add_argument("--arms", type=int, default=6, help="of each kind, simulated")
    parser.add_argument("--days", type=int, default=6, help="checks of each arm")
    parser.add_argument("--runs", type=int, default=60, help="of each change or series")
    parser.add_argument("--spheres", type=int, default=10, help="of each arm")
    parser.add_argument("--real", action="store_true", help="the real robots, too")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    {"changes": changes, "kinds": kinds, "deviations": deviations}[options.part](options)


if __name__ == "__main__":
    main()
