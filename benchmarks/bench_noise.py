"""Noise, weak signals and intervals: what a network says where there is little to be known.

Ten kinds of tables: noise alone in 5, 20 and 50 features, with heavy tails, of two levels and of
two values; and weak signals: a line, a wave, an interaction and a step in features most of which
have no effect. Printed is the error against the truth without noise, in standard deviations of the
targets, and the share of new observations inside the 95 % interval, over some draws. Then the
intervals of a smooth function in 2, 8 and 20 features from few rows.

    python benchmarks/bench_noise.py               # two minutes, one thread
    python benchmarks/bench_noise.py --margins     # by the lead that a rougher kernel has to have
"""

import argparse
import warnings

import _one_thread  # noqa: F401
import numpy as np
from _problems import generated

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.network import _search

N_TEST, LEVEL = 500, 1.96


# Features, rows, and the truth where it is not nothing.
KINDS = {
    "noise, 5 features": (5, 100, None),
    "noise, 20 features": (20, 100, None),
    "noise, 50 features": (50, 120, None),
    "heavy tails": (5, 200, None),
    "two levels": (5, 200, None),
    "two values": (8, 200, None),
    "weak line": (20, 150, lambda X: 0.4 * X[:, 3]),
    "weak wave": (20, 300, lambda X: 0.6 * np.sin(2 * X[:, 3]) + 0.6 * X[:, 7]),
    "weak interaction": (6, 300, lambda X: np.tanh(X[:, 0] + 0.5 * X[:, 1] * X[:, 2])),
    "weak step": (10, 300, lambda X: 1.0 * (X[:, 0] > 0)),
}
# The noise of so many rows, where it is not normal of size 1.
NOISE = {
    "heavy tails": lambda rng, n: rng.standard_t(2.5, n),
    "two levels": lambda rng, n: rng.standard_normal(n) * rng.choice([0.3, 3], n),
    "two values": lambda rng, n: rng.choice([-1.0, 1.0], n),
    "weak interaction": lambda rng, n: 1.2 * rng.standard_normal(n),
}


def judged(X, y, n):
    """Predictions after the first n rows, and the share inside the 95 % interval."""
    mean, std = RBFNetRegressor(random_state=0).fit(X[:n], y[:n]).predict(X[n:], return_std=True)
    return mean, np.mean(np.abs(y[n:] - mean) < LEVEL * std)


def of_kind(name, seeds):
    """Error and coverage of one kind, over draws."""
    d, n, truth = KINDS[name]
    errors, inside = [], []
    for seed in seeds:
        rng = np.random.default_rng([seed, n, d])
        X = rng.standard_normal((n + N_TEST, d))
        f = truth(X) if truth else np.zeros(len(X))
        y = f + NOISE.get(name, np.random.Generator.standard_normal)(rng, len(X))
        mean, share = judged(X, y, n)
        errors.append(np.mean(np.square((mean - f[n:]) / y.std())))
        inside.append(share)
    return np.sqrt(np.mean(errors)), np.mean(inside)


def intervals(d, n, seeds):
    """Share of new observations inside the 95 % interval, of a smooth function and noise."""
    inside = []
    for seed in seeds:
        rng = np.random.default_rng([seed, n, d, 1])
        X = rng.uniform(-1.7, 1.7, (n + N_TEST, d))
        y = np.sin(X[:, 0]) + 0.5 * X[:, -1] + 0.3 * rng.standard_normal(len(X))
        inside.append(judged(X, y, n)[1])
    return np.mean(inside)


def margins():
    """Errors by the nats by which a kernel other than the first has to lead."""
    cases = [("borehole8", 100), ("borehole8", 300), ("noisy5", 300), ("friedman3", 300)]
    cases += [("kinks2", 100), ("kinks2", 300), ("robot_arm8", 100)]
    for name, n in cases:
        found = []
        for margin in (0.0, 3.0, 6.0, 10.0):
            _search.KERNEL_MARGIN = margin
            errors = []
            for seed in range(10, 13):
                X, y, X_test, truth, _ = generated(name, n, seed)
                model = RBFNetRegressor(random_state=0).fit(X, y)
                errors.append(np.mean(np.square((model.predict(X_test) - truth) / truth.std())))
            found.append(np.sqrt(np.mean(errors)))
        print(f"{name:12} {n:5d} rows, margins 0, 3, 6 over 10: {np.divide(found, found[-1])[:3]}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--margins", action="store_true")
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(10)))
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    if args.margins:
        margins()
        return
    for name in KINDS:
        error, inside = of_kind(name, args.seeds)
        print(f"{name:20} error {error:.3f}, inside {100 * inside:.1f} %", flush=True)
    for d in (2, 8, 20):
        found = [intervals(d, n, args.seeds) for n in (10, 30, 100, 300)]
        text = ", ".join(f"{100 * share:.1f}" for share in found)
        print(f"{d:2d} features, 10, 30, 100, 300 rows: inside {text} %", flush=True)


if __name__ == "__main__":
    main()
