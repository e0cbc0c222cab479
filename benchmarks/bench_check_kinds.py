"""False alarms and found knocks of a check, on arms whose errors no model describes completely.

Simulated single-point tests of several kinds of arms: 12 cones are learnt, and 6 others of the same
arm, 10 poses each, are checked on another day, as they are and with one joint knocked (2 to 4 in
turn). Tracker series: a simulated arm with eccentric encoders, whose base then settles by 40 um or
drifts by that much, and, with ``--real``, random halves of the UR10 and of the two Pandas.

Run it with ``python benchmarks/bench_check_kinds.py --real`` (ten minutes).
"""

import argparse
import warnings
from dataclasses import replace

import numpy as np
from _arm_folds import DATA, arm_model
from bench_after_the_lab import read
from bench_check import ARCSEC, RATE, poses_of_simulated_arm

from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate, check_correction
from sklearn_raacmm.datasets import (
    ArmErrors,
    SimulatedArm,
    fetch_panda_ball_socket,
    make_single_point,
)

TYPICAL = ArmErrors()
KINDS = {
    "typical": TYPICAL,
    "soft elbow": replace(TYPICAL, softening_arcsec=30.0),
    "wobble": replace(TYPICAL, wobble_arcsec=12.0, runout_um=8.0),
    "hysteresis": replace(TYPICAL, play_arcsec=6.0),
    "gravity": ArmErrors.from_name("gravity"),
}


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


def changes(arm, angles, rng, run):
    """Changes of tracker series, and the causes that are to be named."""
    shift = rng.normal(size=3)
    shift *= 0.04 / np.linalg.norm(shift)
    joint = 1 + run % 3
    yield "none", 0.0, "nothing"
    yield "base settled by 40 um", shift, "base"
    yield "base drifts by 40 um", np.linspace(-0.5, 0.5, len(angles))[:, None] * shift * 2, "drift"
    knock = arm.jacobian(angles)[:, :, joint] * 10 * ARCSEC
    yield "knock of 10 arc seconds", knock, f"offset of joint {joint + 1}"


def series(kind, arm, model, poses, runs, groups=None):
    counts = {}
    for run in range(runs):
        angles, y = poses(run)
        for name, moved, cause in changes(arm, angles, np.random.default_rng([7, run]), run):
            check = check_correction(model, angles, y + moved, false_alarm_rate=RATE)
            counts.setdefault(name, Count()).add(check, cause)
    for name, count in counts.items():
        say(kind, name, count)


def simulated_series(runs):
    arm = Arm.from_name("aacmm6")
    angles, y = poses_of_simulated_arm(arm, 10**6, 500)
    series("tracker", arm, arm_model(arm, orders=12).fit(angles, y),
           lambda run: poses_of_simulated_arm(arm, run), runs)  # fmt: skip


def ur10(runs):
    angles, points = read("A", DATA / "ur10_tracker")
    order = np.random.default_rng(0).permutation(len(angles))
    rows, others = np.array_split(order, 2)
    first = calibrate(Arm.from_name("ur10", probe=(0, 0, 93)), angles[rows], points=points[rows])
    model = arm_model(first.arm).fit(angles[rows], first.residuals_mm)

    def poses(run):
        some = np.sort(np.random.default_rng([3, run]).choice(others, 40, replace=False))
        return angles[some], first.residuals(angles[some], points[some])

    series("UR10", first.arm, model, poses, runs)


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


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", type=int, default=6, help="of each kind, simulated")
    parser.add_argument("--days", type=int, default=6, help="checks of each arm")
    parser.add_argument("--runs", type=int, default=100, help="checks of each series")
    parser.add_argument("--real", action="store_true", help="the real robots, too")
    options = parser.parse_args()
    print(f"{'':14}{'change':28}{'alarms':>20}{'named rightly':>14}{'small':>7}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        simulated_series(options.runs)
        for kind, errors in KINDS.items():
            single_points(kind, errors, options.arms, options.days)
        if options.real:
            ur10(options.runs)
            pandas(max(options.runs // 10, 5))


if __name__ == "__main__":
    main()
