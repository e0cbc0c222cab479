"""What the command `raacmm` does, one function for each of its words."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import importlib.util
import io
import json
import sys
import webbrowser
from contextlib import nullcontext
from pathlib import Path

import numpy as np
from scipy import stats

from sklearn_raacmm.app._arm_dialogue import ask_for_an_arm
from sklearn_raacmm.app._causes import causes_of, columns_of_causes, inputs_of
from sklearn_raacmm.app._cells import TableError
from sklearn_raacmm.app._dh import read_dh, write_template
from sklearn_raacmm.app._figures import picture_of
from sklearn_raacmm.app._files import (
    files_of,
    in_rad,
    load_arm,
    load_correction,
    number_of,
    open_beside,
    table_options,
    write_corrected,
)
from sklearn_raacmm.app._lengths import length_of, read_places
from sklearn_raacmm.app._life import check_by_causes, say_check
from sklearn_raacmm.app._report import judge_limit, report_text
from sklearn_raacmm.app._tables import find_layout, read_lengths, read_table
from sklearn_raacmm.arm import Arm
from sklearn_raacmm.correction import check_correction, learn_correction
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.error_model import ArmResidualRegressor
from sklearn_raacmm.export import describe, export_c, to_onnx
from sklearn_raacmm.metrics import single_point_repeatability
from sklearn_raacmm.residuals import position_residuals
from sklearn_raacmm.utils import check_places, natural_order, write_whole

# Exit codes; 1 is Python's own, for a fault of this program, and 2 is bad input.
OK, NO_HELP, NOT_JUDGED = 0, 3, 4
# Chance that a check finds a fault in a correction that is right, by any of its tests.
_FALSE_ALARM = 0.01
# What `learn` writes, as its last line names it; the endings of files that no CSV may have.
_WRITTEN = (
    "report.html", "model.skops", "arm.json", "correction.json", "card.md", "corrected.csv",
)  # fmt: skip
_NO_CSV = (".xlsx", ".xlsm", ".xls", ".ods", ".parquet", ".json", ".jsonl")


def learn(options):
    """Calibrate, learn, judge, and write everything into a folder."""
    if options.folds is not None and options.folds < 2:
        raise TableError(f"--folds must be 2 or more, got {options.folds}.")
    missing = [name for name in ("jinja2", "matplotlib", "skops") if not _is_there(name)]
    if missing:  # said now, not after minutes of learning
        raise TableError(
            f"{' and '.join(missing)} must be installed for the report and the model's file: "
            f"pip install {' '.join(missing)}."
        )
    out = Path(options.out)
    check_places(
        [out / name for name in _WRITTEN],
        filter(None, (options.table, options.arm, options.lengths)),
    )
    if (out / "correction.json").exists() and not options.force:
        raise TableError(f"{out} holds a correction; --force replaces it.")
    arm = load_arm(options.arm, options.base, options.tip)
    table = read_table(
        options.table, arm.n_joints, **table_options(options, arm, points=options.points)
    )
    _say_notes(table.notes)
    lengths = [length_of(text) for text in options.length or ()]
    lengths += read_places(options.places, options.length_sd) if options.places else []
    lengths += read_lengths(options.lengths, options.length_sd) if options.lengths else []
    like = [load_correction(folder).model for folder in options.like or ()]
    facts = {"file": Path(options.table).name}
    for name, value in (("serial number", options.serial), ("operator", options.operator)):
        if value:
            facts[name] = value
    return _learn(options, arm, table, lengths, facts, like)


def _is_there(name):
    try:
        return importlib.util.find_spec(name) is not None
    except ValueError:  # marked as not to be imported
        return False


def _learn(options, arm, table, lengths, facts, like):
    if options.limit_2s is not None and table.points is not None:
        raise TableError("--limit-2s is for single-point tests, not for a tracker's points.")
    if options.limit_2s is not None and not 0 < options.limit_2s < np.inf:
        raise TableError(f"--limit-2s must be a positive number in mm, got {options.limit_2s}.")
    _progress(-1, 1, "calibration")
    result = learn_correction(
        arm, in_rad(table), table.positions, table.points, lengths,
        cv=options.folds, n_jobs=options.jobs, progress=_progress,
        extra=causes_of(table, columns_of_causes(options)), in_order=options.in_order, like=like,
    )  # fmt: skip
    _progress(30, 30, "report")
    layout = find_layout(options.table, arm.n_joints, **table_options(options, arm, labelled=False))
    corrected = io.StringIO(newline="")
    in_order = any(name.startswith("direction") for name in result.causes)
    inputs = inputs_of(result.saved, columns_of_causes(options), in_order)
    write_corrected(layout, result.saved, inputs, corrected)
    card = describe(result.model, result.saved.inputs(result.angles))
    if result.findings:
        card["findings"] = [f"{finding.weight}: {finding}" for finding in result.findings]
    # Everything is made before the first file gets its name.
    result.save(
        options.out,
        {
            "report.html": report_text(
                result, limit_2s=options.limit_2s, facts=facts, row_numbers=table.rows
            ),
            "card.md": f"{card}\n## Verdict\n\n- {result.verdict}\n",
            "corrected.csv": corrected.getvalue().encode(layout.dialect.encoding),
        },
    )
    if sys.stderr.isatty():
        print(file=sys.stderr)
    # The verdict stands at the end, where it is seen without scrolling.
    print(str(result.scores).removeprefix(f"{result.verdict}\n"))
    rows = table.rows[result.outliers["row"]].tolist()
    for row, (_, label, distance) in zip(rows[:10], result.outliers.tolist(), strict=False):
        print(f"  outlier: row {row} ({label}), {distance:.3g} mm")
    print()
    print(result.verdict)
    if options.limit_2s is not None:
        print(": ".join(judge_limit(result.scores, options.limit_2s)))
    print(f"Written to {options.out}: {', '.join(_WRITTEN)}")
    if options.open:
        webbrowser.open((Path(options.out) / "report.html").resolve().as_uri())
    code = OK if result.helps else NO_HELP if result.scores.judged else NOT_JUDGED
    return code, result.facts()


def correct(options):
    """Correct a table of any length."""
    if options.out != "-":
        if Path(options.out).suffix.lower() in _NO_CSV:
            raise TableError(f"--out is written as CSV, and {options.out} says something else.")
        check_places([options.out], [options.table, *files_of(options.model)])
    saved = load_correction(options.model)
    _warn_if_it_does_not_help(saved)
    layout = find_layout(
        options.table, saved.arm.n_joints, **table_options(options, saved.arm, labelled=False)
    )
    _say_notes(layout.notes)
    stream = (
        nullcontext(options.stdout)
        if options.out == "-"
        else open_beside(options.out, layout.dialect.encoding)
    )
    inputs = inputs_of(saved, columns_of_causes(options), options.in_order)
    with stream as file:
        n_rows = write_corrected(layout, saved, inputs, file)
    print(f"{n_rows} rows corrected, written to {options.out}")
    return OK, {"rows": n_rows}


def check(options):
    """Compare today's single-point test with what was promised at positions left out."""
    inputs = [options.table, *files_of(options.model)]
    check_places(filter(None, (options.record, options.chart)), inputs)
    saved = load_correction(options.model)
    if options.points or options.lengths or saved.facts["measure"] != "2S":
        return check_by_causes(saved, options)
    table = read_table(options.table, saved.arm.n_joints, **table_options(options, saved.arm))
    _say_notes(table.notes)
    angles = in_rad(table)
    measured, corrected = saved.arm.forward(angles), saved.correct(angles)[0]
    before, after = (
        single_point_repeatability(points, table.positions, aggregate=None)
        for points in (measured, corrected)
    )
    labels = np.unique(table.positions)
    for i in natural_order(labels):
        print(f"{labels[i]}: 2S {before[i]:.4f} -> {after[i]:.4f} mm")
    has_causes = _has_causes(saved.model, options)
    rate = _FALSE_ALARM / (1 + has_causes)
    changed = has_causes and _name_the_suspect(saved, measured, table, options, rate)
    expected = highest_mean(saved.facts["positions"]["after"], len(after), rate)
    change = f"mean 2S {before.mean():.3f} -> {after.mean():.3f} mm"
    facts = {
        "before_mm": float(before.mean()), "after_mm": float(after.mean()),
        "expected_below_mm": expected, "holds": after.mean() < before.mean(), "changed": changed,
    }  # fmt: skip
    if after.mean() >= before.mean():
        print(f"It does not hold: {change}. Calibrate and learn again.")
        return NO_HELP, facts
    if after.mean() > expected:
        print(
            f"It helps less than it did: {change}; the mean of {len(after)} positions like those "
            f"that it was judged at would be below {expected:.3f} mm in {1 / rate - 1:.0f} of "
            f"{1 / rate:.0f} tests. Look at probe and base, or learn again."
        )
        return NO_HELP, facts
    verdict = "It still helps, but something has changed" if changed else "It holds"
    print(f"{verdict}: {change}; expected below {expected:.3f} mm.")
    return NO_HELP if changed else OK, facts


def _has_causes(model, options):
    """Whether the correction uses a model of causes, which the options may need."""
    has_causes = isinstance(model, ArmResidualRegressor) and model.helps_
    if not has_causes and (options.record or options.chart):
        raise TableError(
            "--record and --chart need a model of causes; this correction has none in use."
        )
    return has_causes


def _name_the_suspect(saved, measured, table, options, rate):
    """Say what the model's posterior makes of today's poses, keep the record; whether one is."""
    angles, positions = saved.inputs(in_rad(table)), table.positions
    found = check_correction(
        saved.model, angles, position_residuals(measured, positions), groups=positions,
        false_alarm_rate=rate,
    )  # fmt: skip
    rows = [f"{table.rows[row]} ({positions[row]})" for row in range(len(positions))]
    say_check(found, options, rows)
    return not found.holds


def highest_mean(learnt, n, rate):
    """Mean that n new positions exceed at a given rate, if they are like those learnt.

    Parameters
    ----------
    learnt : array-like of shape (n_positions,)
        2S of the positions left out, mm.
    n : int
    rate : float
        One for once in a hundred tests is 0.01.

    Returns
    -------
    float
        In mm: the one-sided prediction limit of a mean of normal values.
    """
    learnt = np.asarray(learnt)
    quantile = stats.t.ppf(1 - rate, len(learnt) - 1)
    spread = learnt.std(ddof=1) * np.sqrt(1 / n + 1 / len(learnt))
    return float(learnt.mean() + quantile * spread)


def export(options):
    """Write a saved correction as C, with a project that tests it, or as ONNX."""
    if not (options.c or options.onnx):
        raise TableError("say what to write: --c FOLDER, --onnx FILE or both.")
    folder = Path(options.c or ".")
    sources = [folder / f"{options.name}{end}" for end in (".c", ".h")] if options.c else []
    check_places(filter(None, (*sources, options.onnx)), files_of(options.model))
    saved = load_correction(options.model)
    _warn_if_it_does_not_help(saved)
    paths = []
    if options.c:
        folder.mkdir(parents=True, exist_ok=True)
        source = folder / f"{options.name}.c"
        card = describe(saved.model)
        names = ("noise_mm", "std_factor", "scale_sd")
        card["standard_deviation"] = {name: saved.facts[name] for name in names}
        paths += export_c(
            saved.model, source, std=options.std, card=card, poses="random",
            any_probe=options.any_probe,
        )  # fmt: skip
    if options.onnx:
        to_onnx(saved.model, options.onnx)
        paths.append(options.onnx)
    print("Written:", *paths)
    return OK, {"files": [str(path) for path in paths]}


def arm(options):
    """Show an arm, and write its file."""
    given = [options.source, options.dh, options.lengths_222, options.lengths_223]
    if sum(one is not None for one in given) > 1:
        raise TableError("give one arm: a file or name, --dh, --lengths-222 or --lengths-223.")
    if (options.elbow_offset or options.wrist_offset) and not any(given[2:]):
        raise TableError("--elbow-offset and --wrist-offset belong to --lengths-222 or -223.")
    if (options.modified or options.probe) and not options.dh:
        raise TableError("--modified and --probe belong to --dh.")
    if options.into and not options.out:
        raise TableError("--into needs --out, the file to write; it may be the same file.")
    places = [options.out, options.picture, options.template]
    check_places(
        [place for place in places if place and place != "-"],
        [one for one in (options.source, options.dh) if one],
    )
    if options.template:
        write_template(options.template)
        print(f"Written to {options.template}")
        if not any(given):
            return OK
    shown = _meant_arm(options)
    print(shown)
    if options.out:
        ends = {"base": options.base, "tip": options.tip}
        text = shown.update_urdf(options.into, **ends) if options.into else shown.to_json()
        if options.out == "-":
            options.stdout.write(text)
        else:
            write_whole({options.out: text})
            print(f"Written to {options.out}")
    if options.picture:
        write_whole({options.picture: picture_of(shown)})
        print(f"Written to {options.picture}")
    return OK, json.loads(shown.to_json())


def _meant_arm(options):
    """The arm of a file, a table, a name or lengths; without any, of the answers of the user."""
    if options.lengths_222 or options.lengths_223:
        layout = "2-2-2" if options.lengths_222 else "2-2-3"
        lengths = options.lengths_222 or options.lengths_223
        offsets = {"elbow_offset": options.elbow_offset, "wrist_offset": options.wrist_offset}
        return Arm.from_lengths(layout, *lengths, **offsets)
    if options.dh:
        probe = [number_of(text) for text in (options.probe or "0,0,0").split(",")]
        return read_dh(options.dh, "modified" if options.modified else "standard", probe)
    if options.source and options.into:
        return load_arm(options.source)  # --base and --tip are those of the other file
    if options.source:
        return load_arm(options.source, options.base, options.tip)
    if not sys.stdin.isatty():
        raise TableError("give an arm: a file, a URDF, the name of a built-in one, or lengths.")
    return ask_for_an_arm()


def demo(options):
    """Run the main job on a simulated arm, from the table on."""
    out = Path(options.out)
    out.mkdir(parents=True, exist_ok=True)
    test = make_single_point(n_positions=10, n_poses=25, bars=[500], random_state=0)
    ((first, second, length, sd),) = test.lengths
    names = [f"cone {i + 1}" for i in range(first)] + ["bar, left", "bar, right"]
    lines = ["simulated arm;no real measurement", "position;" + ";".join(
        f"q{i} [deg]" for i in range(1, 7))]  # fmt: skip
    for label, angles in zip(test.groups, np.rad2deg(test.data), strict=True):
        cells = (f"{angle:.6f}".replace(".", ",") for angle in angles)
        lines.append(f"{names[label]};" + ";".join(cells))
    options.length = [f"{names[first]}:{names[second]}:{length:.3f}:{sd}"]
    options.table, options.arm = out / "cone_test.csv", out / "nominal_arm.json"
    write_whole({options.table: "\r\n".join(lines) + "\r\n"})
    test.nominal_arm.to_json(options.arm)
    print(f"A simulated single-point test: {options.table}")
    known = options.length[0]
    print(f'raacmm learn {options.table} --arm {options.arm} --length "{known}" --out {out}')
    return learn(options)


def _say_notes(notes):
    for note in notes:
        print(f"note: {note}", file=sys.stderr)


def _warn_if_it_does_not_help(saved):
    if not saved.facts["helps"]:
        print(f"note: {saved.facts['verdict']}", file=sys.stderr)


def _progress(done, total, stage=None):
    """Draw how far the whole command is; the folds come between two other stages."""
    if sys.stderr.isatty():
        bar = "#" * (30 * (done + 1) // (total + 2))
        stage = stage or ("fit of all rows" if done == total else f"fold {done + 1} of {total}")
        print(f"\r[{bar:<30}] {stage:<20}", end="", file=sys.stderr, flush=True)
