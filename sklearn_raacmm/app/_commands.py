"""What the command `raacmm` does, one function for each of its words."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import shlex
import warnings
import webbrowser
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sklearn_raacmm.app._correct import corrected_file
from sklearn_raacmm.app._files import (
    WRITTEN,
    correction_files,
    find_cause_columns,
    find_rows,
    find_unnamed_probe,
    in_rad,
    known_features,
    known_lengths,
    load_arm,
    load_correction,
    parse_numbers,
    print_notes,
    read_causes,
    read_labels,
)
from sklearn_raacmm.app._life import save_step, step_of
from sklearn_raacmm.app._options import make_parser
from sklearn_raacmm.app._report import draw_svg, draw_volume, list_outliers, render, write_report
from sklearn_raacmm.app._sources import TableError, check_installed
from sklearn_raacmm.app._tables import named_first
from sklearn_raacmm.app._terminal import (
    Progress,
    expected_seconds,
    in_words,
    print_scores,
    print_verdict,
    say,
)
from sklearn_raacmm.arm import without_first
from sklearn_raacmm.correction import learn_correction, plan_poses, search_table
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.export import describe, export_c, to_onnx
from sklearn_raacmm.measurements import STILL_MM
from sklearn_raacmm.utils import (
    Finding,
    FindingError,
    FindingWarning,
    check_places,
    ignored_findings,
    natural_order,
    numbered_rows,
    write_whole,
)

# Exit codes; 1 is Python's own, for a fault of this program, and 2 is bad input.
OK, NO_HELP = 0, 3
# Angle in rad by which an arm has to move; learning has the same.
_STILL = 1e-3
# Bars that a plan takes by itself, and their largest share of the reach.
_BARS_MM, _BAR_OF_REACH = (100, 300, 500, 1000), 0.4
_DEMO_COLUMNS = [f"q{i} [deg]" for i in range(1, 7)]


def _without_still_slides(options, arm, layout, table):
    """Arm, layout and table without rails under the arm that stand still in all rows."""
    while arm.joint_types.startswith("P") and len(arm.joint_types.strip("P")) > 1:
        at = table.angles[:, 0]
        if np.ptp(at) > STILL_MM or any(1 in (i, j) for i, j, _ in arm.couplings):
            break
        name = layout.header[layout.angle_columns[0]]
        text = f"{name}, along which joint 1 slides, stands still at {at[0]:.6g} mm in all rows:"
        text = f"{text} this is learnt of the arm behind that joint, in the base that it carries."
        Finding("slide-still", text, joints=(1,)).report()
        arm = without_first(arm)
        if options.angles:
            options.angles = options.angles[1:]
        layout = find_rows(options, arm, needed=False)
        table = layout.read()
    return arm, layout, table


def learn(options):
    """Calibrate, learn, judge, and write everything into a folder."""
    # What can be refused is refused before minutes of learning.
    if options.folds is not None and options.folds < 2:
        raise TableError(f"--folds must be 2 or more, got {options.folds}.")
    check_installed("jinja2", "matplotlib", "skops")
    out, read = Path(options.out), (options.table, options.arm, options.lengths, options.places)
    if not options.dry_run:
        check_places([out / name for name in WRITTEN], filter(None, read))
    if not options.dry_run and (out / "correction.json").exists() and not options.force:
        raise TableError(f"{out} holds a correction; --force replaces it.")
    arm = load_arm(options.arm, options.base, options.tip)
    layout = find_rows(options, arm, needed=False)
    table = layout.read()
    arm, layout, table = _without_still_slides(options, arm, layout, table)
    print_notes(table.notes)
    if layout.source.what.startswith("Fanuc") and not arm.couplings:
        arm = arm.replace(couplings=[(3, 2, 1)])
        print_notes(["A Fanuc shows joint 3 from the horizontal: its own angle is J3 + J2."])
    if options.dry_run:
        return OK, describe_plan(table, layout, arm, options)
    measured = table.angles, table.positions, table.points, known_lengths(options)
    like = [load_correction(folder).model for folder in options.like or ()]
    # Findings stand in the result, and are printed with it.
    seconds = expected_seconds(len(table.angles))
    show = nullcontext() if options.quiet else Progress(seconds)
    with numbered_rows(table.rows), warnings.catch_warnings(), show as progress:
        warnings.simplefilter("ignore", FindingWarning)
        try:
            result: Any = learn_correction(
                arm,
                *measured,
                angle_unit=table.angle_unit,
                cv=options.folds,
                n_jobs=options.jobs,
                progress=progress,
                extra=read_causes(table, find_cause_columns(options)),
                like=like,
                tools=read_labels(table, options, "tool"),
                points_sd=options.points_sd,
                blocks=read_labels(table, options, "block"),
                stations=read_labels(table, options, "station"),
                accept=options.accept or (),
                take=options.take or (),
                features=known_features(options, table),
                tip_diameter=options.tip_diameter,
            )
        except FindingError as error:
            if error.finding.code == "another-table" and table.points is not None:
                _say_which_axis(arm, layout)
            raise
    if table.positions is None:  # the places that were found and accepted, if no tracker's points
        table = replace(table, positions=result.calibration.groups)
    named = ("serial number", options.serial), ("operator", options.operator)
    facts = {"file": Path(options.table).name} | {name: text for name, text in named if text}
    # Everything is made before the first file gets its name; findings stand in the result.
    with ignored_findings():
        report = write_report(result, facts=facts, row_numbers=table.rows)
        contents = corrected_file(layout, result, options)
        card = describe(result.model, result.inputs(result.angles), groups=result.positions)
    today = replace(table, angles=in_rad(table))
    before, after = (result.scores.summary[when][0] for when in ("before", "after"))
    step = step_of("learn", today, facts, result.scores.measure, before, after)
    step |= {"probe_mm": result.arm.probe.tolist()}
    taught = replace(result, facts=result.facts | {"training": card["training"]})
    # The verdict first: it is the answer, and what follows says why.
    print_verdict(result.verdict, result.helps)
    print_scores(result.scores, _what_was_left_out(table, options))
    for row, label, distance in list_outliers(result, table.rows)[:10]:
        print(f"  outlier: row {row} ({label}), {distance:.3g} mm")
    save_step(taught, out, step, today, report, contents)
    say(f"Written to {out}: {', '.join(WRITTEN)}")
    if options.open:
        webbrowser.open((out / "report.html").resolve().as_uri())
    useful = result.helps or result.scores.calibration_helps
    return OK if useful else NO_HELP, result.facts


def _say_which_axis(arm, layout):
    """Refuse points whose base an external axis moves, if that explains them."""
    layout.others = layout.external
    table = layout.read()
    if not table.others:
        return
    where = {"points": table.points, "angle_unit": table.angle_unit, "others": table.others}
    change = search_table(arm, table.angles, table.positions, **where)
    if change:
        raise TableError(f"the points are not those of the arm alone. {change}")


def export(options):
    """Write a saved correction as C, with a program that tests it, or as ONNX."""
    if not (options.c or options.onnx):
        raise TableError("say what to write: --c FOLDER, --onnx FILE or both.")
    if not (options.name.isidentifier() and options.name.isascii()):
        raise TableError(
            f"--name is the name of functions in C: letters, digits and '_', not {options.name!r}."
        )
    folder = Path(options.c or ".")
    source = folder / f"{options.name}.c"
    sources = [source, source.with_suffix(".h")] if options.c else []
    check_places(filter(None, (*sources, options.onnx)), correction_files(options.model))
    saved = load_correction(options.model)
    print_notes([saved.verdict] * (not saved.helps))
    if unnamed := find_unnamed_probe(saved):
        print_notes([f"{unnamed}: what is written is for this one."])
    paths, fade = [], False if options.fade == "no" else options.fade
    if options.c:
        folder.mkdir(parents=True, exist_ok=True)
        card = describe(saved.model)
        names = ("noise_mm", "std_factor", "scale_sd")
        card["standard_deviation"] = {name: saved.facts[name] for name in names}
        kinds: Any = {"std": options.std, "fade": fade}
        paths += export_c(saved.model, source, card=card, poses="random", **kinds)
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
    if options.limits:
        given = parse_numbers(
            "--limits", options.limits, 2 * arm.n_joints, "LOW,HIGH of each joint"
        )
        factor = arm.by_type(np.pi / 180)[:, None]
        arm = arm.replace(limits=factor * np.reshape(given, (-1, 2)))
    if arm.limits is None:
        print_notes(["The arm's file has no limits of the joints: --limits gives them in degrees."])
    bar = options.bar
    if bar is None:  # the longest usual one that fits
        bar = max((mm for mm in _BARS_MM if mm <= _BAR_OF_REACH * arm.reach_mm), default=0)
    sheet = plan_poses(arm, options.cones, options.poses, lean_deg=options.lean, bar_mm=bar or None)
    out.mkdir(parents=True, exist_ok=True)
    seats = dict(zip(sheet.bar, ("bar left", "bar right"), strict=False))
    cones = [seats.get(i, f"cone {i}") for i in range(1, options.cones + 1)]
    units = ["mm" if kind == "P" else "deg" for kind in arm.joint_types]
    names = [f"q{i} [{unit}]" for i, unit in enumerate(units, start=1)]
    degrees = arm.in_unit(sheet.angles, "deg").tolist()
    poses = [(cones[i - 1], row) for i, row in zip(sheet.groups, degrees, strict=True)]
    lines = [",".join(["cone", *names])]
    lines += [",".join([cone, *(f"{value:.2f}" for value in row)]) for cone, row in poses]
    figure = draw_svg("plan", draw_volume, arm, sheet.angles, sheet.positions)
    shown = {"cones": list(zip(cones, sheet.positions, strict=True)), "names": names}
    page = render("_plan.html", arm=arm, bar=bar, figure=figure, plan=sheet, poses=poses, **shown)
    write_whole({out / "plan.csv": "\n".join(lines) + "\n", out / "plan.html": page})
    size = f"{options.cones} cones, {options.poses} poses in each"
    print(f"{size}: about {sheet.minutes:.0f} minutes.")
    print("What matters is that the cones are spread over the places where you will measure.")
    if bar:
        print(f"Two of the cones are the seats of a bar of {bar:g} mm, which sets the scale.")
    print(f"Written to {out}: plan.html, plan.csv")
    facts = {"minutes": sheet.minutes, "positions_mm": sheet.positions.tolist()}
    return OK, facts | {"bar": [cones[i - 1] for i in sheet.bar], "bar_mm": bar}


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


def _what_was_left_out(table, options):
    """Word for what is left out together."""
    if options.block:
        return "blocks"
    if options.feature or options.kind:
        return "features"
    return "regions" if table.points is not None and table.positions is None else "positions"


def describe_plan(table, layout, arm, options):
    """Print what was read and what would be done with it; the same as facts."""
    n, unit = table.angles.shape[0], table.angle_unit
    say(f"Rows: {n}, of {layout.path}.")
    names = [layout.header[i] for i in layout.angle_columns]
    lows, highs = table.angles.min(axis=0), table.angles.max(axis=0)
    width = max(map(len, names))
    for i, (name, low, high) in enumerate(zip(names, lows, highs, strict=True), 1):
        print(f"  joint {i}: {name[:40]:{min(width, 40)}s} {low:10.3f} to {high:10.3f} {unit}")
    if np.ptp(in_rad(table), axis=0).max() < _STILL:
        raise TableError(f"the arm did not move: {n} rows are 1 pose. Measure other poses, too.")
    facts = {"rows": n, "angle_unit": unit, "angles": names, "causes": list(table.others)}
    if table.points is not None:
        spread = np.ptp(table.points, axis=0)
        size = " x ".join(f"{length:.0f}" for length in spread)
        say(f"Points of a tracker: {n}, in a box of {size} mm.")
        facts["points_box_mm"] = spread.tolist()
    if table.positions is not None:
        labels, counts = np.unique(table.positions, return_counts=True)
        rows = f"{counts.min()} to {counts.max()}" if np.ptp(counts) else f"{counts[0]}"
        labels = labels[natural_order(labels)].tolist()
        say(named_first(f"Positions: {len(labels)}, with {rows} rows each", labels))
        facts["positions"] = labels
    elif table.points is None:
        say("Positions: no column names them; learning finds the rows that share a place.")
    if lengths := known_lengths(options):
        say(f"Known lengths: {len(lengths)}.")
    elif table.points is None and not any(one[2:] for one in known_features(options, table)):
        say("Known lengths: none, so the scale of the arm is that of its table (--length).")
    say(named_first("Causes", list(table.others)) or "Causes: none (--extra names columns).")
    say(f"Arm: {arm.n_joints} joints, reach {arm.reach_mm:.0f} mm, {arm.convention} convention.")
    folds = options.folds or 5
    say(
        f"To be judged: calibration and correction, {folds} times, each time without some of the "
        f"{_what_was_left_out(table, options)}."
    )
    seconds = expected_seconds(n)
    say(f"That takes about {in_words(seconds)} here. Nothing was written.")
    return facts | {"folds": folds, "expected_seconds": seconds}
