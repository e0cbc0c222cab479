"""Regression problems of the benchmarks, generated with known truth."""

import resource
import time
import zlib
from typing import NamedTuple

import numpy as np
from sklearn.datasets import make_friedman1, make_friedman2, make_friedman3

N_TEST = 2000


def costs(call):
    """Result of a call, CPU seconds, and by how many MiB the peak of the memory has grown."""
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    result = call()
    seconds = time.process_time() - start
    return result, seconds, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024


class Problem(NamedTuple):
    """Training rows, and test rows with what is to be predicted there."""

    X: np.ndarray  # (n, d)
    y: np.ndarray  # (n,) or (n, q), with noise
    X_test: np.ndarray  # (n_test, d)
    truth: np.ndarray  # test targets: without noise if generated, as measured if real
    observed: np.ndarray  # test targets with noise


def _friedman(make, noise):
    def function(n, rng):
        X, f = make(n, noise=0.0, random_state=int(rng.integers(2**31)))
        return X, f, noise

    return function


def _periodic3(n, rng):
    """Three angles, three outputs, one of them twenty times smaller."""
    X = rng.uniform(-np.pi, np.pi, (n, 3))
    a, b, c = X.T
    first = np.sin(a) + 0.5 * np.cos(2 * b) * np.sin(c)
    f = np.stack([first, np.cos(a - b), 0.05 * np.sin(2 * c) * np.cos(a)], axis=1)
    return X, f, 0.1 * np.array([0.8, 0.7, 0.025])


def _robot_arm8(n, rng):
    """Distance of the end of a planar arm of four links (An and Owen 2001), bent up to 90 deg."""
    angles, lengths = rng.uniform(-np.pi / 2, np.pi / 2, (n, 4)), rng.uniform(0, 1, (n, 4))
    direction = np.cumsum(angles, axis=1)
    u, v = (lengths * np.cos(direction)).sum(axis=1), (lengths * np.sin(direction)).sum(axis=1)
    return np.hstack([angles, lengths]), np.hypot(u, v), 0.05


def _borehole8(n, rng):
    """Flow of water through a borehole (Morris, Mitchell, Ylvisaker 1993), m3/a."""
    low = np.array([0.05, 100, 63070, 990, 63.1, 700, 1120, 9855])
    high = np.array([0.15, 50000, 115600, 1110, 116, 820, 1680, 12045])
    X = rng.uniform(low, high, (n, 8))
    rw, r, tu, hu, tl, hl, length, kw = X.T
    log = np.log(r / rw)
    f = 2 * np.pi * tu * (hu - hl) / (log * (1 + tu / tl) + 2 * length * tu / (rw**2 * kw))
    return X, f, 1.0


def _kinks2(n, rng):
    """Rough: creases and a step along the diagonal."""
    X = rng.uniform(0, 1, (n, 2))
    f = np.abs(np.sin(8 * X[:, 0])) + np.abs(X[:, 1] - 0.4) + 0.3 * (X[:, 0] > X[:, 1])
    return X, f, 0.05


def _fourier3(n, rng):
    """Wiggly: two hundred random waves, the same for every n and seed."""
    fixed = np.random.default_rng(7)
    waves, phases = 8 * fixed.standard_normal((200, 3)), fixed.uniform(0, 2 * np.pi, 200)
    X = rng.uniform(0, 1, (n, 3))
    return X, 0.1 * np.cos(X @ waves.T + phases).sum(axis=1), 0.1


def _damped1(n, rng):
    X = rng.uniform(-3, 3, (n, 1))
    return X, np.sin(4 * X[:, 0]) * np.exp(-(X[:, 0] ** 2) / 4), 0.1


def _noisy5(n, rng):
    """Twice as much noise as signal, normal inputs, two of them without effect."""
    X = rng.standard_normal((n, 5))
    return X, np.tanh(X[:, 0] + 0.5 * X[:, 1] * X[:, 2]), 1.2


def waves(n, d):
    """Rows and targets of random waves, a function that asks for centres by the thousand."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (n, d))
    frequencies, phases = 2 * rng.normal(size=(60, d)), rng.uniform(0, 2 * np.pi, 60)
    f = np.sin(X @ frequencies.T + phases) @ rng.normal(size=60) / 5
    return X, f + 0.05 * rng.standard_normal(n)


# From (n, rng) to inputs, truth and the standard deviation of the noise.
GENERATED = {
    "friedman1": _friedman(make_friedman1, 1.0),
    "friedman2": _friedman(make_friedman2, 100.0),
    "friedman3": _friedman(make_friedman3, 0.1),
    "periodic3": _periodic3,
    "robot_arm8": _robot_arm8,
    "borehole8": _borehole8,
    "kinks2": _kinks2,
    "fourier3": _fourier3,
    "damped1": _damped1,
    "noisy5": _noisy5,
}


def generated(name, n, seed=0):
    """Problem of n training rows; every seed draws rows and noise anew."""
    rng = np.random.default_rng([seed, n, zlib.crc32(name.encode())])
    X, f, noise = GENERATED[name](n + N_TEST, rng)
    y = f + noise * rng.standard_normal(f.shape)
    return Problem(X[:n], y[:n], X[n:], f[n:], y[n:])
