"""Whether a correction does harm: 50 simulated arms, eight of them trained in one corner.

Every arm is an individual of its own, with 150 to 300 training poses. Of 42 arms two thirds of the
positions are learnt and the others tested; of eight the third of the positions that lies to one
side, below, near or far. Half of the arms are measured by a tracker, half in a single-point test.
Printed is what the correction leaves of the mean deviation at the positions that were left out:
from the truth, or from the position's mean.

    python benchmarks/bench_guards.py

``--intervals`` asks something else, of eight arms of each of four kinds: which share of the true
errors of the correction at positions left out of a single-point test lies within 1.96 of its
standard deviations (median, lowest and mean of eight), with 12 and with 20 positions learnt, and
their mean standard deviation in micrometres. What such a test cannot show (ten fields of place:
motions, a scale and bends of the whole volume) is fitted to the true errors at the training
positions and taken off.

    python benchmarks/bench_guards.py --intervals
"""

import argparse
import warnings

import numpy as np

from sklearn_raacmm import ArmResidualRegressor, position_residuals
from sklearn_raacmm.datasets import ArmErrors, make_single_point

FIRST_SEED, N_ARMS, N_CORNERS = 5000, 50, 8
N_INTERVALS = 8  # arms of each kind
# The last two have causes that the model has no column for.
MACHINES = {
    "typical": ArmErrors(),
    "gravity": ArmErrors.from_name("gravity"),
    "eccentricity": ArmErrors.from_name("eccentricity"),
    "slips": ArmErrors(slip_share=0.04, slip_mm=0.5),
    "soft": ArmErrors(softening_arcsec=15.0, runout_um=10.0),
    "play": ArmErrors(play_arcsec=8.0, drift_k=5.0),
}
POSES = 15  # at each position
SIDES = ("side", "low", "near", "far")


def training_positions(test, number, rng):
    """Positions that are learnt, and what they are called."""
    place = test.simulation.positions - test.simulation.machine.shoulder
    n = len(place)
    if number < N_ARMS - N_CORNERS:
        return rng.permutation(n)[: 2 * n // 3], "spread"
    side = SIDES[number % len(SIDES)]
    away = {
        "side": np.abs(np.arctan2(place[:, 1], place[:, 0])),
        "low": place[:, 2],
        "near": np.linalg.norm(place, axis=1),
        "far": -np.linalg.norm(place, axis=1),
    }[side]
    return np.argsort(away)[: n // 3], side


def split(number):
    """What one arm is, its measurements, and which rows are learnt."""
    rng = np.random.default_rng(FIRST_SEED + number)
    corner = number >= N_ARMS - N_CORNERS
    n_train = int(rng.integers(10, 21))
    n_positions = 3 * n_train if corner else 3 * n_train // 2
    machine = list(MACHINES)[number % len(MACHINES)]
    tracker = number // len(SIDES) % 2 == 1
    test = make_single_point(
        n_positions, POSES, machine=MACHINES[machine], random_state=FIRST_SEED + number
    )
    kept, where = training_positions(test, number, rng)
    y = test.points - test.simulation.true_points if tracker else test.target
    return (machine, "tracker" if tracker else "single-point", where), test, y, kept


def left_of(model, test, y, kept, tracker):
    """Mean deviation at the other positions, with over without the correction."""
    train = np.isin(test.groups, kept)
    model.fit(test.data[train], y[train], groups=test.groups[train])
    left = y[~train] - model.predict(test.data[~train])
    if not tracker:
        left = position_residuals(left, test.groups[~train])
    good = ~test.simulation.slipped[~train]
    before, after = (np.linalg.norm(part, axis=1)[good].mean() for part in (y[~train], left))
    return after / before


def fields_of_place(points):
    """What depends on the place alone, (n, 3, 10): motions, scale, and what the load bends."""
    x, y, z = points.T / 1000
    nothing = np.zeros_like(x)
    fields = [np.broadcast_to(axis, points.shape) for axis in np.eye(3)]
    fields += [np.cross(axis, points / 1000) for axis in np.eye(3)]
    bends = (x, y, z), (x, y, nothing), (nothing, -y * z, y * y), (x * z, nothing, -x * x)
    return np.stack(fields + [np.column_stack(bend) for bend in bends], axis=2)


def share_inside(machine, seed, n_train):
    """Percentage of true errors within 1.96 deviations at positions left out, and these in um."""
    of_arm = {"machine": MACHINES[machine], "random_state": FIRST_SEED + seed}
    test = make_single_point(3 * n_train // 2, POSES, **of_arm)
    train = test.groups % 3 > 0
    model = ArmResidualRegressor(test.arm)
    model.fit(test.data[train], test.target[train], groups=test.groups[train])
    mean, std = model.predict(test.data, return_std=True)
    error = mean - test.simulation.perfect_correction
    fields = fields_of_place(test.points)
    of_position = [test.groups == label for label in np.unique(test.groups[train])]
    left = np.concatenate([fields[rows].mean(axis=0) for rows in of_position])
    right = np.concatenate([error[rows].mean(axis=0) for rows in of_position])
    error = error - fields @ np.linalg.lstsq(left, right, rcond=None)[0]
    return 100 * np.mean(np.abs(error / std)[~train] < 1.96), 1000 * std[~train].mean()


def print_intervals():
    """How many true errors the intervals of single-point tests hold."""
    print(
        "| machine | 12 positions: median, lowest, mean; deviation | 20 positions |\n|---|---|---|"
    )
    for machine in ("typical", "gravity", "eccentricity", "soft"):
        cells = []
        for n_train in (12, 20):
            found = [share_inside(machine, seed, n_train) for seed in range(N_INTERVALS)]
            inside, width = np.transpose(found)
            shares = np.median(inside), inside.min(), inside.mean()
            shares = ", ".join(f"{share:.0f} %" for share in shares)
            cells.append(f"{shares}; {width.mean():.1f} um")
        print(f"| {machine} | {cells[0]} | {cells[1]} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", type=int, default=N_ARMS, help="the last so many of the 50")
    parser.add_argument("--intervals", action="store_true", help="of single-point tests")
    options = parser.parse_args()
    if options.intervals:
        print_intervals()
        return
    warnings.simplefilter("ignore")  # predict warns where most of a correction has faded
    found = []
    for number in range(N_ARMS - options.arms, N_ARMS):
        what, test, y, kept = split(number)
        ratio = left_of(ArmResidualRegressor(test.arm), test, y, kept, what[1] == "tracker")
        found.append((*what, ratio))
        print(number, *what, f"{ratio:.3f}", flush=True)
    print("\n| arms | number | median, worst |\n|---|---|---|")
    for kind in ("tracker", "single-point"):
        for spread in (True, False):
            some = [r for r in found if r[1] == kind and (r[2] == "spread") == spread]
            if some:
                ratios = [ratio for *_, ratio in some]
                name = f"{kind}, {'spread' if spread else 'one corner, used elsewhere'}"
                cell = f"{np.median(ratios):.2f}, {max(ratios):.2f}"
                print(f"| {name} | {len(some)} | {cell} |")


if __name__ == "__main__":
    main()
