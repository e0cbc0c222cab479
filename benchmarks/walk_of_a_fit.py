"""Walk of a default fit through the package: own files, moves between them, own frames.

``python benchmarks/walk_of_a_fit.py`` fits the arm's model to a simulated single-point test, then
learns a correction from the same test, and counts, by Python's profiler hook, in how many of the
package's files a function ran, how often a call went from one of them to another, and how many of
the package's frames were open at once.
"""

import os
import sys

import sklearn_raacmm
from sklearn_raacmm import ArmResidualRegressor, learn_correction
from sklearn_raacmm.datasets import make_single_point

FOLDER = os.path.dirname(sklearn_raacmm.__file__)


def walk(call):
    """Files, moves between files and most frames at once while a function runs."""
    files, seen = set(), {"moves": 0, "deepest": 0}
    stack = [None]

    def hook(frame, event, _):
        name = frame.f_code.co_filename
        if event not in ("call", "return") or not name.startswith(FOLDER):
            return
        if event == "return":
            if len(stack) > 1:
                stack.pop()
            return
        files.add(name)
        seen["moves"] += stack[-1] is not None and stack[-1] != name
        stack.append(name)
        seen["deepest"] = max(seen["deepest"], len(stack) - 1)

    sys.setprofile(hook)
    try:
        call()
    finally:
        sys.setprofile(None)
    return len(files), seen["moves"], seen["deepest"]


def main():
    """Print the three numbers of a fit to 300 simulated poses, and of learning from them."""
    test = make_single_point(n_positions=10, n_poses=30, random_state=0)
    model = ArmResidualRegressor(test.arm)
    calls = {
        "fit of the arm's model": lambda: model.fit(test.data, test.target, groups=test.groups),
        "learn_correction": lambda: learn_correction(test.nominal_arm, test.data, test.groups),
    }
    for name, call in calls.items():
        call()  # tables that are kept are made
        found = walk(call)
        print("{}: own files {}, moves between files {}, frames {}".format(name, *found))


if __name__ == "__main__":
    main()
