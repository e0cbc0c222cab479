"""Touches of balls and planes: what they teach an arm's table, beside cones.

    python benchmarks/bench_features.py cones --arms 8

Simulated arms, calibrated from the drawing. ``cones``: 2S at new cones over that of ten cones of 30
poses, of arms that are only built unlike their drawing, and of typical ones, whose joints and tubes
do more than a table can say. ``corrected``: the same with a model fitted to the same touches.
``slips``: as ``cones``, with one touch in half of the features that 40 arc seconds of joint 2 move.
``lengths``: errors of gauges of 300, 500 and 800 mm, and the error of the scale over `scale_sd`,
from balls of unknown and of known size and with blocks. ``mistakes``: how often a size or a block
that is 0.1 mm wrong is named by `learn_correction`, and one that is right.
"""

import time

import _one_thread  # noqa: F401
import numpy as np
from _arm_folds import rms, run_part

from sklearn_raacmm import ArmResidualRegressor, calibrate, learn_correction, position_residuals
from sklearn_raacmm.datasets import (
    ArmErrors,
    SimulatedArm,
    make_features,
    make_gauge,
    make_single_point,
)
from sklearn_raacmm.metrics import gauge_lengths, single_point_repeatability

# Spheres, planes and cones, and touches of each.
TAUGHT = {
    "10 cones x 30": (0, 0, 10, 30),
    "10 balls x 25": (10, 0, 0, 25),
    "10 planes x 30": (0, 10, 0, 30),
    "10 planes x 90": (0, 10, 0, 90),
    "3 cones and 10 planes x 30": (0, 10, 3, 30),
}
MACHINES = {
    "built": ArmErrors.only(length_mm=0.4, angle_deg=0.03, encoder_noise_arcsec=0.5, seating_um=4),
    "typical": ArmErrors.from_name("typical"),
}
LENGTHS = {
    "balls of unknown size": (10, 0, 0, ()),
    "balls of known size": (10, 0, 0, ()),
    "cones and two blocks": (0, 0, 10, (100.0, 500.0)),
    "balls and two blocks": (10, 0, 0, (100.0, 500.0)),
}
_ACCEPTED = ["wrong-length", "poses-alike", "no-such-arm", "moved-position"]


def _machines(options):
    """Each arm of each kind, with its number and its cones that took no part."""
    for name, errors in MACHINES.items():
        for seed in range(options.first, options.first + options.arms):
            machine = SimulatedArm(errors, random_state=seed)
            new = make_single_point(8, 20, machine=machine, random_state=seed + 1000)
            yield name, machine, seed, new


def _taught(test, features=None, lengths=None):
    """The calibration, and its CPU time in seconds."""
    features = test.features if features is None else features
    lengths = test.lengths if lengths is None else lengths
    start = time.process_time()
    found = calibrate(
        test.nominal_arm, test.data, test.groups, features=features, lengths=lengths,
        accept=_ACCEPTED,
    )  # fmt: skip
    return found, time.process_time() - start


def _table(title, ratios, seconds):
    print(title)
    for (machine, name), values in ratios.items():
        print(
            f"{machine:<8} {name:<28} mean {np.mean(values):6.3f}  worst {np.max(values):6.3f}  "
            f"CPU {np.mean(seconds[machine, name]):.2f} s"
        )


def _points(test, found, angles, corrected):
    """Points (n, 3) at these angles, mm, and the CPU time in seconds that it took to find them."""
    start = time.process_time()
    points = found.arm.forward(angles)
    if corrected:
        given = {"groups": test.groups, "features": test.features}
        y = position_residuals(found.arm.forward(test.data), **given)
        model = ArmResidualRegressor(found.arm)
        model.fit(test.data, y, sample_weight=found.sample_weight, lengths=test.lengths, **given)
        points = points - model.predict(angles)
    return points, time.process_time() - start


def cones(options, slip=0.0, corrected=False):
    """2S at new cones over that of an arm that ten cones have taught."""
    ratios, seconds, first = {}, {}, {}
    for name, machine, seed, new in _machines(options):
        for taught, (*n, touches) in TAUGHT.items():
            test = make_features(*n, touches, machine=machine, random_state=seed)
            rng = np.random.default_rng(seed)
            for feature in np.unique(test.groups)[::2] if slip else ():
                test.data[rng.choice(np.flatnonzero(test.groups == feature)), 1] += slip
            found, took = _taught(test)
            points, more = _points(test, found, new.data, corrected)
            left = single_point_repeatability(points, new.groups)
            start = first.setdefault((name, seed), left)
            ratios.setdefault((name, taught), []).append(left / start)
            seconds.setdefault((name, taught), []).append(took + more)
        print(f"{name} {seed}: ten cones leave {1000 * start:.1f} um", flush=True)
    _table("2S at eight new cones over that of ten cones x 30", ratios, seconds)


def corrected(options):
    """The same of points that a model corrects."""
    cones(options, corrected=True)


def slips(options):
    """As `cones`, of touches of which one in half of the features slipped."""
    cones(options, np.deg2rad(40 / 3600))


def lengths(options):
    """Errors of gauges, and of the scale over its standard deviation."""
    errors, z, seconds = {}, {}, {}
    for name, machine, seed, _ in _machines(options):
        gauge = make_gauge([300.0, 500.0, 800.0], 5, 10, machine=machine, random_state=seed + 1000)
        for taught, (*n, blocks) in LENGTHS.items():
            test = make_features(*n, 25, blocks=blocks, machine=machine, random_state=seed)
            features = test.features
            if "unknown" in taught:
                features = [entry[:2] for entry in features]
            found, took = _taught(test, features)
            shown = gauge_lengths(found.arm.forward(gauge.data), gauge.groups, gauge.pairs)
            off = shown - gauge.lengths
            scale = off @ gauge.lengths / (gauge.lengths @ gauge.lengths)
            key = name, taught
            errors.setdefault(key, []).append(1000 * rms(off))
            z.setdefault(key, []).append(scale / found.scale_sd)
            seconds.setdefault(key, []).append(took)
        print(f"{name} {seed}", flush=True)
    print("errors of 15 lengths, um; error of the scale over its standard deviation")
    for (name, taught), values in errors.items():
        z_rms, took = rms(z[name, taught]), np.mean(seconds[name, taught])
        print(
            f"{name:<8} {taught:<28} rms {rms(values):6.1f}  worst {max(values):6.1f}  "
            f"z {z_rms:5.2f}  CPU {took:.2f} s"
        )


def mistakes(options):
    """How often a wrong size or block is named, and how often one that is right."""
    named = {what: [0, 0, 0] for what in ("nothing", "a size", "a block")}
    for _, machine, seed, _ in _machines(options):
        test = make_features(
            6, 0, 2, 25, blocks=[250.0, 300.0, 300.0], machine=machine, random_state=seed
        )
        label, kind, size, sd = test.features[2]
        sizes = [*test.features[:2], (label, kind, size + 0.1, sd), *test.features[3:]]
        one, other, length, sd = test.lengths[1]
        blocks = [test.lengths[0], (one, other, length + 0.1, sd), test.lengths[2]]
        for what, features, known, wrong in (
            ("nothing", test.features, test.lengths, ()),
            ("a size", sizes, test.lengths, (f"the size of {label} ",)),
            ("a block", test.features, blocks, (f"{one} to {other} ",)),
        ):
            # Lengths are judged beside a model of low orders, whatever the model that is learnt.
            found = learn_correction(
                test.nominal_arm, test.data, test.groups, lengths=known, features=features,
                model=ArmResidualRegressor(orders=1), cv=2, accept=_ACCEPTED,
            )  # fmt: skip
            texts = [f.text for f in found.scores.findings if f.code == "wrong-length"]
            hit = any(words in text for text in texts for words in wrong)
            named[what][0] += 1
            named[what][1] += hit
            named[what][2] += bool(texts) and not hit
    for what, (n, hit, false) in named.items():
        print(f"{what:<8} wrong by 0.1 mm: of {n} arms named {hit}, something else named {false}")


def main():
    """Arms from the number `first` on."""
    run_part(__doc__, [cones, corrected, slips, lengths, mistakes], arms=8, first=0)


if __name__ == "__main__":
    main()
