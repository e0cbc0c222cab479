"""What checks find: of a correction, and of a table of measurements.

    python benchmarks/bench_check.py findings --real    # ten minutes, as kinds; others one to three

``changes``: an arm that has learned 500 poses is checked with 40 of another day: without a change,
after a knock of one joint, with a loose probe, and 5 K warmer. ``kinds``: the same of arms whose
errors no model describes completely, in single-point tests and tracker series; rates with Wilson's
intervals. ``dwells``: 90 poses of which a logger wrote 100 rows each, beside one row a pose: mean
distances in um at other positions. ``set-ups``: a tracker or a target that moved half way.
``steps``: looked for in what the model leaves of clean tests, in three orders, and after the socket
of one position moved halfway. ``findings``: how often each is made where nothing is wrong, when
half of the positions are learnt and 60 poses of the others update the model, all in a drawn order;
then with the wrong sign.
"""

from collections import Counter
from dataclasses import replace
from functools import partial

import numpy as np
from _arm_folds import (
    ARCSEC,
    MIXES,
    MOVED,
    NOMINAL_PANDA,
    UR10,
    learn_tracked,
    mean_deviation,
    pairs_known,
    read_panda,
    read_ur10,
    run_part,
)
from scipy.stats import binomtest
from sklearn.cluster import KMeans

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    calibrate,
    check_correction,
    position_residuals,
    update_correction,
)
from sklearn_raacmm.datasets import ArmErrors, SimulatedArm, make_single_point
from sklearn_raacmm.measurements._moved_positions import find_steps
from sklearn_raacmm.utils import Finding, Groups

CLEAR = 1e-4
TYPICAL = ArmErrors()
KINDS = {
    "typical": TYPICAL,
    "soft elbow": replace(TYPICAL, softening_arcsec=30.0),
    "wobble": replace(TYPICAL, wobble_arcsec=12.0, runout_um=8.0),
    "hysteresis": replace(TYPICAL, play_arcsec=6.0),
    "gravity": ArmErrors.from_name("gravity"),
}


class Counts:
    """Checks of one kind of arm: alarms, named rightly, and clear ones, by what was changed."""

    def __init__(self, kind):
        self.kind, self.of = kind, {}

    def check(self, change, cause, model, angles, y, **options):
        """Check once, where the right cause is known."""
        found = check_correction(model, angles, y, false_alarm_rate=0.01, **options)
        right = not found.holds and found.suspect == cause
        self.of.setdefault(change, []).append((not found.holds, right, found.p_value < CLEAR))

    def show(self):
        """Print a line for each change; return the counts by their names."""
        table = {}
        for change, checks in self.of.items():
            alarms, right, clear = map(int, np.sum(checks, axis=0))
            n = len(checks)
            low, high = binomtest(alarms, n).proportion_ci(method="wilson")
            named = f"named rightly {right}, p < {CLEAR}: {clear}"
            rate = f"{alarms / n:.1%} ({low:.1%} to {high:.1%})"
            print(f"{self.kind}, {change}: {alarms} of {n}, {rate}; {named}", flush=True)
            table[change] = {"checks": n, "alarms": alarms, "named rightly": right, "clear": clear}
        return {f"checks, {self.kind}": table}


def knock(arm, arcsec):
    def change(angles, rng, run):
        moved = arm.jacobian(angles)[:, :, run % 5] * arcsec * ARCSEC
        return moved, f"offset of joint {run % 5 + 1}"

    return change


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
    model = ArmResidualRegressor(arm, orders=12).fit(*poses_of_simulated_arm(arm, 10**6, 500))
    return arm, model, partial(poses_of_simulated_arm, arm)


def ur10(n_learned):
    """The UR10, its model of some poses, and 40 others of its series in their order."""
    angles, points, _ = read_ur10("A")
    order = np.random.default_rng(0).permutation(len(angles))
    rows, others = order[:n_learned], order[n_learned:]
    first, model = learn_tracked(UR10, angles[rows], points[rows])

    def poses(run):
        some = np.sort(np.random.default_rng([3, run]).choice(others, 40, replace=False))
        return angles[some], first.residuals(angles[some], points[some])

    return first.arm, model, poses


def changes(options):
    tables, arms = {}, {"simulated": (*simulated_tracker(), 0.015)}
    if options.real:
        arm, model, poses = ur10(3000)
        noise_mm = model.linear_model_.noise_scale * model.noise_sd_
        arms["UR10"] = arm, model, poses, noise_mm
    for kind, (arm, model, poses, noise_mm) in arms.items():
        counts, loose = Counts(kind), 4 / 3 * noise_mm
        nothing = lambda q, rng, run: (0.0, "nothing")  # noqa: E731
        of_arm = {
            "none": nothing,
            "none, base and probe refitted": nothing,
            **{f"knock of {size} arc seconds": knock(arm, size) for size in (5, 10, 20)},
            "knock of 20 arc seconds, base and probe refitted": knock(arm, 20),
            "loose probe": lambda q, rng, run, sd=loose: (rng.normal(0, sd, (len(q), 3)), "noise"),
            "5 K warmer": lambda q, rng, run, arm=arm: (-arm.forward(q) * 11.7e-6 * 5, "scale"),
        }
        for name, change in of_arm.items():
            refitted = ("base", "probe") if "refitted" in name else ()
            for run in range((4 if "none" in name else 1) * options.runs):
                angles, y = poses(run)
                # Of a knock of joint 1 or 5 nothing may be left beside a fitted base and probe.
                rng = np.random.default_rng([1, run])
                moved, cause = change(angles, rng, 1 + run % 3 if refitted else run)
                counts.check(name, cause, model, angles, y + moved, refitted=refitted)
        tables |= counts.show()
    return tables


def kind_of_arm(kind, errors, options):
    counts = Counts(kind)
    for seed in range(options.arms):
        machine = SimulatedArm(errors, random_state=seed)
        known = make_single_point(12, 30, machine=machine, random_state=seed)
        model = ArmResidualRegressor(known.arm).fit(known.data, known.target, groups=known.groups)
        for day in range(options.days):
            new = make_single_point(6, 10, machine=machine, random_state=1000 * (day + 1) + seed)
            for name, by, what in (
                ("none", 0.0, "nothing"),
                ("knock of 10 arc s", *knock(known.arm, 10)(new.data, None, 1 + (seed + day) % 3)),
                ("corrected twice", -model.predict(new.data), "corrected already"),
            ):
                counts.check(name, what, model, new.data, new.target + by, groups=new.groups)
    return counts.show()


def kind_of_series(kind, arm, model, poses, runs):
    counts = Counts(kind)
    for run in range(runs):
        angles, y = poses(run)
        shift = np.random.default_rng([7, run]).normal(size=3)
        shift *= 0.04 / np.linalg.norm(shift)
        drift = np.linspace(-0.5, 0.5, len(angles))[:, None] * shift * 2
        for name, moved, cause in (
            ("none", 0.0, "nothing"),
            ("base settled by 40 um", shift, "base"),
            ("base drifts by 40 um", drift, "drift"),
            ("knock of 10 arc s", *knock(arm, 10)(angles, None, 1 + run % 3)),
        ):
            counts.check(name, cause, model, angles, y + moved)
    return counts.show()


def kind_of_panda(name, runs):
    """Half of the places learnt, the others checked; without "high" of panda_2, which moved."""
    counts, (angles, groups, _) = Counts(name), read_panda(name)
    labels = np.unique(groups)
    labels = labels[~((name == "panda_2") & np.char.startswith(labels.astype(str), "high"))]
    for run in range(runs):
        mixed = np.random.default_rng([5, run]).permutation(labels)
        known, rest = (np.isin(groups, half) for half in np.array_split(mixed, 2))
        found = calibrate(NOMINAL_PANDA, angles[known], groups[known], **MOVED)
        model = ArmResidualRegressor(found.arm)
        model.fit(angles[known], found.residuals_mm, groups=groups[known])
        if not model.helps_:
            continue
        y = found.residuals(angles[rest], groups=groups[rest])
        moved, cause = knock(found.arm, 40)(angles[rest], None, 1 + run % 3)
        for what, by, why in (("none", 0.0, "nothing"), ("knock of 40 arc s", moved, cause)):
            counts.check(what, why, model, angles[rest], y + by, groups=groups[rest])
    counts.show()


def kinds(options):
    tables = kind_of_series("tracker", *simulated_tracker(), options.runs)
    for kind, errors in KINDS.items():
        tables |= kind_of_arm(kind, errors, options)
    if options.real:
        kind_of_series("UR10", *ur10(5956), options.runs)
        for name in ("panda_2", "panda_3", "panda_6", "panda_7"):
            kind_of_panda(name, max(options.runs // 10, 5))
    return tables


def dwells(options):
    for seed in range(2):
        test = make_single_point(19, 10, random_state=seed)
        train, new = test.groups < 9, test.groups >= 9
        truth = test.points - test.simulation.true_points
        rng = np.random.default_rng(seed)
        for kind in ("cones", "tracker"):
            found = [mean_deviation(Groups(test.groups[new] - 9).centred(truth[new]))]
            for n in (1, 100):
                rows = np.repeat(np.flatnonzero(train), n)
                angles = test.data[rows] + (n > 1) * rng.normal(0, 5e-6, (len(rows), 6))
                points, groups = test.arm.forward(angles), test.groups[rows]
                y = points - test.simulation.true_points[rows]
                y = position_residuals(points, groups) if kind == "cones" else y
                model = ArmResidualRegressor(test.arm).fit(angles, y, groups=groups)
                left = truth[new] - model.predict(test.data[new])
                found.append(mean_deviation(Groups(test.groups[new] - 9).centred(left)))
            none, one, stream = 1e3 * np.array(found)
            print(f"{kind}, seed {seed}: none {none:.1f}, one row {one:.1f}, stream {stream:.1f}")


def set_ups(options):
    named = Counter()
    for machine in ("typical", "gravity"):
        for seed in range(2):
            test = make_single_point(12, 20, machine=machine, random_state=seed)
            rng = np.random.default_rng(seed)
            for order in ("by cone", "shuffled"):
                rows = rng.permutation(240) if order == "shuffled" else np.arange(240)
                angles, points = test.data[rows], test.simulation.true_points[rows] + [1e3, 500, 0]
                points += rng.normal(0, 0.01, points.shape)
                turns = test.arm.frames(angles)[:, -1, :3, :3]
                for size in (0.0, 0.1, 0.5, 5.0, 50.0):
                    step = size * np.array([0.6, -0.6, 0.5])
                    for what, moved in (("station", step), ("tool", turns @ step)):
                        half = np.where(np.arange(240)[:, None] < 120, points, points + moved)
                        found = calibrate(test.nominal_arm, angles, points=half).findings
                        rightly = {(f.code, f.rows) for f in found if f.weight == "repair"}
                        named[what, order, size] += (f"moved-{what}", (120,)) in rightly
    for case, n in named.items():
        print(*case, f"mm: named, with its row, in {n} of 4")


def simulated_test(seed):
    """Angles, residuals, positions and the arm of one simulated test."""
    rng = np.random.default_rng(seed)
    errors = replace(
        ArmErrors.from_name(MIXES[seed % 3]),
        play_arcsec=float(rng.choice([0, 0, 5])),
        softening_arcsec=float(rng.choice([0, 0, 20])),
        drift_k=float(rng.choice([0, 0, 3])),
        payload_n=float(rng.choice([0, 0, 20])),
        slip_share=float(rng.choice([0, 0.02, 0.08])),
    )
    n_positions, n_poses = int(rng.integers(4, 14)), int(rng.choice((8, 12, 20, 30, 60)))
    test = make_single_point(n_positions, n_poses, machine=errors, random_state=seed)
    return test.arm, test.data, test.target, test.groups


def look(arm, angles, y, groups):
    """What the model leaves, and positions by number."""
    model = ArmResidualRegressor(arm).fit(angles, y, groups=groups)
    codes = np.unique(groups, return_inverse=True)[1]
    return y - model.linear_model_.predict(angles)[0], codes


def steps(options):
    alarms, found = 0, {}
    for seed in range(5000, 5000 + options.tests):
        arm, angles, y, groups = simulated_test(seed)
        rng = np.random.default_rng([1, seed])
        left, codes = look(arm, angles, y, groups)
        features = np.hstack([np.cos(angles), np.sin(angles)])
        clusters = KMeans(3, n_init=1, random_state=0).fit_predict(features)
        by_pose = np.lexsort((rng.random(len(y)), clusters, codes))
        orders = np.arange(len(y)), by_pose, rng.permutation(len(y))
        alarms += any(find_steps(left[o], angles[o], codes[o]) for o in orders)
        rows = np.flatnonzero(codes == rng.integers(codes.max() + 1))
        middle, direction = rows[len(rows) // 2], rng.normal(size=3)
        size = (0.03, 0.1, 0.3)[seed // 3 % 3]
        y[rows[len(rows) // 2 :]] += size * direction / np.linalg.norm(direction)
        # The model is fitted to what was measured, the moved half included.
        left, codes = look(arm, angles, y, groups)
        right = [abs(step.after - middle) <= 2 for step in find_steps(left, angles, codes)]
        found.setdefault((size, len(rows)), []).append(any(right))
    print(f"{alarms} of {options.tests} tests without a step are named")
    for (size, n), hits in sorted(found.items()):
        print(f"step of {size} mm, {n} poses: found in {sum(hits)} of {len(hits)}")
    for name in ("panda_3", "panda_2") if options.real else ():
        angles, groups, placements = read_panda(name)
        lengths = pairs_known(np.unique(placements))
        arm = calibrate(NOMINAL_PANDA, angles, groups, lengths=lengths, **MOVED).arm
        left, codes = look(arm, angles, position_residuals(arm.forward(angles), groups), groups)
        for step in find_steps(left, angles, codes):
            print(f"{name}, {np.unique(groups)[step.code]}: {step}")


def halves(name, run):
    """Arm, angles, positions, points or None, and lengths with nothing wrong, in a drawn order."""
    rng = np.random.default_rng([7, run])
    if name.startswith("UR10"):
        angles, points, goals = read_ur10(name[-1])
        some = rng.choice(len(angles), 600, replace=False)
        return UR10, angles[some], goals[some], points[some], ()
    if name.startswith("panda"):
        angles, groups, placements = read_panda(name)
        nominal, lengths = NOMINAL_PANDA, pairs_known(np.unique(placements))
    else:
        test = make_single_point(16, 25, machine=SimulatedArm(KINDS[name], random_state=run))
        nominal, angles, groups, lengths = test.arm, test.data, test.groups, []
    # The positions in another order, and the poses of each.
    labels, codes = np.unique(groups, return_inverse=True)
    order = np.lexsort((rng.random(len(codes)), rng.permutation(len(labels))[codes]))
    return nominal, angles[order], groups[order], None, lengths


def found_in(name, run):
    """Findings of calibration, fit and update of one half and the other, and of the wrong sign."""
    arm, angles, groups, points, lengths = halves(name, run)
    first = np.isin(groups, np.random.default_rng([8, run]).permutation(np.unique(groups))[::2])
    known = [one for one in lengths if {one[0], one[1]} <= set(groups[first])]

    def given(rows):
        return {"groups": groups[rows]} if points is None else {"points": points[rows]}

    with Finding.collected() as of_arm:
        result = calibrate(arm, angles[first], **given(first), lengths=known)
    y = np.zeros((len(angles), 3))
    for half in (first, ~first):
        y[half] = result.residuals(angles[half], **given(half))
    with Finding.collected() as of_fit:
        model = ArmResidualRegressor(result.arm)
        model.fit(angles[first], y[first], groups=given(first).get("groups"))
    new = np.flatnonzero(~first)[:60]
    labels = given(new).get("groups")
    found = {"calibrate": of_arm, "fit": of_fit}
    for what, sign in (("update", 1), ("wrong sign", -1)):
        with Finding.collected() as of_update:
            update_correction(model, angles[new], sign * y[new], groups=labels)
        found[what] = of_update
    return {what: {f.code for f in every if f.weight != "note"} for what, every in found.items()}


def findings(options):
    real = ["panda_2", "panda_3", "panda_6", "panda_7", "UR10 A", "UR10 B"]
    for name in [*KINDS, *real] if options.real else KINDS:
        every = [found_in(name, run) for run in range(options.runs)]
        for what in every[0]:
            codes = Counter(code for found in every for code in found[what])
            said = ", ".join(f"{code} {n}" for code, n in codes.most_common()) or "nothing"
            print(f"{name}, {what}, {options.runs} runs: {said}", flush=True)


def main():
    """Arms and checks of each for kinds; series or changes; simulated tests for steps."""
    parts = [changes, kinds, dwells, set_ups, steps, findings]
    run_part(__doc__, parts, arms=6, days=6, runs=60, tests=100, real=False)


if __name__ == "__main__":
    main()
