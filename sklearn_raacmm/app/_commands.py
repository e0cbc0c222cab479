"""What the command `raacmm` does, one function for each of its words."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import shlex
import sys
import warnings
import webbrowser
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sklearn_raacmm.app._arms import take
from sklearn_raacmm.app._files import (
    WRITTEN,
    corrected_file,
    correction_files,
    find_cause_columns,
    find_rows,
    find_unnamed_probe,
    in_rad,
    known_lengths,
    load_arm,
    load_correction,
    open_beside,
    print_notes,
    read_causes,
    read_labels,
    write_corrected,
)
from sklearn_raacmm.app._life import save_step, step_of
from sklearn_raacmm.app._options import make_parser
from sklearn_raacmm.app._report import draw_svg, draw_volume, list_outliers, render, write_report
from sklearn_raacmm.app._sources import TableError, check_installed
from sklearn_raacmm.arm import check_angles
from sklearn_raacmm.correction import learn_correction, plan_poses
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.export import describe, export_c, to_onnx
from sklearn_raacmm.utils import FindingWarning, check_places, numbered_rows, write_whole

# Exit codes; 1 is Python's own, for a fault of this program, and 2 is bad input.
OK, NO_HELP = 0, 3
_DEMO_COLUMNS = [f"q{i} [deg]" for i in range(1, 7)]
# Endings of files that no CSV may have.
_NO_CSV = (".xlsx", ".xlsm", ".xls", ".ods", ".parquet", ".json", ".jsonl")


def learn(options):
    """Calibrate, learn, judge, and write everything into a folder."""
    # What can be refused is refused before minutes of learning.
    if options.folds is not None and options.folds < 2:
        raise TableError(f"--folds must be 2 or more, got {options.folds}.")
    check_installed("jinja2", "matplotlib", "skops")
    out, read = Path(options.out), (options.table, options.arm, options.lengths, options.places)
    check_places([out / name for name in WRITTEN], filter(None, read))
    if (out / "correction.json").exists() and not options.force:
        raise TableError(f"{out} holds a correction; --force replaces it.")
    arm = load_arm(options.arm, options.base, options.tip)
    for code in options.take or ():
        arm = take(arm, code)
    layout = find_rows(options, arm, needed=False)
    table = layout.read()
    print_notes(table.notes)
    measured = table.angles, table.positions, table.points, known_lengths(options)
    like = [load_correction(folder).model for folder in options.like or ()]
    # Findings stand in the result, and are printed with it.
    with numbered_rows(table.rows), warnings.catch_warnings():
        warnings.simplefilter("ignore", FindingWarning)
        result: Any = learn_correction(
            arm,
            *measured,
            angle_unit=table.angle_unit,
            cv=options.folds,
            n_jobs=options.jobs,
            progress=_progress,
            extra=read_causes(table, find_cause_columns(options)),
            like=like,
            tools=read_labels(table, options, "tool"),
            points_sd=options.points_sd,
            blocks=read_labels(table, options, "block"),
            stations=read_labels(table, options, "station"),
            accept=options.accept or (),
        )
    if table.positions is None:  # the places that were found and accepted, if no tracker's points
        table = replace(table, positions=result.calibration.groups)
    named = ("serial number", options.serial), ("operator", options.operator)
    facts = {"file": Path(options.table).name} | {name: text for name, text in named if text}
    report = write_report(result, facts=facts, row_numbers=table.rows)
    # Everything is made before the first file gets its name.
    contents = corrected_file(layout, result, options)
    today = replace(table, angles=in_rad(table))
    before, after = (result.scores.summary[when][0] for when in ("before", "after"))
    step = step_of("learn", today, facts, result.scores.measure, before, after)
    card = describe(result.model, result.inputs(result.angles), groups=result.positions)
    taught = replace(result, facts=result.facts | {"training": card["training"]})
    # Printed before what may fail; the verdict at the end, where it is seen without scrolling.
    print(str(result.scores).removeprefix(f"{result.verdict}\n"))
    for row, label, distance in list_outliers(result, table.rows)[:10]:
        print(f"  outlier: row {row} ({label}), {distance:.3g} mm")
    print(f"\n{result.verdict}")
    save_step(taught, out, step, today, report, contents)
    print(f"Written to {out}: {', '.join(WRITTEN)}")
    if options.open:
        webbrowser.open((out / "report.html").resolve().as_uri())
    return OK if result.helps else NO_HELP, result.facts


def correct(options):
    """Correct a table of any length."""
    if options.out != "-":
        if Path(options.out).suffix.lower() in _NO_CSV:
            raise TableError(f"--out is written as CSV, and {options.out} says something else.")
        check_places([options.out], [options.table, *correction_files(options.model)])
    saved = load_correction(options.model)
    print_notes([saved.verdict] * (not saved.helps))
    if unknown := find_cause_columns(options).keys() - saved.causes.keys():
        raise TableError(
            f"--extra names {', '.join(map(repr, sorted(unknown)))}, and this correction takes "
            f"{', '.join(saved.causes) or 'no cause'}: leave it away, or mend the name."
        )
    if not options.tool and (unnamed := find_unnamed_probe(saved)):
        raise TableError(f"{unnamed}: name the column of the tool of each row by --tool.")
    layout = find_rows(options, saved.arm, labelled=False)
    print_notes(layout.notes)
    to_file = open_beside(options.out, layout.source.encoding)
    with nullcontext(options.stdout) if options.out == "-" else to_file as file:
        n_rows, largest = write_corrected(layout, saved, options, file, options.std)
    check_angles(largest, saved.arm.n_joints, layout.angle_unit)
    print(f"{n_rows} rows corrected, written to {options.out}")
    return OK, {"rows": n_rows}


def export(options):
    """Write a saved correction as C, with a program that tests it, or as ONNX."""
    if not (options.c or options.onnx):
        raise TableError("say what to write: --c FOLDER, --onnx FILE or both.")
    folder = Path(options.c or ".")
    source = folder / f"{options.name}.c"
    sources = [source, source.with_suffix(".h")] if options.c else []
    check_places(filter(None, (*sources, options.onnx)), correction_files(options.model))
    saved = load_correction(options.model)
    print_notes([saved.verdict] * (not saved.helps))
    if unnamed := find_unnamed_probe(saved):
        print_notes([f"{unnamed}: what is written is for this one."])
    paths, fade = [], False if options.fade == "none" else options.fade
    if options.c:
        folder.mkdir(parents=True, exist_ok=True)
        card = describe(saved.model)
        names = ("noise_mm", "std_factor", "scale_sd")
        card["standard_deviation"] = {name: saved.facts[name] for name in names}
        paths += export_c(
            saved.model, source, std=options.std, card=card, poses="random", fade=fade
        )
        paths.append(folder / f"{options.name}_test.c")  # which comes with poses
    if options.onnx:
        to_onnx(saved.model, options.onnx, fade=fade)
        paths.append(options.onnx)
    print("Written:", *paths)
    return OK, {"files": [str(path) for path in paths]}


def plan(options):
    """Plan a first single-point test for an arm, and write the sheet of it."""
    out = Path(options.out)
    check_installed("jinja2", "matplotlib")
    check_places([out / "plan.html", out / "plan.csv"], [options.arm])
    arm = load_arm(options.arm)
    found = plan_poses(arm, options.cones, options.poses)
    out.mkdir(parents=True, exist_ok=True)
    names = [f"q{i} [deg]" for i in range(1, arm.n_joints + 1)]
    poses = list(zip(found.groups, np.rad2deg(found.angles).tolist(), strict=True))
    lines = [",".join(["cone", *names])]
    lines += [",".join([f"cone {cone}", *(f"{value:.2f}" for value in row)]) for cone, row in poses]
    figure = draw_svg("plan", draw_volume, arm, found.angles, found.positions)
    page = render("_plan.html", arm=repr(arm), figure=figure, plan=found, names=names, poses=poses)
    write_whole({out / "plan.csv": "\n".join(lines) + "\n", out / "plan.html": page})
    size = f"{options.cones} cones, {options.poses} poses in each"
    print(f"{size}: about {found.minutes:.0f} minutes.")
    print("What matters is that the cones are spread over the places where you will measure.")
    print(f"Written to {out}: plan.html, plan.csv")
    return 0, {"minutes": found.minutes, "positions_mm": found.positions.tolist()}


def demo(options):
    """Run the main job on a simulated arm, from the table on."""
    out = Path(options.out)
    out.mkdir(parents=True, exist_ok=True)
    test = make_single_point(n_positions=10, n_poses=25, bars=[500], random_state=0)
    ((first, second, length, sd),) = test.lengths
    names = [f"cone {i + 1}" for i in range(first)] + ["bar, left", "bar, right"]
    lines = ["simulated arm;no real measurement", ";".join(["position", *_DEMO_COLUMNS])]
    for label, angles in zip(test.groups, np.rad2deg(test.data), strict=True):
        lines.append(";".join([names[label], *(f"{v:.6f}".replace(".", ",") for v in angles)]))
    table, arm = out / "cone_test.csv", out / "nominal_arm.json"
    write_whole({table: "\r\n".join(lines) + "\r\n"})
    test.nominal_arm.to_json(arm)
    print(f"A simulated single-point test: {table}")
    known = f"{names[first]}:{names[second]}:{length:.3f}:{sd}"
    paths = "--arm", str(arm), "--out", str(out)
    words = ["learn", str(table), *paths, "--length", known, "--serial", "simulated"]
    print(shlex.join(["raacmm", *words]))
    # Options of the user go before these.
    vars(options).update(vars(make_parser().parse_args(words)) | vars(options))
    return learn(options)


def _progress(done, total):
    if sys.stderr.isatty():
        end = "\n" if done == total else ""
        print(f"\r{done} of {total} folds", end=end, file=sys.stderr, flush=True)
