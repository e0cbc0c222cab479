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

from sklearn_raacmm.app._causes import by_causes, causes_of, columns_of_causes
from sklearn_raacmm.app._cells import TableError
from sklearn_raacmm.app._figures import chart_of, picture_of
from sklearn_raacmm.app._files import (
    files_of,
    in_rad,
    load_arm,
    load_correction,
    open_beside,
    write_corrected,
)
from sklearn_raacmm.app._report import judge_limit, report_text
from sklearn_raacmm.app._tables import find_layout, read_lengths, read_table
from sklearn_raacmm.arm import Arm
from sklearn_raacmm.correction import (
    check_correction,
    learn_correction,
    read_check_records,
    with_causes,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.error_model import ArmResidualRegressor
from sklearn_raacmm.export import describe, export_c, to_onnx
from sklearn_raacmm.metrics import single_point_repeatability
from sklearn_raacmm.residuals import position_residuals
from sklearn_raacmm.utils import check_places, write_whole

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
    table = read_table(options.table, arm.n_joints, **_columns(options, arm, points=options.points))
    _say_notes(table.notes)
    like = [load_correction(folder).model for folder in options.like or ()]
    lengths = read_lengths(options.lengths, options.length_sd) if options.lengths else ()
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
    layout = find_layout(options.table, arm.n_joints, **_columns(options, arm, labelled=False))
    corrected = io.StringIO(newline="")
    columns = {k: v for k, v in columns_of_causes(options).items() if k in result.causes}
    in_order = any(name.startswith("direction") for name in result.causes)
    write_corrected(layout, by_causes(result.correct, columns, in_order), corrected)
    card = describe(result.model, with_causes(result.angles, result.causes))
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
        options.table, saved.arm.n_joints, **_columns(options, saved.arm, labelled=False)
    )
    _say_notes(layout.notes)
    stream = (
        nullcontext(options.stdout)
        if options.out == "-"
        else open_beside(options.out, layout.dialect.encoding)
    )
    rule = by_causes(saved.correct, columns_of_causes(options), options.in_order)
    with stream as file:
        n_rows = write_corrected(layout, lambda *rows: rule(*rows)[1:], file)
    print(f"{n_rows} rows corrected, written to {options.out}")
    return OK, {"rows": n_rows}


def check(options):
    """Compare today's single-point test with what was promised at positions left out."""
    inputs = [options.table, *files_of(options.model)]
    check_places(filter(None, (options.record, options.chart)), inputs)
    saved = load_correction(options.model)
    if saved.facts["measure"] != "2S":
        raise TableError("check needs a correction that was learnt from a single-point test.")
    table = read_table(options.table, saved.arm.n_joints, **_columns(options, saved.arm))
    _say_notes(table.notes)
    measured, corrected, _ = saved.correct(in_rad(table))
    before, after = (
        single_point_repeatability(points, table.positions, aggregate=None)
        for points in (measured, corrected)
    )
    for label, one, other in zip(np.unique(table.positions), before, after, strict=True):
        print(f"{label}: 2S {one:.4f} -> {other:.4f} mm")
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
    if not found.holds:
        print(f"Suspect: {found.suspect} (p = {found.p_value:.2g}). {found.advice}")
    for row in found.slipped:
        print(f"slipped: row {table.rows[row]} ({positions[row]}), measure it again")
    if options.record:
        found.append_to(options.record)
        print(f"Appended to {options.record}")
    if options.chart:
        records = read_check_records(options.record) if options.record else [found.record]
        write_whole({options.chart: chart_of(records)})
        print(f"Written to {options.chart}")
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
        paths += export_c(saved.model, source, std=options.std, poses="random")
    if options.onnx:
        to_onnx(saved.model, options.onnx)
        paths.append(options.onnx)
    print("Written:", *paths)
    return OK, {"files": [str(path) for path in paths]}


def arm(options):
    """Show an arm, and write its file."""
    places = [place for place in (options.out, options.picture) if place and place != "-"]
    check_places(places, [options.source] if options.source else [])
    if (options.elbow_offset or options.wrist_offset) and not (
        options.lengths_222 or options.lengths_223
    ):
        raise TableError("--elbow-offset and --wrist-offset belong to --lengths-222 or -223.")
    if options.lengths_222 or options.lengths_223:
        layout = "2-2-2" if options.lengths_222 else "2-2-3"
        lengths = options.lengths_222 or options.lengths_223
        offsets = {"elbow_offset": options.elbow_offset, "wrist_offset": options.wrist_offset}
        shown = Arm.from_lengths(layout, *lengths, **offsets)
    elif options.source:
        shown = load_arm(options.source, options.base, options.tip)
    else:
        shown = _ask_for_an_arm()
    print(shown)
    if options.out == "-":
        options.stdout.write(shown.to_json())
    elif options.out:
        shown.to_json(options.out)
        print(f"Written to {options.out}")
    if options.picture:
        write_whole({options.picture: picture_of(shown)})
        print(f"Written to {options.picture}")
    return OK, json.loads(shown.to_json())


def _ask_for_an_arm():
    if not sys.stdin.isatty():
        raise TableError("give an arm: a file, a URDF, the name of a built-in one, or lengths.")
    print("Lengths in mm, as in the drawing of the arms page of the documentation.")
    layout = input("Layout, 2-2-2 or 2-2-3: ").strip()
    names = ("height of the shoulder", "shoulder to elbow", "elbow to wrist", "wrist to probe")
    return Arm.from_lengths(layout, *(_number(input(f"{name}: ")) for name in names))


def _number(text):
    try:
        return float(text.replace(",", "."))
    except ValueError:
        raise TableError(f"{text!r} is not a number.") from None


def demo(options):
    """Run the main job on a simulated arm, from the table on."""
    out = Path(options.out)
    out.mkdir(parents=True, exist_ok=True)
    test = make_single_point(n_positions=10, n_poses=25, random_state=0)
    lines = ["simulated arm;no real measurement", "position;" + ";".join(
        f"q{i} [deg]" for i in range(1, 7))]  # fmt: skip
    for label, angles in zip(test.groups, np.rad2deg(test.data), strict=True):
        cells = (f"{angle:.6f}".replace(".", ",") for angle in angles)
        lines.append(f"cone {label + 1};" + ";".join(cells))
    options.table, options.arm = out / "cone_test.csv", out / "nominal_arm.json"
    write_whole({options.table: "\r\n".join(lines) + "\r\n"})
    test.nominal_arm.to_json(options.arm)
    print(f"A simulated single-point test: {options.table}")
    print(f"raacmm learn {options.table} --arm {options.arm} --out {out}")
    return learn(options)


def _columns(options, arm, points=None, labelled=True):
    """Options of `read_table` as the command line has them."""
    if points and not Path(points).is_file():
        points = points.split(",")
        if len(points) != 3:
            raise TableError(
                f"--points needs three columns, such as x,y,z, or a file that is there, got "
                f"{options.points!r}."
            )
    counts = options.counts_per_turn
    if counts is not None:
        counts = [_number(text) for text in counts.split(",")]
        counts = counts[0] if len(counts) == 1 else counts
    return {
        "angles": options.angles.split(",") if options.angles else None,
        "points": points,
        "position": options.position if labelled else None,
        "angle_unit": options.unit,
        "labelled": labelled,
        "joint_names": arm.names,
        "counts_per_turn": counts,
        "sheet": options.sheet,
        "others": columns_of_causes(options).values(),
    }


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
