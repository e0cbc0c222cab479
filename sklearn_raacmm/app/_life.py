"""Words of the command for the life of an arm: check, register, update and move."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import sys
from dataclasses import replace
from datetime import date as calendar
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from sklearn_raacmm.app._causes import probe_not_told
from sklearn_raacmm.app._cells import TableError, as_said
from sklearn_raacmm.app._files import files_of, in_rad, load_correction, read_rows, vector_of
from sklearn_raacmm.app._lengths import read_lengths
from sklearn_raacmm.arm import check_angles
from sklearn_raacmm.calibration import MUCH_SCATTER_MM
from sklearn_raacmm.error_model import ArmResidualRegressor
from sklearn_raacmm.export import describe
from sklearn_raacmm.metrics import single_point_repeatability
from sklearn_raacmm.residuals import position_residuals
from sklearn_raacmm.utils import check_places, natural_order

OK, CHANGED = 0, 3
# Chance that a check finds a fault in a correction that is right, by any of its tests.
_FALSE_ALARM = 0.01
# Scatter through the correction over what it left when it was learnt, from which on a registration
# does not suffice: less is within what few poses show.
_MUCH_MORE = 1.5
_OTHER_ARM = "Look at the unit, order and sense of the angles, the labels, and whose arm it is."
# Parts of the model that have changed by less than this share of what is usual are not named.
_NAMED_TAU = 0.1


class _Today(NamedTuple):
    """What was measured today."""

    angles: np.ndarray  # (n, n_joints) rad
    positions: Any
    points: np.ndarray | None  # (n, 3) mm
    lengths: list
    rows: np.ndarray  # (n,) their numbers in the file

    @classmethod
    def of(cls, options, arm):
        by_tracker = bool(options.points)
        table = read_rows(options, arm, labelled=not by_tracker)
        lengths = read_lengths(options.lengths, options.length_sd) if options.lengths else []
        if by_tracker and lengths:
            raise TableError("--lengths are between cones; a tracker has no use for them.")
        check_angles(table.angles, arm.n_joints, table.angle_unit)  # says if that seems another
        return cls(in_rad(table), table.positions, table.points, lengths, table.rows)

    @property
    def measured(self):
        """The same as the methods of a correction take them."""
        return self.angles, self.positions, self.points, self.lengths

    @property
    def said(self):
        """What they are, in words."""
        if self.points is not None:
            return f"{len(self.angles)} poses, measured by a tracker"
        return f"{len(self.angles)} poses in {len(np.unique(self.positions))} cones"

    def left(self, y, predicted=0.0):
        """Mean distance of corrected points from where they should be, mm."""
        y = y - predicted
        if self.positions is not None:
            y = position_residuals(y, self.positions)
        return float(np.linalg.norm(y, axis=1).mean())

    def without(self, slipped):
        """The same without some rows, where each position keeps two or more."""
        kept = np.delete(np.arange(len(self.angles)), slipped)
        if np.unique(self.positions[kept], return_counts=True)[1].min() < 2:
            return self
        return self._replace(angles=self.angles[kept], positions=self.positions[kept])


def register(options):
    """Find a new probe, and where base or tracker stand, through the correction."""
    saved, out = _opened(options)
    today = _Today.of(options, saved.arm)
    new = saved.register(*today.measured)
    said, facts = _what_has_moved(saved, new)
    y = new.calibration.residuals(today.angles, today.points, today.positions)
    left = today.left(y, new.model.predict(new.inputs(today.angles)))
    usual = _usual_mm(saved, today)
    _refuse_another_arm(left, usual)
    print(f"Registered with {today.said}.", *said, sep="\n")
    print(f"Mean deviation {today.left(y):.3f} -> {left:.3f} mm.")
    enough = usual is None or left <= _MUCH_MORE * usual
    if usual is None:
        print("The correction was learnt by another kind of measurement: run raacmm check.")
    elif enough:
        print(f"The correction holds with it: {usual:.3f} mm is usual.")
    else:
        print(f"{usual:.3f} mm is usual: the arm itself may have changed. Run raacmm update.")
    _write(new, out, "register", today, facts)
    return (OK if enough else CHANGED), facts | {"left_mm": left}


def update(options):
    """Register, and bring the correction up to date with the same poses."""
    saved, out = _opened(options)
    today = _Today.of(options, saved.arm)
    new = saved.update(*today.measured, date=options.date)
    y = new.calibration.residuals(today.angles, today.points, today.positions)
    X, model = saved.inputs(today.angles), new.model
    said, facts = _what_has_moved(saved, new)
    was, now = saved.move(new.arm.probe).model.predict(X), model.predict(X)
    before, after = today.left(y, was), today.left(y, now)
    _refuse_another_arm(after, _usual_mm(saved, today))
    print(f"Updated with {today.said}.", *said, sep="\n")
    if len(vars(model).get("updates_", ())) == len(vars(saved.model).get("updates_", ())):
        print("Nothing was changed: the poses are too few.")
        return CHANGED, facts
    tau = sorted(vars(model)["updates_"][-1]["tau"].items(), key=lambda one: -one[1])
    parts = [f"{name} ({100 * size:.0f} %)" for name, size in tau if size > _NAMED_TAU][:4]
    print(f"Changed most, in parts of what is usual: {', '.join(parts) or 'nothing'}.")
    rms = np.sqrt(np.mean(np.sum((now - was) ** 2, axis=1)))
    print(
        f"The correction has changed by {rms:.3f} mm (rms) at these poses; mean deviation "
        f"{before:.3f} -> {after:.3f} mm."
    )
    print("Check it with poses that it was not updated with: raacmm check.")
    facts |= {"tau": dict(tau), "before_mm": before, "after_mm": after}
    _write(new, out, "update", today, facts)
    return OK, facts


def move(options):
    """Move the correction to a probe whose vector is known."""
    saved, out = _opened(options)
    new = saved.move(vector_of(options.probe))
    said, facts = _what_has_moved(saved, new)
    print(*said, sep="\n")
    tried = np.random.default_rng(0).uniform(-np.pi, np.pi, (200, new.arm.n_joints))
    old_mm, new_mm = (
        np.sqrt(np.square(one.model.linear_model_.predict(one.inputs(tried))[0]).sum(axis=1).mean())
        for one in (saved, new)
    )
    print(
        f"The corrections are now of {new_mm:.3f} mm (rms over all poses), before {old_mm:.3f} mm."
    )
    print("A vector from a drawing is good to some tenths: register the probe before you measure.")
    _write(new, out, "move", None, facts)
    return OK, facts


def check(options):
    """Compare today's poses with what was promised at positions left out, and with the model."""
    inputs = [options.table, *files_of(options.model)]
    check_places(filter(None, [options.record]), inputs)
    saved = load_correction(options.model)
    has_causes = isinstance(saved.model, ArmResidualRegressor) and saved.model.helps_
    by_spread = saved.facts["measure"] == "2S" and not options.points
    needed = [f"--{name}" for name in ("record", "lengths") if getattr(options, name)]
    if not has_causes and (needed or not by_spread):
        raise TableError(
            f"{' and '.join(needed) or 'this check'} needs a model of causes; this correction has "
            "none in use: check it with a single-point test."
        )
    if said := probe_not_told(saved):
        print(f"note: {said}: check with this one.", file=sys.stderr)
    today = _Today.of(options, saved.arm)
    rate = _FALSE_ALARM / (has_causes + by_spread)  # of each of the two tests
    changed, facts, slipped = False, {}, ()
    if has_causes:
        changed, facts, slipped = _by_causes(saved, today, options, rate)
    if by_spread:
        changed = _by_spread(saved, today.without(slipped), rate, changed, facts)
    elif not changed:
        print(f"It holds: {today.said}, {facts['usual_mm']:.3f} mm (rms) is what is usual.")
    return (CHANGED if changed else OK), facts | {"holds": not changed}


def _by_spread(saved, today, rate, changed, facts):
    """Whether the mean 2S, or what was found before, says that the correction no longer holds."""
    before, after = (
        single_point_repeatability(points, today.positions, aggregate=None)
        for points in (saved.arm.forward(today.angles), saved.correct(today.angles)[0])
    )
    labels = np.unique(today.positions)
    for i in natural_order(labels):
        print(f"{labels[i]}: 2S {before[i]:.4f} -> {after[i]:.4f} mm")
    expected = highest_mean(saved.facts["positions"]["after"], len(after), rate)
    was, now = float(before.mean()), float(after.mean())
    facts |= {"before_mm": was, "after_mm": now, "expected_below_mm": expected, "changed": changed}
    change = f"mean 2S {was:.3f} -> {now:.3f} mm"
    if now > max(MUCH_SCATTER_MM, expected):
        print(f"It does not hold: {change}. {_OTHER_ARM}")
    elif now >= was:
        print(f"It does not hold: {change}. Calibrate and learn again.")
    elif now > expected:
        print(
            f"It helps less than it did: {change}; the mean of {len(after)} positions like those "
            f"that it was judged at would be below {expected:.3f} mm in {1 / rate - 1:.0f} of "
            f"{1 / rate:.0f} tests. Look at probe and base, or learn again."
        )
    else:
        verdict = "It still helps, but something has changed" if changed else "It holds"
        print(f"{verdict}: {change}; expected below {expected:.3f} mm.")
    return changed or now >= was or now > expected


def highest_mean(learnt, n, rate):
    """Mean 2S, mm, that n new positions like those learnt exceed at this rate.

    The one-sided prediction limit of a mean of normal values.
    """
    learnt = np.asarray(learnt)
    quantile = stats.t.ppf(1 - rate, len(learnt) - 1)
    spread = learnt.std(ddof=1) * np.sqrt(1 / n + 1 / len(learnt))
    return float(learnt.mean() + quantile * spread)


def _by_causes(saved, today, options, rate):
    """Whether the model sees a change in today's poses, the facts of it, and rows that slipped."""
    found = saved.check(*today.measured, new_base=options.new_base, false_alarm_rate=rate)
    if today.points is not None and (saved.base is None or options.new_base):
        print("The base was found from these same poses: what it takes up shows no change.")
    changed = bool(found.matters and not found.holds)
    if not found.holds:
        worth = as_said(found.advice) if changed else "That is too little to act on."
        print(
            f"Suspect: {found.suspect}, {found.size_mm:.3f} mm at the probe (p = "
            f"{found.p_value:.2g}), where {found.usual_mm:.3f} mm is usual. {worth}"
        )
    for row in found.slipped:
        place = "" if today.positions is None else f" ({today.positions[row]})"
        print(f"slipped: row {today.rows[row]}{place}, measure it again")
    if options.record:
        found.append_to(options.record)
        print(f"Appended to {options.record}")
    names = ("suspect", "p_value", "size_mm", "usual_mm", "matters")
    return changed, {name: getattr(found, name) for name in names}, found.slipped


def _opened(options):
    """The saved correction, and the folder to write."""
    out = Path(options.out or options.model)
    table = getattr(options, "table", None)
    others = files_of(options.model) if options.out else []
    check_places([out / "correction.json"], [*others, *([table] if table else [])])
    return load_correction(options.model), out


def _usual_mm(saved, today):
    """Mean deviation that was left when it was learnt, mm; None if that was another measure."""
    if (saved.facts["measure"] == "2S") != (today.points is None):
        return None
    left = float(np.mean(saved.facts["positions"]["after"]))
    if saved.facts["measure"] == "2S":  # of normal errors: twice their length's root mean square
        left *= np.sqrt(8 / (3 * np.pi)) / 2
    return left


def _refuse_another_arm(left, usual):
    """Refuse poses whose points scatter as those of no arm with this table do, mm."""
    if left > max(MUCH_SCATTER_MM, _MUCH_MORE * (usual or 0.0)):
        raise TableError(
            f"the points are still off by {left:.3g} mm, and nothing is written. {_OTHER_ARM} If "
            "all are right, the arm has changed too much: learn again."
        )


def _what_has_moved(old, new):
    """Sentences on probe and base, and the same as plain values."""
    probe = new.arm.probe - old.arm.probe
    x, y, z = new.arm.probe
    said = [
        f"Probe: ({x:.3f}, {y:.3f}, {z:.3f}) mm, {np.linalg.norm(probe):.3f} mm from where it was."
    ]
    if tools := new.facts.get("tools"):
        said.append(f"The vectors of the tools {', '.join(tools)} stay as they were learnt.")
    facts = {"probe_mm": new.arm.probe.tolist(), "probe_moved_mm": float(np.linalg.norm(probe))}
    if new.base is None:
        return said, facts
    if old.base is None:
        said.append("Base: found for the first time.")
        return said, facts
    turn = old.base[0].T @ new.base[0]
    angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
    shift = float(np.linalg.norm(new.base[1] - old.base[1]))
    said.append(
        f"Base: moved by {shift:.3f} mm and turned by {np.rad2deg(angle):.4f} degrees in the "
        "tracker's frame."
    )
    return said, facts | {"base_moved_mm": shift, "base_turned_deg": float(np.rad2deg(angle))}


def _write(saved, out, word, today, facts):
    """Write the folder with what was done added to its history."""
    done = {"date": calendar.today().isoformat(), "what": word, **facts}
    if today is not None:
        done["n_poses"] = len(today.angles)
    history = [*saved.facts.get("history", []), done]
    saved = replace(saved, facts=saved.facts | {"history": history})
    card = describe(saved.model)
    written = saved.save(out, {"card.md": f"{card}\n"})
    print(f"Written to {out}: {', '.join(path.name for path in written)}")
