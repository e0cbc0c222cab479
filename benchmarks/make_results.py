"""Regressors side by side: make the file of results again, or print a part of it.

``doc/results.json`` holds every measured number of the README and of the pages "Evidence",
"Which estimator?" and "The paper's experiment and ours", and the tables of "After the lab",
"Lengths", "Other causes" and of alarms. This command measures them again, writes the file and the
README's tables, and says which numbers have moved by more than a hundredth: without options what
the README shows, in about ten CPU minutes, ``--all`` all of it over night, ``--all --missing`` only
what the file lacks, ``--only panda --models ridge trees`` a part. ``--print`` writes nothing, and
ends with exit code 1 where a number has moved. Numbers that are not made again stay as they are;
each entry says when it was made. Whoever stops the job with Ctrl-C keeps what was finished. Real
data are downloaded the first time.

Lengths are in mm. mean, max: deviation from the position's mean point (UR10: from the tracker's
point); two_s: single-point repeatability; less: reduction of its mean (UR10: of the deviation);
of_possible: share of what a perfect model reduces, which knows all but the noise; length: error of
known lengths; r2: plain, and with one free constant per position (within); fit_seconds: CPU time
with the choice of settings; bytes: pickled.
"""

import argparse
import datetime
import json
import os
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import _data_sets
import bench_after_the_lab
import bench_beyond_the_paper
import bench_check
import bench_lengths
import numpy as np
from _arm_folds import MIXES
from _data_sets import COSTS, fetched
from _regressors import ALL, ANGLES, MODELS, PAPER

from sklearn_raacmm import Arm, ArmResidualRegressor, __version__, calibrate, position_residuals
from sklearn_raacmm.datasets import fetch_panda_ball_socket, fetch_ur10_tracker

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "doc"))
from _results import FILE, write_readme  # noqa: E402

# The models of the README's table.
HEADLINE = [
    (PAPER, "RBF network"),
    (ALL, "RBF network"),
    (ANGLES, "ArmResidualRegressor"),
]
# The models of which several individuals of each simulated arm are shown.
INDIVIDUALS = [
    (PAPER, "RBF network, newrb"),
    (PAPER, "RBF network, one width"),
    (PAPER, "RBF network"),
    (PAPER, "RBF network, Cartesian"),
    (ALL, "RBF network"),
    (ANGLES, "ArmResidualRegressor"),
]
SHOWN = [*INDIVIDUALS, (PAPER, "kernel ridge"), (PAPER, "extra trees")]
# Parts of other scripts whose tables pages show, with what their commands take; quick ones first.
PARTS = {
    "scale": (bench_lengths.scale, {"arms": 10}),
    "changes": (bench_check.changes, {"runs": 60, "real": True}),
    "plan": (bench_after_the_lab.plan, {"seeds": None}),
    "lengths": (bench_lengths.lengths, {"arms": 12}),
    "extra": (bench_beyond_the_paper.extra, {"seeds": 8, "real": False}),
    "series": (bench_after_the_lab.series, {"seeds": None}),
    "probes": (bench_after_the_lab.probes, {"seeds": None}),
    "transfer": (bench_after_the_lab.transfer, {"seeds": None, "panda": False}),
    "months": (bench_after_the_lab.months, {"seeds": None}),
    "kinds": (bench_check.kinds, {"arms": 20, "days": 10, "runs": 60, "real": False}),
}
SEEDS = 3
# Positions, poses at each, and outer folds of the simulated arms: the paper's ten positions.
SIMULATED = (10, 60, 5)
MOVED = 0.01  # relative change from which a number is said to have moved
# Beside a published result on 724 poses, of which eight tenths were learnt from.
FEW_POSES, PUBLISHED_POSES = 500, 724


def data_sets(everything, data_home):
    """Name of each data set, how it is made or read, and the models that learn from it.

    What sentences of the pages need comes first, the rows of their longest tables last.
    """

    def simulated(mix, seed):
        how = (mix, seed, *SIMULATED)
        return f"simulated, {mix}, seed {seed}", _data_sets.simulated, how

    first = [simulated(mix, 0) for mix in MIXES]
    for arm in ("panda_3", "panda_2"):
        first.append((f"real, {arm}", _data_sets.panda, (arm, data_home)))
    rows = _data_sets.UR10_ROWS
    first.append(("real, ur10", _data_sets.ur10, (rows, data_home)))
    sets = [(*data, HEADLINE) for data in first]
    if everything:
        sets += [(*data, [name for name in SHOWN if name not in HEADLINE]) for data in first[:3]]
        for seed in range(1, SEEDS):
            sets += [(*simulated(mix, seed), INDIVIDUALS) for mix in MIXES]
        sets += [(*data, [(PAPER, "RBF network, Cartesian")]) for data in first[3:]]
        # As many poses at each position as the paper has.
        title, make, (*how, _, n_folds) = simulated("typical", 0)
        models = [(PAPER, "RBF network, newrb"), (ANGLES, "ArmResidualRegressor")]
        sets.append((f"{title}, 300 poses", make, (*how, 300, n_folds), models))
        done = {name for *_, names in sets for name in names}
        sets += [(*data, [name for name in MODELS if name not in done]) for data in first[:3]]
        real = {*HEADLINE, (PAPER, "RBF network, Cartesian")}
        sets += [(*data, [name for name in MODELS if name not in real]) for data in first[3:]]
    return sets


def rounded(record):
    """Keep five digits of a measure and two of a cost; leave out what does not apply."""
    kept = {}
    for name, value in record.items():
        if value is not None and name not in ("data", "inputs", "regressor"):
            kept[name] = float(f"{value:.{2 if name in COSTS else 5}g}")
    return kept


def tables_of(name):
    """Tables of a part: of each title, row and column a number of five digits."""
    part, options = PARTS[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of few poses, and of what has faded
        tables = part(SimpleNamespace(**options))
    return {
        title: {row: rounded(values) for row, values in rows.items()}
        for title, rows in tables.items()
    }


def few_poses(data_home, n_draws=5):
    """Distance from the tracker where few poses of a UR10 are learnt from, mm.

    Twice: poses drawn at random of all goals, as the published result has it, eight tenths of 724
    learnt from and a tenth judged; and 500 poses, judged at goals of which no pose was learnt.
    """
    data = fetched(fetch_ur10_tracker, data_home=data_home)
    rng = np.random.default_rng(0)
    distances = {"random": [], "unseen goals": []}
    before = {"random": [], "unseen goals": []}
    for _ in range(n_draws):
        some = rng.permutation(len(data.data))[:PUBLISHED_POSES]
        n = round(0.8 * PUBLISHED_POSES)
        goals = rng.permutation(data.groups.max() + 1)
        unseen = np.isin(data.groups, goals[: len(goals) // 3])
        splits = {
            "random": (some[:n], some[-PUBLISHED_POSES // 10 :]),
            "unseen goals": (
                rng.permutation(np.flatnonzero(~unseen))[:FEW_POSES],
                np.flatnonzero(unseen),
            ),
        }
        for name, (learn, test) in splits.items():
            arm, residuals = _data_sets.calibrated(data, learn)
            model = ArmResidualRegressor(arm).fit(data.data[learn], residuals[learn])
            left = residuals[test] - model.predict(data.data[test])
            distances[name].append(np.linalg.norm(left, axis=1))
            before[name].append(np.linalg.norm(residuals[test], axis=1))
    return {
        name: rounded(
            {
                "uncorrected_mean_mm": np.mean([d.mean() for d in before[name]]),
                "mean_mm": np.mean([d.mean() for d in found]),
                "lowest_mean_mm": min(d.mean() for d in found),
                "highest_mean_mm": max(d.mean() for d in found),
                "sd_mm": np.mean([d.std() for d in found]),
                "draws": n_draws,
            }
        )
        for name, found in distances.items()
    }


def authors_calibration(data_home, urdf):
    """Deviation from the mean of the socket by the URDF that the data's authors calibrated, mm.

    Their tool fitted it to sockets of this robot; `calibrate` beside it has seen all sockets, too.
    """
    data = fetched(fetch_panda_ball_socket, "panda_3", data_home=data_home)
    with warnings.catch_warnings():
        # The base of the file lies a fixed motion beside that of the table: no deviation changes.
        warnings.filterwarnings("ignore", message="The first axis does not start")
        theirs = Arm.from_urdf(urdf, base="panda_link0", tip="ball_link")
    ours = calibrate(data.nominal_arm, data.data, data.groups).arm
    found = {}
    for name, arm in (("theirs", theirs), ("ours", ours)):
        left = position_residuals(arm.forward(data.data), data.groups)
        distance = np.linalg.norm(left, axis=1)
        found[name] = rounded({"mean_mm": distance.mean(), "max_mm": distance.max()})
    return found


def moved(old, new, path=()):
    """Yield a line for every number that changed by more than a hundredth, costs left out."""
    for name, value in new.items():
        here = (*path, name)
        if isinstance(value, dict):
            yield from moved(old.get(name, {}), value, here)
        elif isinstance(value, float) and name not in COSTS:
            was = old.get(name)
            if was is None:
                yield f"{' / '.join(here)}: {value:g} (new)"
            elif abs(value - was) > MOVED * max(abs(was), 1e-12):
                yield f"{' / '.join(here)}: {was:g} -> {value:g}"


def parsed(argv):
    """Options of the command."""
    parser = argparse.ArgumentParser(description="Make doc/results.json and the README again.")
    parser.add_argument("--all", action="store_true", help="everything, over night")
    parser.add_argument("--only", nargs="*", help="data sets whose name holds one of these")
    parser.add_argument("--models", nargs="*", help="models whose name holds one of these")
    parser.add_argument("--missing", action="store_true", help="only what the file does not have")
    parser.add_argument(
        "--print", action="store_true", help="write nothing; exit code 1 if numbers moved"
    )
    parser.add_argument(
        "--data-home",
        default=os.environ.get("SKLEARN_RAACMM_DATA"),
        help="folder of real data (default: that of SKLEARN_RAACMM_DATA, or scikit-learn's)",
    )
    parser.add_argument(
        "--urdf",
        help="calibrated_urdf/panda_3/panda_calibrated.urdf of the data's authors, commit ce8a5c0",
    )
    parser.add_argument(
        "--jobs", type=int, default=1, help="processes (default: 1; costs are of CPU time)"
    )
    return parser.parse_args(argv)


def measure(args, results, save):
    """Measure what was asked for; write it into `results`, and save after each data set."""
    stamp = {"date": datetime.date.today().isoformat(), "version": __version__}

    def wanted(name, words):
        return not words or any(word in name for word in words)

    comparisons = results.setdefault("comparisons", {})
    for title, make, how, names in data_sets(args.all, args.data_home):
        there = comparisons.get(title, {}).get("models", {}) if args.missing else {}
        names = [name for name in names if ": ".join(name) not in there]
        names = [name for name in names if wanted(": ".join(name), args.models)]
        if not (wanted(title, args.only) and names):
            continue
        problem = make(*how)
        print(f"\n{title}\n")
        records = _data_sets.compare(problem, names, args.jobs)
        judged = problem.folds[: len(problem.folds) - problem.gauge]
        entry = comparisons.setdefault(title, {"models": {}})
        entry |= {"rows": sum(len(fold.test) for fold in judged), "folds": len(judged)}
        for record in records:
            name = f"{record['inputs']}: {record['regressor']}"
            entry["models"][name] = rounded(record) | {"made": stamp}
        save()
    for name in PARTS:
        there = args.missing and name in results.setdefault("parts", {})
        if (args.all or args.only) and wanted(name, args.only) and not there and not args.models:
            results.setdefault("parts", {})[name] = {"tables": tables_of(name), "made": stamp}
            save()
    asked = wanted("few poses", args.only) and wanted("ArmResidualRegressor", args.models)
    if asked and not (args.missing and "few_poses" in results):
        results["few_poses"] = few_poses(args.data_home) | {"made": stamp}
        save()
    if args.urdf:
        results["authors"] = authors_calibration(args.data_home, args.urdf) | {"made": stamp}
        save()


def main(argv=None):
    """Run the job; return 1 where nothing was to be written and a number has moved."""
    args = parsed(argv)
    old = json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
    new = json.loads(json.dumps(old))

    def save():
        if not args.print:
            FILE.write_text(json.dumps(new, indent=1, sort_keys=True) + "\n", encoding="utf-8")

    try:
        measure(args, new, save)
    finally:  # also for whoever stops the job
        lines = list(moved(old, new))
        print(f"\n{len(lines)} numbers have moved by more than {MOVED:.0%} or are new:")
        print(*lines, sep="\n")
        if not args.print:
            write_readme()
    return int(args.print and bool(lines))


if __name__ == "__main__":
    sys.exit(main())
