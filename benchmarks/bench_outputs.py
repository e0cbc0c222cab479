"""
Outputs with widths of their own
================================

`RBFNetRegressor` lets the data decide which outputs share kernel, widths and centres. Here it
stands beside one network for each output (MultiOutputRegressor) and beside the network in which all
outputs share everything, as they did before: on random functions that agree, that differ in
frequency or in the features they depend on, and with `--arms` on two real arms at positions left
out. Of errors the root mean square over new rows is taken, and of the ratios of outputs and draws
the geometric mean; of times the ratio of the sums.

The default takes about 70 CPU seconds, with `--arms` twice as long.
"""

import argparse
from time import process_time
from unittest import mock

import numpy as np
from _comparison import Table
from _problems import generated, panda_folds, ur10
from sklearn.multioutput import MultiOutputRegressor

from sklearn_raacmm import RBFNetRegressor

N_TEST = 1000
# Frequencies of the outputs of a table of random waves, over the first one's.
FREQUENCIES = {
    "agree": (1, 1, 1),
    "twice": (1, 1, 2),
    "three times": (1, 1, 3),
    "two and two": (1, 1, 3, 3),
}


def random_waves(rng, frequencies):
    """A function of one output: the mean of sixty waves, with a frequency for each feature."""
    waves = rng.standard_normal((len(frequencies), 60)) * np.reshape(frequencies, (-1, 1))
    phases = rng.uniform(0, 2 * np.pi, 60)
    return lambda X: np.cos(X @ waves + phases).sum(axis=1) / np.sqrt(30)


def drawn(name, n, seed):
    """Training rows and targets, test rows, and the truth there."""
    if name == "periodic3":
        problem = generated(name, n, seed)
        return problem.X, problem.y, problem.X_test, problem.truth
    rng = np.random.default_rng([seed, n])
    d = int(rng.integers(1, 4))
    if name == "other features":
        d = 2 * d
        functions = [random_waves(rng, np.repeat(ends, d // 2)) for ends in ((1.5, 0), (0, 1.5))]
    else:
        base = rng.uniform(1, 2) / np.sqrt(d) * np.exp(rng.uniform(-0.5, 0.5, d))
        functions = [random_waves(rng, factor * base) for factor in FREQUENCIES[name]]
    X = rng.uniform(-1, 1, (n + N_TEST, d))
    truth = np.column_stack([f(X) for f in functions])
    noise = rng.choice([0.03, 0.1, 0.3], truth.shape[1]) * rng.standard_normal(truth.shape)
    return X[:n], (truth + noise)[:n], X[n:], truth[n:]


def fitted(model, X, y):
    """The model, and CPU seconds."""
    start = process_time()
    model.fit(X, y)
    return model, process_time() - start


def compare(X, y, X_test, truth):
    """Errors (3, q) and CPU seconds (3,) of: by the data, all shared, one for each output."""
    found = [fitted(RBFNetRegressor(random_state=0), X, y)]
    with mock.patch("sklearn_raacmm.network._output_groups.MOST_OUTPUTS", 1):
        found.append(fitted(RBFNetRegressor(random_state=0), X, y))
    found.append(fitted(MultiOutputRegressor(RBFNetRegressor(random_state=0)), X, y))
    errors = [np.sqrt(np.mean((m.predict(X_test) - truth) ** 2, axis=0)) for m, _ in found]
    groups = found[0][0].output_groups_.max() + 1
    return np.array(errors), np.array([seconds for _, seconds in found]), groups


def row(name, n, results):
    """One line of the table."""
    errors, seconds, groups = zip(*results, strict=True)
    ratios = np.log(np.concatenate([e[:1] / e[1:] for e in errors], axis=1))
    seconds = np.sum(seconds, axis=0)
    split = sum(number > 1 for number in groups)
    of_errors, of_times = np.exp(ratios.mean(axis=1)), seconds[0] / seconds[1:]
    return (name, n, f"{split} of {len(groups)}", *of_errors, *of_times)


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description="Outputs with widths of their own.")
    parser.add_argument("--rows", nargs="*", type=int, default=[100, 300])
    parser.add_argument("--seeds", nargs="*", type=int, default=list(range(920, 924)))
    parser.add_argument("--arms", action="store_true", help="two real arms, too")
    args = parser.parse_args()
    columns = [("outputs", 22, ""), ("rows", 5, "d"), ("in groups", 9, "")]
    columns += [("error / shared", 14, ".3f"), ("/ each", 7, ".3f")]
    columns += [("time / shared", 13, ".2f"), ("/ each", 7, ".2f")]
    table = Table(*columns)
    for name in [*FREQUENCIES, "other features", "periodic3"]:
        for n in args.rows:
            table.row(*row(name, n, [compare(*drawn(name, n, seed)) for seed in args.seeds]))
    if args.arms:
        for joints in ("pose", "all"):
            arms = {"panda_3": panda_folds(joints), "UR10": ur10(joints, n=800, seed=1)}
            for name, problems in arms.items():
                some = list(problems)[:3]
                results = [compare(*problem[:4]) for problem in some]
                table.row(*row(f"{name}, {joints}", len(some[0].X), results))


if __name__ == "__main__":
    main()
