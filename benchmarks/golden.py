"""Golden numbers: what a redesign must keep, written by one command and compared by it.

    python benchmarks/golden.py --compare

measures again what ``benchmarks/golden.json`` holds and prints a table of name, before, now and
their ratio, in which a star marks what has moved by more than 0.5 %. ``--write`` puts what was
measured into the file, ``--only`` takes some of the sections. CPU seconds depend on the machine:
they are shown beside the numbers and not compared. One thread, 215 CPU seconds of which the real
UR10 takes 80 and the network 40.

``--walk`` counts, by Python's profiler hook, in how many of the package's files a function ran
during a default fit of the arm's model and while a correction was learned, how often a call went
from one of them to another, and how many of the package's frames were open at once.
"""

import argparse
import json
import os
import sys
import time
import warnings
from pathlib import Path

import _one_thread  # noqa: F401
import numpy as np
from _arm_folds import DATA
from _golden_numbers import SECTIONS, seconds

import sklearn_raacmm
from sklearn_raacmm import ArmResidualRegressor, learn_correction
from sklearn_raacmm.datasets import make_single_point

FOLDER = os.path.dirname(sklearn_raacmm.__file__)
FILE = Path(__file__).with_name("golden.json")
MOVED = 0.005  # a move keeps the numbers to rounding; a fold of two mechanisms may cost this much


def measured(names, data_home):
    """Numbers by section, and CPU seconds of each section and of two fits."""
    found, spent = {}, {}
    for name in names:
        start = time.process_time()
        # In full precision a file would differ by what another processor rounds differently.
        numbers_of_section = SECTIONS[name](data_home)
        found[name] = {k: float(f"{v:.6g}") for k, v in numbers_of_section.items()}
        spent[f"section {name}"] = round(time.process_time() - start, 1)
        print(f"{name}: {len(found[name])} numbers, {spent[f'section {name}']} CPU s", flush=True)
    spent |= {name: round(value, 2) for name, value in seconds(data_home).items()}
    return found, spent


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


def print_walk():
    """Of a fit to 300 simulated poses and of learning from them: files, moves and frames."""
    test = make_single_point(n_positions=10, n_poses=30, random_state=0)
    model = ArmResidualRegressor(test.arm)
    calls = {
        "fit of the arm's model": lambda: model.fit(test.data, test.target, groups=test.groups),
        "learn_correction": lambda: learn_correction(test.nominal_arm, test.data, test.groups),
    }
    for name, call in calls.items():
        call()  # tables that are kept are made
        print("{}: own files {}, moves between files {}, frames {}".format(name, *walk(call)))


def line(name, before, now, is_compared):
    """One line of the table, and whether the number has moved."""
    if before is None or now is None:
        ratio, moved = "", is_compared
    else:
        close = np.isclose(before, now, rtol=MOVED, atol=1e-12)
        ratio, moved = f"{now / before:.4f}" if before else "", is_compared and not close
    cells = ["-" if value is None else f"{value:.6g}" for value in (before, now)]
    return f"{name:66}{cells[0]:>12}{cells[1]:>12}{ratio:>9}{' *' if moved else ''}", moved


def compare(before, found, spent):
    """Print before and now; return how many numbers have moved."""
    print(f"\n{'':66}{'before':>12}{'now':>12}{'ratio':>9}")
    n_moved = n = 0
    for section, now in found.items():
        old = before["numbers"].get(section, {})
        for name in {**old, **now}:
            text, moved = line(name, old.get(name), now.get(name), True)
            n, n_moved = n + 1, n_moved + moved
            print(text)
    for name, value in spent.items():
        print(line(f"CPU s, {name}", before["cpu_seconds"].get(name), value, False)[0])
    print(f"\n{n_moved} of {n} numbers have moved by more than {MOVED:.1%}.")
    return n_moved


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--compare", action="store_true", help="with the file (the default)")
    parser.add_argument("--write", action="store_true", help="put the numbers into the file")
    parser.add_argument("--only", nargs="+", choices=SECTIONS, default=list(SECTIONS))
    parser.add_argument("--walk", action="store_true", help="files that a fit goes through")
    parser.add_argument("--data-home", default=DATA, help="folder of the real data")
    options = parser.parse_args()
    if options.walk:
        return print_walk()
    warnings.simplefilter("ignore")  # of few poses, and of what has faded
    before = {"numbers": {}, "cpu_seconds": {}}
    if FILE.exists():
        before = json.loads(FILE.read_text(encoding="utf-8"))
    found, spent = measured(options.only, options.data_home)
    compare(before, found, spent)
    if options.write:
        before["numbers"] |= found
        before["cpu_seconds"] |= spent
        FILE.write_text(json.dumps(before, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
