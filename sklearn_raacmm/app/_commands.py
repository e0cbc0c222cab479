"""What the command `raacmm` does, one function for each of its words."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import shlex
import warnings
import webbrowser
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from timeit import repeat
from typing import Any

import numpy as np

from sklearn_raacmm.app._correct import corrected_file
from sklearn_raacmm.app._files import WRITTEN, check_outputs, load_arm, load_correction, print_notes
from sklearn_raacmm.app._given import Given, find_unnamed_probe, in_rad, parse_numbers
from sklearn_raacmm.app._life import save_step, step_of
from sklearn_raacmm.app._options import make_parser
from sklearn_raacmm.app._report import draw_svg, draw_volume, list_outliers, render, write_report
from sklearn_raacmm.app._sources import TableError, check_installed
from sklearn_raacmm.app._tables import named_first
from sklearn_raacmm.app._terminal import Progress, in_words, print_scores, print_verdict, say
from sklearn_raacmm.correction import learn_correction, plan_poses, refuse_one_pose, search_table
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.export import describe, export_c, to_onnx
from sklearn_raacmm.measurements import STILL_MM
from sklearn_raacmm.utils import Finding, FindingError, FindingWarning, Groups, write_whole

# Exit codes; 1 is Python's own, for a fault of this program, and 2 is bad input.
OK, NO_HELP = 0, 3
# Bars that a plan takes by itself, and their largest share of the reach.
_BARS_MM, _BAR_OF_REACH = (100, 300, 500, 1000), 0.4
# Learning, in products of two 1500 x 1500 matrices: so many for so many rows, with this exponent.
# An order of time, by what `benchmarks/bench_speed.py` says of fits; no choice of a number.
_PRODUCTS, _ROWS, _EXPONENT = 50.0, 350, 0.55


def _read(arm, options):
    """Arm, what is given of it, and its table: without rails that stand still in all rows."""
    given = Given(options, arm, needed=False)
    table = given.layout.read()
    at, is_rail = table.angles[:, 0], arm.joint_types.startswith("P")
    if not is_rail or len(arm.joint_types.strip("P")) < 2 or np.ptp(at) > STILL_MM:
        return arm, given, table
    if any(1 in (i, j) for i, j, _ in arm.couplings):
        return arm, given, table
    name = given.layout.header[given.layout.angle_columns[0]]
    text = f"{name}, along which joint 1 slides, stands still at {at[0]:.6g} mm in all rows:"
    text = f"{text} this is learnt of the arm behind that joint, in the base that it carries."
    Finding("slide-still", text, joints=(1,)).report()
    options.angles = options.angles and options.angles[1:]
    return _read(arm.without_first(), options)


def learn(options):
    """Calibrate, learn, judge, and write everything into a folder."""
    # What can be refused is refused before minutes of learning.
    if options.folds is not None and options.folds < 2:
        raise TableError(f"--folds must be 2 or more, got {options.folds}.")
    check_installed("jinja2", "matplotlib", "skops")
    out = Path(options.out)
    if not options.dry_run:
        check_outputs(options, [out / name for name in WRITTEN])
        if (out / "correction.json").exists() and not options.force:
            raise TableError(f"{out} holds a correction; --force replaces it.")
    arm, given, table = _read(load_arm(options.arm, options.base, options.tip), options)
    print_notes(table.notes)
    if given.layout.source.what.startswith("Fanuc") and not arm.couplings:
        arm = arm.replace(couplings=[(3, 2, 1)])
        print_notes(["A Fanuc shows joint 3 from the horizontal: its own angle is J3 + J2."])
    if options.dry_run:
        return OK, describe_plan(table, given, arm)
    result: Any = _learnt(table, given, arm)
    named = ("serial number", options.serial), ("operator", options.operator)
    facts = {"file": Path(options.table).name} | {name: text for name, text in named if text}
    # Everything is made before the first file gets its name; findings stand in the result.
    with Finding.ignored():
        report = write_report(result, facts=facts, row_numbers=table.rows)
        contents = corrected_file(given, result)
        card = describe(result.model, result.inputs(result.angles), groups=result.positions)
    today = replace(table, angles=in_rad(table))
    before, after = (result.scores.summary[when][0] for when in ("before", "after"))
    facts |= {"probe_mm": result.arm.probe.tolist()}
    step = step_of("learn", today, facts, result.scores.measure, before, after)
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


def _learnt(table, given, arm):
    """The correction that is learnt from a table."""
    options = given.options
    like = [load_correction(folder).model for folder in options.like or ()]
    show = nullcontext() if options.quiet else Progress(expected_seconds(len(table.angles)))
    with Finding.numbered(table.rows), warnings.catch_warnings(), show as progress:
        # Findings stand in the result, and are printed with it.
        warnings.simplefilter("ignore", FindingWarning)
        try:
            return learn_correction(
                arm,
                table.angles,
                table.positions,
                table.points,
                given.lengths(),
                angle_unit=table.angle_unit,
                cv=options.folds,
                n_jobs=options.jobs,
                progress=progress,
                extra=given.causes(table),
                like=like,
                tools=given.labels(table, "tool"),
                points_sd=options.points_sd,
                blocks=given.labels(table, "block"),
                stations=given.labels(table, "station"),
                accept=options.accept,
                take=options.take,
                features=given.features(table),
                tip_diameter=options.tip_diameter,
            )
        except FindingError as error:
            if error.finding.code == "another-table" and table.points is not None:
                _say_which_axis(arm, given.layout)
            raise


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
    source = Path(options.c or ".", f"{options.name}.c")
    sources = [source, source.with_suffix(".h")] if options.c else []
    check_outputs(options, [*sources, options.onnx])
    saved = load_correction(options.model)
    print_notes([saved.verdict] * (not saved.helps))
    if unnamed := find_unnamed_probe(saved):
        print_notes([f"{unnamed}: what is written is for this one."])
    paths, fade = [], False if options.fade == "no" else options.fade
    if options.c:
        source.parent.mkdir(parents=True, exist_ok=True)
        card = describe(saved.model)
        names = ("noise_mm", "std_factor", "scale_sd")
        card["standard_deviation"] = {name: saved.facts[name] for name in names}
        kinds: Any = {"std": options.std, "fade": fade}
        paths += export_c(saved.model, source, card=card, poses="random", **kinds)
        paths.append(source.with_name(f"{options.name}_test.c"))  # which comes with poses
    if options.onnx:
        to_onnx(saved.model, options.onnx, fade=fade)
        paths.append(options.onnx)
    print("Written:", *paths)
    return OK, {"files": [str(path) for path in paths]}


def plan(options):
    """Plan a first single-point test for an arm, and write the sheet of it."""
    out = Path(options.out)
    check_installed("jinja2", "matplotlib")
    check_outputs(options, [out / "plan.html", out / "plan.csv"])
    arm = load_arm(options.arm)
    if options.limits:
        such = "LOW,HIGH of each joint"
        given = parse_numbers("--limits", options.limits, 2 * arm.n_joints, such)
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
    units = {"P": "mm", "R": "deg"}
    names = [f"q{i} [{units[kind]}]" for i, kind in enumerate(arm.joint_types, start=1)]
    degrees = arm.in_unit(sheet.angles, "deg").tolist()
    poses = [(cones[i - 1], row) for i, row in zip(sheet.groups, degrees, strict=True)]
    lines = [",".join(["cone", *names])]
    lines += [",".join([cone, *(f"{value:.2f}" for value in row)]) for cone, row in poses]
    title = "Where the cones stand, and poses that reach them"
    figure = draw_svg("plan", title, draw_volume, arm, sheet.angles, sheet.positions)
    shown = {"cones": list(zip(cones, sheet.positions, strict=True)), "names": names}
    page = render("_plan.html", arm=arm, bar=bar, figure=figure, plan=sheet, poses=poses, **shown)
    write_whole({out / "plan.csv": "\n".join([*lines, ""]), out / "plan.html": page})
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
    columns = (f"q{i} [deg]" for i in range(1, 7))
    lines = ["simulated arm;no real measurement", ";".join(["position", *columns])]
    for label, angles in zip(test.groups, np.rad2deg(test.data), strict=True):
        lines.append(";".join([names[label], *(f"{v:.6f}".replace(".", ",") for v in angles)]))
    table, arm = out / "cone_test.csv", out / "nominal_arm.json"
    write_whole({table: "\r\n".join([*lines, ""])})
    test.nominal_arm.to_json(arm)
    print(f"A simulated single-point test: {table}")
    known = f"{names[first]}:{names[second]}:{length:.3f}:{sd}"
    words = ["learn", str(table), "--arm", str(arm), "--out", str(out)]
    words += ["--length", known, "--serial", "simulated"]
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


def describe_plan(table, given, arm):
    """Print what was read and what would be done with it; the same as facts."""
    layout, options = given.layout, given.options
    n, unit = table.angles.shape[0], table.angle_unit
    say(f"Rows: {n}, of {layout.path}.")
    names = [layout.header[i] for i in layout.angle_columns]
    lows, highs = table.angles.min(axis=0), table.angles.max(axis=0)
    width = max(map(len, names))
    for i, (name, low, high) in enumerate(zip(names, lows, highs, strict=True), 1):
        print(f"  joint {i}: {name[:40]:{min(width, 40)}s} {low:10.3f} to {high:10.3f} {unit}")
    refuse_one_pose(in_rad(table))
    facts = {"rows": n, "angle_unit": unit, "angles": names, "causes": list(table.others)}
    if table.points is not None:
        spread = np.ptp(table.points, axis=0)
        size = " x ".join(f"{length:.0f}" for length in spread)
        say(f"Points of a tracker: {n}, in a box of {size} mm.")
        facts["points_box_mm"] = spread.tolist()
    if table.positions is not None:
        labels, counts = np.unique(table.positions, return_counts=True)
        rows = f"{counts.min()} to {counts.max()}" if np.ptp(counts) else f"{counts[0]}"
        labels = labels[Groups.in_order(labels)].tolist()
        say(named_first(f"Positions: {len(labels)}, with {rows} rows each", labels))
        facts["positions"] = labels
    elif table.points is None:
        say("Positions: no column names them; learning finds the rows that share a place.")
    if lengths := given.lengths():
        say(f"Known lengths: {len(lengths)}.")
    elif table.points is None and not any(one[2:] for one in given.features(table)):
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


def expected_seconds(n_rows):
    """About how long learning from so many rows takes here, by a product measured now, s."""
    some = np.random.default_rng(0).normal(size=(750, 750))
    product = 8 * min(repeat(lambda: some @ some, number=1, repeat=2))
    return _PRODUCTS * (n_rows / _ROWS) ** _EXPONENT * product
