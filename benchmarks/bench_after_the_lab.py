"""A correction of one day on another day's data: register, update, and what not to do.

A model is fitted to series A of a real UR10 and used on series B: the tracker was set up anew and
its target sits elsewhere on the flange. From some poses of B base and tool are found, and more; the
mean deviation at all other poses of B is printed, for five draws of these poses.

Run it with ``python benchmarks/bench_after_the_lab.py`` (two minutes). The data are downloaded,
or read from the folder that SKLEARN_RAACMM_DATA names.
"""

import argparse
import os
import time
import warnings
from pathlib import Path
from urllib.request import urlretrieve

import numpy as np
from _arm_folds import arm_model

from sklearn_raacmm import Arm, calibrate, update_correction

URL = (
    "https://raw.githubusercontent.com/christianlandgraf/ipa-robot-accuracy/"
    "507fba69bdaf6c43c2faf306e70a7e37c5e39b89/"
)
FILES = {
    "A": ("Series_A/measurements_grid.csv", (14, 15, 16)),
    "B": ("Series_B/measurements_joint_configurations.csv", (14, 16, 18)),
}
WAYS = ("no correction", "the natural way", "through the correction", "updated")


def read(series, folder):
    """Joint angles in rad and points in mm of one series."""
    name, columns = FILES[series]
    path = folder / Path(name).name
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        urlretrieve(URL + name, path)
    lines = path.read_text(encoding="utf-8-sig").replace(",", ".").splitlines()[1:]
    table = np.array([[float(field) for field in line.split(";")] for line in lines])
    return table[:, 7:13], table[:, columns]


def mean_deviation(residuals):
    return float(np.linalg.norm(residuals, axis=1).mean())


def one_draw(model, arm, angles, points, known):
    """Mean deviation in mm at the poses that are not `known`, each way, and processor seconds."""
    rest = ~known
    data = {"points": points[known], "free": ["probe"]}
    alone = calibrate(arm, angles[known], **data)
    start = time.process_time()
    through = calibrate(arm, angles[known], **data, correction=model)
    seconds = [time.process_time() - start]
    start = time.process_time()
    y = through.residuals(angles[known], points[known])
    updated = update_correction(model, angles[known], y)
    seconds.append(time.process_time() - start)
    bare = alone.residuals(angles[rest], points[rest])
    registered = through.residuals(angles[rest], points[rest])
    old, new = (m.predict(angles[rest]) for m in (model, updated))
    left = (bare, bare - old, registered - old, registered - new)
    return [mean_deviation(r) for r in left], seconds


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=None, help="poses of A (default all)")
    parser.add_argument("--draws", type=int, default=5)
    options = parser.parse_args()
    root = os.environ.get("SKLEARN_RAACMM_DATA", Path.home() / "scikit_learn_data")
    folder = Path(root) / "ur10_tracker"
    angles, points = read("A", folder)
    rows = np.random.default_rng(0).permutation(len(angles))[: options.rows]
    first = calibrate(Arm.from_name("ur10", probe=(0, 0, 93)), angles[rows], points=points[rows])
    model = arm_model(first.arm).fit(angles[rows], first.residuals_mm)
    angles, points = read("B", folder)
    print(f"Model of {len(rows)} poses of A, used on B. Mean deviation, mm: median (largest)")
    print("poses  " + "".join(f"{way:>26}" for way in WAYS) + "    seconds: register, update")
    for n in (10, 20, 60, 200):
        draws = []
        for seed in range(options.draws):
            known = np.zeros(len(angles), bool)
            known[np.random.default_rng(seed).permutation(len(angles))[:n]] = True
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                draws.append(one_draw(model, first.arm, angles, points, known))
        left, seconds = (np.array([draw[i] for draw in draws]) for i in range(2))
        cells = [f"{np.median(c):.3f} ({c.max():.3f})" for c in left.T]
        print(f"{n:5}  " + "".join(f"{cell:>26}" for cell in cells), end="")
        print("    " + ", ".join(f"{s:.2f}" for s in np.median(seconds, axis=0)))


if __name__ == "__main__":
    main()
