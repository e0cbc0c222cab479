"""Functions of random rows, with noise: smooth, and of the length of the rows' spacing."""

import numpy as np


def smooth(n, seed=0, noise=0.1, d=2):
    rng = np.random.default_rng(seed)
    X = rng.uniform(-2, 2, (n, d))
    f = np.sin(2 * X[:, 0]) + np.cos(X[:, -1])
    return X, f + noise * rng.standard_normal(n), f


def rough(n, d, speed, seed=0):
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1, 1, (n, d))
    f = np.sin(speed * X).sum(axis=1)
    return X, f + 0.1 * rng.standard_normal(n), f
