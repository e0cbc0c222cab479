"""Time of a default fit beside a peer.

    python benchmarks/bench_fit.py --problem fourier3 --rows 300
    python benchmarks/bench_fit.py --problem robot_arm8 --rows 1000
    python benchmarks/bench_fit.py --problem waves --rows 3000 --no-peer
    python benchmarks/bench_fit.py --problem rough8 --rows 10000 --repeats 1
    python benchmarks/bench_fit.py --problem arm

For a network the peer is an exact Gaussian process written by hand as well as one can with SciPy:
Gaussian kernel, a width for each feature, analytic gradient, one Cholesky factor an evaluation, and
L-BFGS. It has one kernel and one start, where the network compares kernels and starts. Beyond 3000
rows its widths and ridge come from 1000 of them. "waves" are random waves in 6 features, and
"rough8" longer ones in 8: functions that ask for centres by the thousand. On an "arm", 300 poses of
a single-point test, `ArmResidualRegressor` is compared with the same model of low orders only.

Both are fitted in one process with one BLAS and OpenMP thread, by turns. Printed are medians of the
CPU time and of its ratio in the same round.
"""

import argparse
import time
from functools import partial

import _one_thread  # noqa: F401
import numpy as np
from _problems import GENERATED, Problem, generated
from bench_selection import data as selection_data
from scipy.linalg import lapack
from scipy.optimize import minimize

from sklearn_raacmm import ArmResidualRegressor, RBFNetRegressor
from sklearn_raacmm.datasets import make_single_point

N_TEST = 1000
# Rows up to which the peer takes all for its widths, and how many beyond: an evaluation of 10 000
# rows would take half a minute.
MOST_ROWS, WIDTH_ROWS = 3000, 1000


class ExactProcess:
    """A Gaussian process by maximum likelihood; the signal's variance is at its optimum."""

    def fit(self, X, y):
        """Maximise the likelihood from one start."""
        self.mean, self.shift, self.spread = y.mean(), X.mean(axis=0), X.std(axis=0)
        self.Z, self.y = (X - self.shift) / self.spread, y - y.mean()
        d = X.shape[1]
        start = np.append(np.full(d, 0.5 * np.log(d)), np.log(0.1))
        bounds = [(-4, 7)] * d + [(np.log(1e-8), np.log(1e3))]
        every = self.Z, self.y
        if len(y) > MOST_ROWS:
            self.Z, self.y = self.Z[:WIDTH_ROWS], self.y[:WIDTH_ROWS]
        found = minimize(self.loss, start, jac=True, method="L-BFGS-B", bounds=bounds)
        self.Z, self.y = every
        factor = self.factor(found.x)[2]
        self.solved = lapack.dpotrs(factor, self.y, lower=1)[0]
        return self

    def factor(self, z):
        """Scaled rows, their kernel matrix, and the factor of it with the ridge."""
        self.scale = np.exp(-z[:-1])
        S = self.Z * self.scale
        squares = np.einsum("ij,ij->i", S, S)
        K = S @ S.T
        K -= 0.5 * squares
        K -= 0.5 * squares[:, None]
        np.exp(K, out=K)
        C = K.copy(order="F")
        C[np.diag_indices(len(C))] += np.exp(z[-1])
        return S, K, lapack.dpotrf(C, lower=1, overwrite_a=1)[0]

    def loss(self, z):
        """Negative log likelihood, up to a constant, and its gradient."""
        n = len(self.y)
        alpha = np.exp(z[-1])
        S, K, factor = self.factor(z)
        log_det = 2 * np.log(factor.diagonal()).sum()
        self.solved = lapack.dpotrs(factor, self.y, lower=1)[0]
        signal = self.y @ self.solved / n
        inverse = lapack.dpotri(factor, lower=1, overwrite_c=1)[0]
        trace = np.trace(inverse)
        # The lower triangle is enough: all is symmetric, and the diagonal has no distance.
        G = np.tril(inverse, -1)
        G -= np.outer(self.solved, self.solved / signal)
        G *= K
        G = np.tril(G, -1)
        # Squared differences of one feature, summed with weights G.
        both = G.sum(axis=0) + G.sum(axis=1)
        d_width = both @ S**2 - 2 * np.einsum("ij,ij->j", S, G @ S)
        d_alpha = 0.5 * alpha * (trace - self.solved @ self.solved / signal)
        return 0.5 * (log_det + n * np.log(signal)), np.append(d_width, d_alpha)

    def predict(self, X):
        """Return the posterior mean."""
        S, T = self.Z * self.scale, (X - self.shift) / self.spread * self.scale
        s = np.square(T).sum(1)[:, None] + np.square(S).sum(1) - 2 * T @ S.T
        return self.mean + np.exp(-0.5 * s) @ self.solved


def problem_of(name, n):
    if name == "rough8":
        rng = np.random.default_rng(0)
        X = rng.uniform(-1, 1, (n + N_TEST, 8))
        waves, phases = 0.9 * rng.standard_normal((60, 8)), rng.uniform(0, 2 * np.pi, 60)
        f = np.sin(X @ waves.T + phases) @ rng.standard_normal(60) / 5
        y = f + 0.1 * rng.standard_normal(len(f))
        return Problem(X[:n], y[:n], X[n:], f[n:], y[n:])
    if name != "waves":
        return generated(name, n)
    X, y = selection_data(n + N_TEST, 6, problem="waves")
    return Problem(X[:n], y[:n], X[n:], y[n:], y[n:])


def by_turns(repeats, *fits):
    """Median of the CPU time of each function, and of the ratios of the first to the second."""
    times = np.empty((repeats, len(fits)))
    for row in times:
        for i, fit in enumerate(fits):
            start = time.process_time()
            fit()
            row[i] = time.process_time() - start
    return *np.median(times, axis=0), np.median(times[:, 0] / times[:, -1])


def network(args):
    problem, models = problem_of(args.problem, args.rows), [RBFNetRegressor(random_state=0)]
    if args.peer:
        models.append(ExactProcess())
    warm = generated("damped1", 30)
    for model in models:
        model.fit(warm.X, warm.y)  # imports and thread pools
    fits = [partial(model.fit, problem.X, problem.y) for model in models]
    *seconds, ratio = by_turns(args.repeats, *fits)
    print(f"{args.problem}, {args.rows} rows, {problem.X.shape[1]} features, 1 thread")
    for model, taken in zip(models, seconds, strict=True):
        left = model.predict(problem.X_test) - problem.truth
        error = np.sqrt(np.mean(left**2)) / np.std(problem.truth)
        print(f"{type(model).__name__} {taken:.3f} s, error {error:.4f}")
    print(f"{len(models[0].centers_)} centres; ratio {ratio:.2f}")


def arm(args):
    data = make_single_point(n_positions=args.rows // 30, n_poses=30, random_state=0)
    models = ArmResidualRegressor(data.arm), ArmResidualRegressor(data.arm, orders=12)
    fits = [partial(model.fit, data.data, data.target, groups=data.groups) for model in models]
    whole, low, ratio = by_turns(args.repeats + 1, *fits)
    print(f"{len(data.data)} poses at {args.rows // 30} positions, 1 thread")
    print(f"ArmResidualRegressor {whole:.2f} s, with orders up to 12 {low:.2f} s: {ratio:.2f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--problem", default="fourier3", choices=["arm", "waves", "rough8", *GENERATED]
    )
    parser.add_argument("--rows", type=int, default=300)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--no-peer", dest="peer", action="store_false")
    args = parser.parse_args()
    (arm if args.problem == "arm" else network)(args)


if __name__ == "__main__":
    main()
