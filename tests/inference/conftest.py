"""Small regression problems with columns that are written out, and their evidence by SciPy."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from sklearn_raacmm.inference import GramRows, Problem, Structures, Sums
from sklearn_raacmm.inference._linear import pair_columns


def sums_of(A, H, y):
    """Sums of columns that are written out."""
    gram = H.T @ H
    i = 2 * np.arange(H.shape[1] // 2)
    own = np.array([gram[i, i], gram[i + 1, i + 1], gram[i, i + 1]])
    rows = GramRows(lambda pairs: gram[pair_columns(pairs)], H.shape[1])
    return Sums(A.T @ A, A.T @ y, A.T @ H, own, H.T @ y, y @ y, float(len(y)), rows)


def structures(n_always, n_pairs, price=None, share=None, field_price=16.0):
    """One family, lines of one price, and maybe a field: variances in this order."""
    price = np.log(n_pairs) if price is None else price
    return Structures(
        family=np.zeros(n_always, dtype=int),
        price=np.full(n_pairs, price),
        share=share,
        field_price=field_price,
        given=np.full(3, np.nan),
        largest=1e6,
    )


def drawn(seed, n=80, n_pairs=12):
    """Pairs 2 and 5 of 12 and all four columns that are always in matter."""
    rng = np.random.default_rng(seed)
    A, H = rng.normal(size=(n, 4)), rng.normal(size=(n, 2 * n_pairs))
    w = np.zeros(2 * n_pairs)
    w[[4, 5, 10, 11]] = [1.0, -0.5, 0.3, 0.8]
    y = A @ (0.3 * rng.normal(size=4)) + H @ w + 0.5 * rng.normal(size=n)
    problem = Problem(sums_of(A, H, y), structures(4, n_pairs))
    return SimpleNamespace(A=A, H=H, y=y, problem=problem)


def log_evidence(toy, prior, noise):
    """Of y with independent normal coefficients; `prior` are those of A's columns and of pairs."""
    of_a, of_pairs = prior
    waves = np.repeat(of_pairs, 2)
    cov = noise * np.eye(len(toy.y)) + of_a * toy.A @ toy.A.T + (toy.H * waves) @ toy.H.T
    return multivariate_normal(np.zeros(len(toy.y)), cov).logpdf(toy.y)


def evidence_of_lines(toy, lines, variance, noise):
    """The same where these pairs are lines of one variance."""
    of_pairs = np.where(np.isin(np.arange(toy.H.shape[1] // 2), lines), variance[1], 0.0)
    return log_evidence(toy, (variance[0], of_pairs), noise)


@pytest.fixture(scope="session")
def toys():
    """The functions above, under one name."""
    return SimpleNamespace(
        sums_of=sums_of,
        structures=structures,
        drawn=drawn,
        log_evidence=log_evidence,
        evidence_of_lines=evidence_of_lines,
    )
