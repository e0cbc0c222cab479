"""Forward selection of radial functions: time and memory against peers on one Gaussian dictionary.

Every peer chooses k of n columns exp(-|x_i - x_j|^2 / (2 l^2)), about their mean, for one target;
data are uniform in a cube with a smooth function and noise, or with random waves in 6 features
(--problem waves), which take centres by the hundred. Each run is a process of its own with
one BLAS and OpenMP thread; printed are medians of the CPU time from data to chosen centres (peers
are given the ready dictionary for free), of its ratio to ours in the same round, of the peak memory
above the imports, and how many centres are those of exact orthogonal least squares (fastcan).
orthogonal_mp is another, cheaper choice: it does not look at what is left of a candidate.

    python benchmarks/bench_selection.py --n 3000 --k 200 --repeats 3
    python benchmarks/bench_selection.py --problem waves --n 1500 --k 800 --length-scale 1
"""

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import time

METHODS = ["RBFNetRegressor", "fastcan", "orthogonal_mp", "orthogonal_mp_gram"]


def data(n, d, seed=0, problem="smooth"):
    import numpy as np

    rng = np.random.default_rng(seed)
    X = rng.uniform(-1, 1, (n, d))
    if problem == "waves":
        waves, phases = 2 * rng.normal(size=(60, d)), rng.uniform(0, 2 * np.pi, 60)
        f = np.sin(X @ waves.T + phases) @ rng.normal(size=60) / 5
        return X, f + 0.05 * rng.standard_normal(n)
    y = np.sin(4 * X[:, 0]) * np.cos(2 * X[:, 1]) + X[:, 2] ** 2 + 0.05 * rng.standard_normal(n)
    return X, y


def run(method, n, k, length_scale, problem):
    import numpy as np
    from scipy.spatial.distance import cdist

    X, y = data(n, 6 if problem == "waves" else 3, problem=problem)
    if method == "RBFNetRegressor":
        from sklearn_raacmm import RBFNetRegressor

        RBFNetRegressor(2, length_scale=1.0, alpha=0).fit(X[:10], y[:10])  # imports, thread pools
        base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        start = time.process_time()
        model = RBFNetRegressor(k, length_scale=length_scale, alpha=0).fit(X, y)
        seconds = time.process_time() - start
        chosen = model.center_indices_
    else:
        if method == "fastcan":
            from fastcan import FastCan
        else:
            from sklearn.linear_model import orthogonal_mp, orthogonal_mp_gram
        base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        K = cdist(X, X, "sqeuclidean")
        K /= -2 * length_scale**2
        np.exp(K, out=K)
        start = time.process_time()
        if method == "fastcan":
            chosen = FastCan(k, verbose=0).fit(K, y[:, None]).indices_
        else:
            K -= K.mean(axis=0)
            norms = np.linalg.norm(K, axis=0)
            K /= norms
            if method == "orthogonal_mp":
                coef = orthogonal_mp(K, y - y.mean(), n_nonzero_coefs=k, return_path=False)
            else:
                coef = orthogonal_mp_gram(K.T @ K, K.T @ (y - y.mean()), n_nonzero_coefs=k)
            chosen = np.flatnonzero(coef)  # it does not tell the order
        seconds = time.process_time() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base
    result = {"seconds": seconds, "mib": peak / 1024, "chosen": [int(i) for i in chosen]}
    print(json.dumps(result))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=int, default=3000)
    parser.add_argument("--k", type=int, default=200)
    parser.add_argument("--length-scale", type=float, default=0.5)
    parser.add_argument("--problem", default="smooth", choices=["smooth", "waves"])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--methods", nargs="+", default=METHODS, choices=METHODS)
    parser.add_argument("--one", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        run(args.one, args.n, args.k, args.length_scale, args.problem)
        return
    one_thread = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    results = {method: [] for method in args.methods}
    for _ in range(args.repeats):
        for method in args.methods:  # interleaved, so that a busy moment hits all alike
            command = [sys.executable, __file__, "--one", method]
            for name in ("n", "k", "length_scale", "problem"):
                command += [f"--{name.replace('_', '-')}", str(getattr(args, name))]
            out = subprocess.run(
                command, env=os.environ | one_thread, capture_output=True, text=True, check=True
            ).stdout
            results[method].append(json.loads(out))
    ours = results[args.methods[0]]
    print(
        f"{args.problem}: n = {args.n}, k = {args.k}, length_scale = {args.length_scale}, 1 thread"
    )
    print(f"{'method':<20} {'CPU s':>9} {'ratio':>7} {'MiB':>7} {'same centres':>13}")
    reference = results["fastcan"][0]["chosen"] if "fastcan" in results else ours[0]["chosen"]
    for method, runs in results.items():
        seconds = statistics.median(r["seconds"] for r in runs)
        ratio = statistics.median(
            r["seconds"] / o["seconds"] for r, o in zip(runs, ours, strict=True)
        )
        same = len(set(reference) & set(runs[0]["chosen"]))
        mib = statistics.median(r["mib"] for r in runs)
        print(f"{method:<20} {seconds:>9.3f} {ratio:>6.1f}x {mib:>7.0f} {same:>7}/{args.k}")


if __name__ == "__main__":
    main()
