"""A linear error model moved to another probe: causes stay, the Jacobian is the new probe's."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import replace
from typing import Any

import numpy as np

from sklearn_raacmm.error_model._columns import TEMPERATURE, columns_of
from sklearn_raacmm.error_model._linear_model import field_sizes, place_fields, unseen_of_table

# Fields of the table, none of which a probe changes, and by how much rounding may.
_TABLE = ("a", "alpha", "d", "theta_offset", "joint_signs")
_ROUNDING = 1e-9
# How far from the probe others are by which the turn of the last link is found, mm: any will do,
# since all is in proportion.
_BESIDE_MM = 100.0
# Standard deviation of what poses of one probe do not show of a table, where a drawing states
# another: in units of its columns, arc seconds and what these span at the arm's reach. Angles are
# published within 0.02 degrees. Of 32 stated probes of simulated arms, 100 to 250 mm away, 0.92 of
# the errors are inside intervals of 95 %, with 50 as the fit has it 0.85
# (``benchmarks/bench_after_the_lab.py stated``).
_DRAWING_SD = 75.0
# Families whose columns are all per reach.
_PER_REACH = ("gravity", "force", "base")


def check_same_table(old, new):
    """Refuse an arm that differs from another one in more than its probe."""
    kinds = [f"{arm.n_joints} joints, {arm.convention} DH" for arm in (old, new)]
    if kinds[0] != kinds[1]:
        raise ValueError(
            f"the correction is of an arm of {kinds[0]}, and is to be moved to {kinds[1]}: only "
            "the probe may differ."
        )
    for name in ("couplings", "joint_types", "up_frame"):
        one, other = getattr(old, name), getattr(new, name)
        if one != other:
            raise ValueError(
                f"{name} of the correction's arm are {one} and those of the new arm {other}: only "
                "the probe may differ."
            )
    for name in _TABLE:
        one, other = getattr(old, name), getattr(new, name)
        far = np.flatnonzero(np.abs(one - other) > _ROUNDING)
        if len(far):
            i = far[0]
            raise ValueError(
                f"{name}{i + 1} of the correction's arm is {one[i]:.9g} and that of the new arm "
                f"{other[i]:.9g}: only the probe may differ. Register the new probe with the "
                "correction's own table, by calibrate(model.arm_, ..., correction=model, "
                "free=['probe']), or fit the model again."
            )


def moved_model(linear, arm, stated=False):
    """The same causes, seen by another probe of the same table: a `LinearModel`.

    Poses find a probe's vector in the last frame as the table has it: what no pose of the old probe
    shows of the table is a part of the new vector then. Of a vector that is `stated` it is in
    doubt, until another probe is found.
    """
    check_same_table(linear.arm, arm)
    if np.any(arm.up != linear.arm.up):
        # The probe first: what it does not show is of the earlier mounting.
        linear = moved_model(linear, arm.replace(up=linear.arm.up), stated)
        # What the data have found of the vertical was of that, too.
        layout = columns_of(arm, linear.terms._replace(up=()))
        moved = replace(linear, layout=layout, informed_half=None)
        return moved.with_seen() if len(moved.seen) else moved
    if linear.shown_by is not None:  # a probe was stated before: what the one before it shows
        linear = _at_probe(linear, linear.arm.replace(probe=linear.shown_by))
    moved = _at_probe(linear, arm, _DRAWING_SD if stated else 0.0)
    return replace(moved, shown_by=linear.arm.probe if stated else None)


def _at_probe(linear, arm, unseen_sd=None):
    """A model at another probe; None keeps how well it knows what the old one does not show.

    Coefficients are counted in units of the arm's reach, which the probe changes; growth by
    temperature is in proportion to each length.
    """
    terms = linear.terms
    layout = columns_of(arm, terms)
    n_waves, others = layout.n_waves, layout.others
    old = {c.name: (i, c) for i, c in enumerate(linear.layout.others)}
    matrix = np.zeros((n_waves + len(others), len(linear.coef)))
    matrix[:n_waves, :n_waves] = np.eye(n_waves)
    fresh = []  # the probe has a length along an axis along which the old one had none
    for row, column in enumerate(others, start=n_waves):
        if column.name not in old:
            fresh.append(row)
            continue
        place, before = old[column.name]
        same = column.family == TEMPERATURE or before.unit == column.unit
        matrix[row, n_waves + place] = 1.0 if same else before.unit / column.unit
    unknown = np.zeros((len(matrix), len(fresh)))
    unknown[fresh, range(len(fresh))] = linear.prior_sd.get("temperature", 0.0)
    ratio = arm.reach_mm / linear.arm.reach_mm
    prior_sd = {
        name: sd * ratio if name in _PER_REACH else sd for name, sd in linear.prior_sd.items()
    }
    roots = {}
    for name in ("gauge_free_half", "informed_half"):
        if (root := getattr(linear, name)) is not None:
            if unseen_sd is not None:
                unseen, start = unseen_of_table(linear.layout.alone), linear.layout.n_waves
                root = root.copy()
                of_table = root[start : start + len(unseen)]
                of_table -= unseen @ (unseen.T @ of_table)
                if unseen_sd:
                    rows = start, len(root) - start - len(unseen)
                    root = np.hstack([root, np.pad(unseen_sd * unseen, (rows, (0, 0)))])
            roots[name] = np.hstack([matrix @ root, unknown])
    # What a place hides is there for both probes: fields of the same size.
    ratio = field_sizes(layout) / field_sizes(linear.layout) if len(linear.seen) else np.ones(0)
    more = roots["gauge_free_half"].shape[1] - linear.half.shape[1]
    seen = np.pad(ratio[:, None] * linear.seen, ((0, 0), (0, more)))
    half = roots.pop("gauge_free_half")
    return replace(
        linear,
        layout=layout,
        prior_sd=prior_sd,
        coef=matrix @ linear.coef,
        half=half + place_fields(layout) @ seen if len(seen) else half,
        seen=seen,
        ranges=linear.ranges[:, : arm.n_joints + len(terms.extra)],
        **roots,
    )


def turns_of(linear: Any, rows: np.ndarray) -> np.ndarray:
    """Rotation vectors (n, 3) in rad that the model has the last link turned by at rows of X.

    Of residuals e at probes beside each other, E = de / dprobe in the base: the last link turns by
    the antisymmetric part of E R', with R its orientation. The rest is growth.
    """
    arm = linear.arm
    own = linear.predict(rows)[0]
    beside = (arm.replace(probe=arm.probe + step) for step in _BESIDE_MM * np.eye(3))
    by_probe = [moved_model(linear, other).predict(rows)[0] - own for other in beside]
    frame = arm.frames(rows[:, : arm.n_joints])[:, -1, :, :3]
    slope = np.stack(by_probe, axis=2) @ frame.swapaxes(1, 2) / (2 * _BESIDE_MM)
    i, j = [2, 0, 1], [1, 2, 0]
    return slope[:, i, j] - slope[:, j, i]


def moved_fading(fading, old, new):
    """Fading that takes no more of a correction than with the old probe.

    A longer probe makes every standard deviation larger, and the errors with it: that is no reason
    to take the correction back. Those of the last joint grow as its lever does, others less.
    """
    levers = [np.hypot(arm.a[-1], arm.d[-1]) + np.linalg.norm(arm.probe) for arm in (old, new)]
    ratio = max(float(levers[1] / levers[0]), 1.0) if levers[0] > 0 else 1.0
    lengths = {name: ratio * getattr(fading, name) for name in ("size_mm", "known_mm", "near_mm")}
    return replace(fading, **lengths)
