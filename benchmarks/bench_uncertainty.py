"""How large errors of diameters and lengths are, in the standard deviations that the model states.

Simulated arms are learnt at 12 cones and measure spheres of 25 points and lengths elsewhere. The
corrections alone are looked at: what they leave of the true errors of the arm changes the fitted
diameter and the length. Root mean square of error over standard deviation, which should be 1: by
what such a test shows of all poses together, by all that the model knows (``with_unseen=True``),
and as though every point were independent.

Run it with ``python benchmarks/bench_uncertainty.py`` (two minutes).
"""

import argparse
import warnings

import numpy as np
from bench_check_kinds import KINDS

from sklearn_raacmm import ArmResidualRegressor
from sklearn_raacmm.datasets import SimulatedArm, make_single_point


def sphere(machine, rng):
    """Poses at 25 points of a sphere of 50 mm somewhere."""
    for _ in range(100):
        place = rng.uniform([300, -500, 0], [900, 500, 400])
        normals = rng.normal(size=(25, 3))
        normals[:, 2] = np.abs(normals[:, 2])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        try:
            poses = [machine.find_poses(place + 25 * n, 1, rng.randint(2**31)) for n in normals]
        except ValueError:
            continue
        return np.concatenate(poses), normals
    raise ValueError("no place for a sphere was found")


def of_diameter(normals):
    """Derivatives (3 n,) of the diameter that least squares fit, by the points."""
    design = np.column_stack([normals, np.ones(len(normals))])
    weights = 2 * np.linalg.pinv(design)[3]
    return (weights[:, None] * normals).ravel()


def of_length(points):
    line = points[1] - points[0]
    line = line / np.linalg.norm(line)
    return np.r_[-line, line]


def one_arm(errors, seed, n_spheres):
    """Errors over standard deviations of diameters and lengths: shown, all, independent."""
    machine = SimulatedArm(errors, random_state=seed)
    known = make_single_point(12, 30, machine=machine, random_state=seed)
    model = ArmResidualRegressor(known.arm).fit(known.data, known.target, groups=known.groups)
    rng = np.random.RandomState(seed)
    found = []
    for _ in range(n_spheres):
        poses, normals = sphere(machine, rng)
        far = sphere(machine, rng)[0][:1]
        row = []
        for angles, is_sphere in ((poses, True), (np.vstack([poses[:1], far]), False)):
            g = of_diameter(normals) if is_sphere else of_length(known.arm.forward(angles))
            true = known.arm.forward(angles) - machine.forward(angles)
            for unseen in (False, True):
                mean, cov = model.predict(angles, return_cov=True, with_unseen=unseen)
                error = g @ (true - mean).ravel()
                row.append(error / np.sqrt(g @ cov @ g))
            row.append(error / np.sqrt(np.square(g) @ cov.diagonal()))
        found.append(row)
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", type=int, default=4, help="of each kind")
    parser.add_argument("--spheres", type=int, default=10, help="of each arm")
    options = parser.parse_args()
    ways = [f"{what}, {way}" for what in ("diameter", "length")
            for way in ("shown", "all", "independent")]  # fmt: skip
    print(f"{'':14}" + "".join(f"{way:>23}" for way in ways))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for kind, errors in KINDS.items():
            z = np.concatenate([
                one_arm(errors, seed, options.spheres) for seed in range(options.arms)
            ])  # fmt: skip
            rms = np.sqrt(np.mean(np.square(z), axis=0))
            print(f"{kind:14}" + "".join(f"{value:23.2f}" for value in rms), flush=True)


if __name__ == "__main__":
    main()
