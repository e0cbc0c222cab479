"""
Outputs with widths of their own
================================

`RBFNetRegressor` gives each output a network of its own. Here it stands beside the published form,
in which all outputs share kernel, widths and centres (`shared=True`): on random functions that
agree, that differ in frequency or in the features they depend on, and with `--arms` on two real
arms at positions left out. Of errors the root mean square over new rows is taken, and of the ratios
of outputs and draws the geometric mean; of times, centres and numbers in a prediction the ratio of
the sums.

The default takes about 70 CPU seconds, with `--arms` twice as long.
"""

import argparse
from time import process_time

import numpy as np
from _comparison import Table
from _problems import generated, panda_folds, ur10

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
    """Errors (2, q), CPU seconds of fits and predictions, centres: each its own, and shared."""
    errors, sums = [], []
    for shared in (False, True):
        model, seconds = fitted(RBFNetRegressor(shared=shared, random_state=0), X, y)
        start = process_time()
        mean = model.predict(X_test)
        errors.append(np.sqrt(np.mean((mean - truth) ** 2, axis=0)))
        sums.append([seconds, process_time() - start, len(model.centers_)])
    return np.array(errors), np.array(sums)


def row(name, n, results):
    """One line of the table."""
    errors, sums = zip(*results, strict=True)
    ratios = np.log(np.concatenate([e[0] / e[1] for e in errors]))
    total = np.sum(sums, axis=0)
    return (name, n, np.exp(ratios.mean()), np.exp(ratios.max()), *(total[0] / total[1]))


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description="Outputs with widths of their own.")
    parser.add_argument("--rows", nargs="*", type=int, default=[100, 300])
    parser.add_argument("--seeds", nargs="*", type=int, default=list(range(920, 924)))
    parser.add_argument("--arms", action="store_true", help="two real arms, too")
    args = parser.parse_args()
    columns = [("outputs", 22, ""), ("rows", 5, "d"), ("error / shared", 14, ".3f")]
    columns += [
        ("worst", 7, ".3f"),
        ("fit", 5, ".2f"),
        ("predict", 7, ".2f"),
        ("centres", 7, ".2f"),
    ]
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
