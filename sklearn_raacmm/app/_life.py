"""Words of the command for the life of an arm: check, register, update and move."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import contextlib
import json
from dataclasses import replace
from datetime import date
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from scipy.spatial.transform import Rotation

from sklearn_raacmm.app._correct import corrected_file
from sklearn_raacmm.app._files import WRITTEN, check_outputs, load_correction, print_notes
from sklearn_raacmm.app._given import Given, find_unnamed_probe, in_rad, parse_numbers
from sklearn_raacmm.app._sources import TableError, check_installed
from sklearn_raacmm.calibration import MUCH_SCATTER_MM
from sklearn_raacmm.measurements import position_residuals
from sklearn_raacmm.metrics import single_point_repeatability
from sklearn_raacmm.utils import Finding, Groups, digest_of

OK, CHANGED = 0, 3
# Chance that a check finds a fault in a correction that is right, by any of its tests.
_FALSE_ALARM = 0.01
# Scatter through the correction over what it left when it was learnt, from which on a registration
# does not suffice: less is within what few poses show.
_MUCH_MORE = 1.5
# Mean distance from a tracker's points over the rms that the model expects, from which on no cause
# that the model knows explains it: the factor of an expanded uncertainty (k = 2), a choice. Checks
# of a UR10, by 40 poses at other goals and in a region left out, had 0.8 to 1.4 of it.
_MUCH_FARTHER = 2.0
# 2S, mm, below which a position counts as one of this 2S: simulated ones may have none.
_LEAST_2S_MM = 1e-6
_OTHER_ARM = "Look at the unit, order and sense of the angles, the labels, and whose arm it is."
# Share of the reach that a probe is at least: in metres none is. A choice.
_LEAST_PROBE = 1e-3
# What a step in the history says of points without and with the correction.
_SIDES = "before_mm", "after_mm"
# What to do where most poses of a check lie where the model knows little.
_MEASURE_OTHERS = (
    "Check with poses like those that it was learnt with; if you need these, run raacmm update "
    "with some of them."
)
# Steps whose poses the model knows already.
_LEARNT = {"learn": "taught", "update": "updated"}
# Decimals of rad and mm by which a pose is known again, and so many that are no coincidence.
_DIGITS, _REPEATED = 4, 2
# Parts of the model that have changed by less than this share of what is usual are not named.
_NAMED_TAU = 0.1
# Causes of which most is not known that are named.
_MOST_DOUBTS = 3


def register(options):
    """Find a new probe, and where base or tracker stand, through the correction."""
    saved = _open_correction(options)
    given, today, measured = _read_today(options, saved.arm)
    with Finding.numbered(today.rows):
        new = saved.register(*measured, accept=options.accept)
    now = new.model.predict(new.inputs(today.angles))
    before, left, usual, facts = _compare("Registered", saved, new, today, 0, now)
    print(f"Mean deviation {before:.3f} -> {left:.3f} mm.")
    holds = usual is None or left <= _MUCH_MORE * usual
    if usual is None:
        print("The correction was learnt by another kind of measurement: run raacmm check.")
    elif holds:
        print(f"The correction holds with it: {usual:.3f} mm is usual.")
    else:
        print(f"{usual:.3f} mm is usual: the arm itself may have changed. Run raacmm update.")
    facts = step_of("register", today, facts, "mean deviation without and with it", before, left)
    if hasattr(new.model, "linear_model_"):
        _print_lack(saved, new)
    _print_doubts(new, today.angles, today.positions)
    if holds or options.out.resolve() != options.model.resolve():
        _save(new, options, facts, today, given)
    else:
        print("Nothing is written: --out names another folder for this correction.")
    return (OK if holds else CHANGED), facts


def update(options):
    """Register, and bring the correction up to date with the same poses."""
    saved = _open_correction(options)
    given, today, measured = _read_today(options, saved.arm)
    if used := _used_poses(saved, today):  # they count once
        raise TableError(used)
    with Finding.numbered(today.rows):
        new = saved.update(*measured, date=date.today().isoformat(), accept=options.accept)
    X = saved.inputs(today.angles)
    was, now = saved.model.with_arm(new.arm).predict(X), new.model.predict(X)
    before, after, _, facts = _compare("Updated", saved, new, today, was, now)
    updates = vars(new.model).get("updates_", ())
    if len(updates) == len(vars(saved.model).get("updates_", ())):
        print("Nothing was changed: the poses are too few.")
        return CHANGED, facts
    tau = dict(sorted(updates[-1]["tau"].items(), key=lambda one: -one[1]))
    if not tau:
        noise = updates[-1]["noise_sd_mm"]
        print(f"These poses show noise of {noise:.3g} mm a coordinate, and no change beside it.")
    parts = [f"{name} ({100 * size:.0f} %)" for name, size in tau.items() if size > _NAMED_TAU]
    most = ", ".join(parts[:4])
    usual = "of the size that it usually has"
    if most:
        print(f"Causes of error that changed most, each by a share {usual}: {most}.")
    else:
        print(f"No cause of error changed by more than {_NAMED_TAU:.0%} {usual}.")
    rms = _rms(now - was)
    print(
        f"The correction has changed by {rms:.3f} mm (rms) at these poses; mean deviation "
        f"{before:.3f} -> {after:.3f} mm."
    )
    print("Check it with poses that it was not updated with: raacmm check.")
    facts |= {"changed_most": most, "correction_changed_by_mm": rms, "tau": tau}
    facts = step_of("update", today, facts, "mean deviation at these poses", before, after)
    _save(new, options, facts, today, given)
    return OK, facts


def move(options):
    """Move the correction to a probe whose vector is known."""
    saved = _open_correction(options)
    probe = parse_numbers("--probe", options.probe)
    if 0 < (length := np.linalg.norm(probe)) < _LEAST_PROBE * saved.arm.reach_mm:
        raise TableError(
            f"--probe is {length:.3g} mm long, of an arm that reaches {saved.arm.reach_mm:.4g} mm: "
            "are these metres? Give millimetres; raacmm register finds a probe that is so short."
        )
    new = saved.move(probe)
    facts = _print_moves(saved, new)
    _print_lack(saved, new)
    _print_doubts(new, new.arm.random_poses(200))
    print("The vector of a drawing is off by tenths of a millimetre: register the probe first.")
    facts = step_of("move", None, facts)
    _save(new, options, facts)
    return OK, facts


def _print_lack(saved, new):
    """Say so where the new probe is known by less than the one before, for its size."""
    X = saved.inputs(saved.arm.random_poses(200))
    models = saved.model.linear_model_, new.model.linear_model_
    old, old_sd, now, now_sd = (_rms(p) for one in models for p in one.predict(X, return_std=True))
    if now_sd * old > old_sd * now:
        print(
            "The first test shows less of the errors of this probe than of its own: where they "
            "matter, learn with both probes (raacmm learn --tool)."
        )


def _print_doubts(correction, angles, positions=None):
    """Say of which causes most is not known of points at these poses."""
    most = [*correction.doubts(angles, positions)][:_MOST_DOUBTS]
    if most:
        print(f"Causes that the model knows least about at these poses: {', '.join(most)}.")


def _rms(vectors):
    """Root mean square of the lengths of vectors (n, 3)."""
    return float(np.sqrt(np.mean(np.sum(np.square(vectors), axis=1))))


def check(options):
    """Compare today's poses with what was promised at positions left out, and with the model."""
    check_outputs(options, [options.record])
    saved = load_correction(options.model)
    has_causes = hasattr(saved.model, "linear_model_")
    by_spread = saved.facts["measure"] == "2S" and not options.points
    needed = [f"--{name}" for name in ("record", "length", "lengths") if getattr(options, name)]
    if not has_causes and (needed or not by_spread):
        raise TableError(
            f"{' and '.join(needed) or 'this check'} needs a model of causes; this correction has "
            "none in use: check it with a single-point test."
        )
    if unnamed := find_unnamed_probe(saved):
        print_notes([f"{unnamed}: check with this one."])
    _, today, measured = _read_today(options, saved.arm)
    if used := _used_poses(saved, today):
        print_notes([f"{used} A check by them says that the correction holds, whatever happened."])
    rate = _FALSE_ALARM / (has_causes + by_spread)  # of each of the two tests
    facts, advice = {}, ""
    result: Any = None  # of the model's check
    if has_causes:
        facts, result, advice = _check_model(saved, today, measured, rate, options)
    if by_spread:
        # Rows that slipped are left out where each position keeps two or more.
        kept = np.delete(np.arange(len(today.angles)), list(result.slipped if result else ()))
        if np.unique(today.positions[kept], return_counts=True)[1].min() > 1:
            today = replace(today, angles=today.angles[kept], positions=today.positions[kept])
        facts |= _check_spread(saved, today, rate, advice)
    else:
        facts |= _check_distances(saved, today, measured, options) if options.points else {}
        facts |= _answer(result, today, facts, advice)
    if options.record:
        try:
            names = (*_SIDES, "expected_below_mm", "holds", "said")
            answer = {name: facts.get(name, "") for name in names}
            replace(result, record=result.record | answer).append_to(options.record)
            print(f"Appended to {options.record}")
        except OSError as error:
            print_notes([f"This check is not in {options.record}: {error}"])
    print(facts["said"])
    try:
        _refuse_other_writers(saved, options.model)
        name = "mean 2S" if by_spread else "mean distance"
        measure = (name, *map(facts.get, _SIDES)) if _SIDES[0] in facts else ()
        step = step_of("check", today, facts, *measure)
        # A check changes no model: its file is written again as it is, without importing skops.
        model = (options.model / "model.skops").read_bytes()
        same = digest_of(model) == saved.facts["files"]["model.skops"]
        contents = {"model.skops": model} if same else {}
        save_step(saved, options.model, step, today, _page_of(options), contents)
    except (OSError, ValueError, ImportError) as error:
        print_notes([f"This check is not in the history of {options.model}: {error}"])
    return (OK if facts["holds"] else CHANGED), facts


def _check_model(saved, today, measured, rate, options):
    """Facts of what the model sees, its check, and what to do about a change; else ""."""
    given = {"new_base": options.new_base, "accept": options.accept}
    with Finding.numbered(today.rows):
        result = saved.check(*measured, false_alarm_rate=rate, **given)
    changed = bool(result.matters and not result.holds)
    if options.points and (saved.base is None or options.new_base):
        print("The base was found from these same poses: what it takes up shows no change.")
    if not result.holds:
        little = "" if changed else " That is too little to act on."
        print(
            f"Suspect: {result.suspect}, {result.size_mm:.3f} mm at the probe (p = "
            f"{result.p_value:.2g}), where {result.usual_mm:.3f} mm is usual.{little}"
        )
    _print_doubts(saved, today.angles, today.positions)
    for row in result.slipped:
        label = "" if today.positions is None else f" ({today.positions[row]})"
        print(f"slipped: row {today.rows[row]}{label}, measure it again, or mend its label")
    names = ("suspect", "p_value", "size_mm", "usual_mm", "matters")
    facts = {name: getattr(result, name) for name in names}
    return facts, result, result.advice if changed else ""


def _check_distances(saved, today, measured, options):
    """Facts: mean distances from a tracker's points, mm, without the correction and with it."""
    if saved.base is None or options.new_base:
        with Finding.numbered(today.rows):
            saved = saved.register(*measured, free=(), accept=options.accept)
    off = saved.residuals(today.angles, today.points)
    with Finding.ignored():  # of poses where little is known: the check has said so
        correction = saved.model.predict(saved.inputs(today.angles))
    mean = [float(np.linalg.norm(y, axis=1).mean()) for y in (off, off - correction)]
    return dict(zip(_SIDES, mean, strict=True))


def _answer(result, today, facts, advice):
    """Facts of a check by a model alone: its answer in sentences, and whether it holds."""
    change = _describe_poses(today)
    if _SIDES[0] in facts:
        change += ", mean distance {:.3f} -> {:.3f} mm".format(*map(facts.get, _SIDES))
    change += f"; the model expects {facts['usual_mm']:.3f} mm (rms) at these poses"
    why = [finding.text for finding in result.findings if finding.code == "little-known"]
    if facts.get("after_mm", 0.0) > _MUCH_FARTHER * facts["usual_mm"]:
        why.append("The points are farther off than the model can tell.")
    said = f"It holds: {change}."
    if advice:
        said = f"It does not hold: {change}. {advice}"
    elif why:
        said = f"Whether it holds does not show: {change}. {why[0]} {_MEASURE_OTHERS}"
    return {"said": said, "holds": not (advice or why)}


def _check_spread(saved, today, rate, advice):
    """Facts of what the mean 2S shows, the sentence `said` among them.

    `advice` is what to do about a change that the model sees: one answer says what to do once.
    """
    sides = saved.arm.forward(today.angles), saved.correct(today.angles)[0]
    before, after = (single_point_repeatability(p, today.positions, aggregate=None) for p in sides)
    labels = np.unique(today.positions)
    for i in Groups.in_order(labels):
        print(f"{labels[i]}: 2S {before[i]:.4f} -> {after[i]:.4f} mm")
    n_poses = np.unique(today.positions, return_counts=True)[1]
    expected = highest_mean(saved.facts["positions"], n_poses, rate)
    expected *= _wider_than_learnt(saved, today)
    was, now = float(before.mean()), float(after.mean())
    facts = {"before_mm": was, "after_mm": now, "expected_below_mm": expected}
    change = f"mean 2S {was:.3f} -> {now:.3f} mm"
    if now > max(MUCH_SCATTER_MM, expected):
        said = f"It does not hold: {change}. {_why_so_far(saved, today, _MUCH_MORE * expected)}"
    elif now >= was:
        said = f"It does not hold: {change}. {advice or 'Calibrate and learn again.'}"
    elif now > expected:
        said = (
            f"It helps less than it did: {change}. If it held, the mean of {len(after)} positions "
            f"would be below {expected:.3f} mm in {1 / rate - 1:.0f} of {1 / rate:.0f} checks. "
            f"{advice or 'Look at probe and base, or learn again.'}"
        )
    else:
        verdict = "It still helps, but something has changed" if advice else "It holds"
        said = f"{verdict}: {change}; expected below {expected:.3f} mm. {advice}".rstrip()
    holds = now < was and now <= expected and not advice
    return facts | {"changed": bool(advice), "said": said, "holds": holds}


def _why_so_far(saved, today, limit):
    """What to do where points scatter by much: another probe, if one explains it."""
    with Finding.ignored(), contextlib.suppress(ValueError):
        new = saved.register(today.angles, today.positions)
        left = single_point_repeatability(new.correct(today.angles)[0], today.positions)
        if left <= limit:
            moved = np.linalg.norm(new.arm.probe - saved.arm.probe)
            return f"A probe that ends {moved:.3g} mm elsewhere explains it: run raacmm register."
    return _OTHER_ARM


def highest_mean(learnt, n_poses, rate):
    """Mean 2S, mm, that new positions of so many poses (n,) exceed at this rate at most.

    `learnt` is the table of the positions of the first test. The one-sided prediction limit of
    values whose logarithms are normal, as those of standard deviations nearly are; the logarithm of
    one of n poses has a variance of 1 / (6 (n - 1)) for that few, which new positions have too.
    """
    logs = np.log(np.maximum(learnt["after"], _LEAST_2S_MM))
    counts = (np.asarray(n, dtype=float) for n in (learnt["n_points"], n_poses))
    of_few = [np.mean(1 / np.maximum(n - 1, 1)) / 6 for n in counts]
    m, n, variance = len(logs), len(n_poses), np.var(logs, ddof=1)
    of_new = variance + max(of_few[1] - of_few[0], 0.0)
    spread = stats.t.ppf(1 - rate, m - 1) * np.sqrt(variance / m + of_new / n)
    # The mean of n such values lies above the exponential of the mean logarithm.
    return float(np.exp(np.mean(logs) + of_new / 2 * (1 - 1 / n) + spread))


def _wider_than_learnt(saved, today):
    """How much wider points scatter with the probe of today than with that of the first test.

    The ratio of the standard deviations within a position that the model states at these poses: an
    error of a joint moves the end of a longer probe by more.
    """
    steps = saved.facts.get("history", [])
    probes = [one["probe_mm"] for one in steps if one["what"] == "learn" and "probe_mm" in one]
    if not probes or not hasattr(saved.model, "with_arm"):
        return 1.0
    as_learnt = saved.arm.replace(probe=probes[0])
    then = replace(saved, arm=as_learnt, model=saved.model.with_arm(as_learnt))
    now, then = (_rms(one.correct(today.angles, std_of="position")[1]) for one in (saved, then))
    return now / then


def _open_correction(options):
    """The saved correction, where its folder can be written."""
    out = Path(options.out or options.model)
    check_outputs(options, [out / name for name in WRITTEN])
    options.out = out
    check_installed("jinja2")
    return load_correction(options.model)


def _read_today(options, arm):
    """What is given of today, its table in rad, and what a correction takes of both."""
    given = Given(options, arm, labelled=not options.points)
    table = given.layout.read()
    print_notes(table.notes)
    lengths = given.lengths()
    if options.points and lengths:
        raise TableError("--lengths are between cones; a tracker has no use for them.")
    with Finding.numbered(table.rows):  # warns of what seems another unit
        arm.check_angles(table.angles, table.angle_unit)
    today = replace(table, angles=in_rad(table), angle_unit="rad")
    return given, today, (today.angles, today.positions, today.points, lengths)


def _describe_poses(today):
    if today.points is not None:
        return f"{len(today.angles)} poses, measured by a tracker"
    return f"{len(today.angles)} poses in {len(np.unique(today.positions))} cones"


def _compare(word, saved, new, today, was, now):
    """Mean deviation of points with two corrections, what was usual, and facts of what moved.

    In mm; what was left when it was learnt is None if that was another measure. Poses whose points
    scatter as those of no arm with this table do are refused.
    """
    labels = today.positions
    y = new.calibration.residuals(today.angles, today.points, labels)
    left = [y - mm if labels is None else position_residuals(y - mm, labels) for mm in (was, now)]
    before, after = (float(np.linalg.norm(one, axis=1).mean()) for one in left)
    usual, by_cones = None, today.points is None
    if saved.facts["measure"] == ("2S" if by_cones else "mean deviation"):
        usual = float(np.mean(saved.facts["positions"]["after"]))
        if by_cones:  # of normal errors: twice their length's root mean square
            usual *= np.sqrt(8 / (3 * np.pi)) / 2
        usual *= _wider_than_learnt(new, today)
    if after > max(MUCH_SCATTER_MM, _MUCH_MORE * (usual or 0.0)):
        raise TableError(
            f"the points are still off by {after:.3g} mm, and nothing is written. {_OTHER_ARM} If "
            "all are right, the arm has changed too much: learn again."
        )
    print(f"{word} with {_describe_poses(today)}.")
    return before, after, usual, _print_moves(saved, new)


def _print_moves(old, new):
    """Print how far probe and base have moved, and return it as plain values."""
    probe = float(np.linalg.norm(new.arm.probe - old.arm.probe))
    x, y, z = new.arm.probe
    print(f"Probe: ({x:.3f}, {y:.3f}, {z:.3f}) mm, {probe:.3f} mm from where it was.")
    facts = {"probe_mm": new.arm.probe.tolist(), "probe_moved_mm": probe}
    if new.tools:
        print(f"The vectors of the tools {', '.join(new.tools)} stay as they were learnt.")
    if old.base is not None:
        turn = Rotation.from_matrix(old.base[0].T @ new.base[0])
        angle = float(np.rad2deg(turn.magnitude()))
        shift = float(np.linalg.norm(new.base[1] - old.base[1]))
        moved = f"moved by {shift:.3f} mm and turned by {angle:.4f} degrees"
        print(f"Base: {moved} in the tracker's frame.")
        facts |= {"base_moved_mm": shift, "base_turned_deg": angle}
    elif new.base is not None:
        print("Base: found for the first time.")
    return facts


def save_step(correction, out, step, today, page="", contents=()):
    """Write the folder with a step added to its history, of which the report tells.

    `page` is the report so far; `contents` are further files by their names. The poses of a step
    that has taught the model go into the history: it is to know them again.
    """
    # Here, because reading alone spares the time of importing them.
    from sklearn_raacmm.app._report import with_history
    from sklearn_raacmm.export import describe

    step = {"date": date.today().isoformat(), **step}
    if step["what"] in _LEARNT:
        step["rows"] = "".join(digests_of(today))
    card = describe(correction.model)
    if card["fingerprint"]:
        step["model"] = card["fingerprint"]
    history = [*correction.facts.get("history", []), step]
    correction = replace(correction, facts=correction.facts | {"history": history})
    known = {"findings": [f"{one.weight}: {one}" for one in correction.findings]}
    known |= {name: correction.facts.get(name) for name in ("scale_set_by", "training")}
    card |= {name: fact for name, fact in known.items() if fact}
    card = f"{card}\n## Verdict when it was learnt\n\n- {correction.verdict}\n"
    contents, points, kept = dict(contents), Path(out, "corrected.csv"), {}
    if step["what"] != "check" and points.is_file():  # the points of before, under a free name
        stem = f"{points.stem}_before_{step['what']}_{step['date']}"
        names = (f"{stem}{f'_{i}' * (i > 1)}{points.suffix}" for i in count(1))
        free = next(name for name in names if not points.with_name(name).exists())
        kept = {free: points.read_bytes()}
    pages = {"report.html": with_history(page, history), "card.md": card}
    written = correction.save(out, pages | kept | contents)  # renamed in this order
    if kept and points.name not in contents:
        points.unlink()  # of another probe
    for name in kept:
        print(f"The corrected points of before are now in {name}.")
    return written


def _save(correction, options, step, today=None, given=None):
    """Write the folder with what was done, and with the points of today where there are any."""
    contents = {} if given is None else corrected_file(given, correction)
    if options.out == options.model:
        _refuse_other_writers(correction, options.out)
    written = save_step(correction, options.out, step, today, _page_of(options), contents)
    print(f"Written to {options.out}: {', '.join(path.name for path in written)}")


def _page_of(options):
    """The report in the folder of the model, empty where there is none."""
    path = options.model / "report.html"
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def _refuse_other_writers(saved, folder):
    """Refuse to replace what another process has written since the correction was read."""
    now = json.loads((folder / "correction.json").read_text(encoding="utf-8"))
    if now.get("fingerprint") != saved.facts.get("fingerprint"):
        raise TableError(f"{folder} was changed by another process meanwhile: run this again.")


def step_of(what, today, facts, *worth):
    """What was done, with which poses, and what it was worth, as plain values.

    That is a measure, and its value before and after in mm.
    """
    step = {"what": what}
    if today is not None:
        step |= {"n_poses": len(today.angles), "poses": digest_of("".join(digests_of(today)))}
    return step | dict(zip(("measure", *_SIDES), worth, strict=False)) | facts


def digests_of(today):
    """Eight digits of each pose in rad, sorted: the same in any order and with any further digits.

    A robot can repeat its poses: what a tracker saw of them belongs to them.
    """
    values = [today.angles] if today.points is None else [today.angles, today.points]
    rows = np.unique(np.hstack(values).round(_DIGITS) + 0.0, axis=0)
    return sorted(digest_of(row.tobytes())[:8] for row in rows)


def _used_poses(saved, today):
    """In one sentence, that poses have had a part in this correction already; else empty."""
    mine = digests_of(today)
    for step in saved.facts.get("history", []):
        known = step.get("rows", "")
        used = len({known[i : i + 8] for i in range(0, len(known), 8)}.intersection(mine))
        if used >= _REPEATED:
            return (
                f"{used} of these {len(today.angles)} poses have {_LEARNT[step['what']]} this "
                f"correction on {step['date']}: leave them out, and measure new ones."
            )
    return ""
