"""Exports prove themselves: test rows with their answers, and what a file says of them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import contextlib
import warnings

import numpy as np

from sklearn_raacmm.export._steps import typical_rows

# Test rows: given ones, corners of their ranges, and what is no number.
_N_INSIDE, _N_CORNERS, _N_BAD = 20, 8, 4
# How far a file may be from predict, as a share of the largest expected number: double keeps 1e-12
# where weights are no larger than 1000; single precision has 7 digits, of which weights cost some.
TOLERANCE = {"double": 1e-9, "float": 2e-2}
# Share of itself that a standard deviation may be off.
_STD_PROMISE = 1e-3
# Up to these shares a file says how far it is; beyond, it is refused. Networks of data with noise
# of 1e-6 have weights of 1e8, and were 2e-8 and 2e-4 off (tests/export/test_c_network.py).
_LIMIT, _STD_LIMIT = 1e-5, 0.1
# Share of the largest standard deviation below which there is none to compare.
_NOTHING = 1e-9


def rows_to_test(model, poses=None, std=False):
    """32 rows with what ``predict`` gives: given ones, corners of their ranges, NaN and infinity.

    `poses` (n, n_inputs) are rows to take some of; None: random ones, see `typical_rows`. The dict
    has X, y and, with `std`, std: one row each; NaN where predict refuses.
    """
    if poses is None:
        poses = typical_rows(model, 200)
    inside = poses[np.linspace(0, len(poses) - 1, _N_INSIDE).round().astype(int)]
    low, high = poses.min(axis=0), poses.max(axis=0)
    # Corners spread over all: bit i of an odd multiple says whether input i is low or high.
    n = poses.shape[1]
    bits = (np.arange(_N_CORNERS)[:, None] * 2654435761 >> np.arange(8, 8 + n) % 40) & 1
    bad = np.tile(inside[0], (_N_BAD, 1))
    bad[np.arange(_N_BAD), np.arange(_N_BAD) % n] = [np.nan, np.inf, -np.inf, np.nan]
    return answered(model, np.concatenate([inside, np.where(bits, high, low), bad]), std)


def answered(model, X, std=False):
    """Rows with what ``predict`` gives, one by one, as `rows_to_test`."""
    found = []
    while hasattr(model, "best_estimator_"):  # a search hands on no return_std
        model = model.best_estimator_
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of poses that the model does not know
        for row in X:
            answer = None
            if np.isfinite(row).all():
                with contextlib.suppress(ValueError):  # a corner where the model is not defined
                    answer = model.predict(row[None], **({"return_std": True} if std else {}))
            found.append(None if answer is None else np.reshape(answer, (1 + std, -1)))
    known = [answer for answer in found if answer is not None]
    if not known:
        raise ValueError(
            f"predict refuses all of {len(X)} rows, so the export cannot be compared with it: give "
            "poses that the model takes."
        )
    nothing = np.full(known[0].shape, np.nan)
    y = np.stack([nothing if answer is None else answer for answer in found], axis=1)
    return {"X": X, "y": y[0], **({"std": y[1]} if std else {})}


def dict_of_rows(rows):
    """Test rows as what JSON has: null for NaN, text for infinity."""
    names = {np.inf: "Infinity", -np.inf: "-Infinity"}
    return {
        key: [[None if np.isnan(v) else names.get(v, v) for v in row] for row in array.tolist()]
        for key, array in rows.items()
    }


def proved(what, rows, y, std=None, dtype="double"):
    """How far a file is from ``predict`` at some rows, or ValueError if that is too far.

    `what` names the file, `rows` are those of `rows_to_test`, y and std what the file gives. The
    list has what the file must say where it is worse than promised.
    """
    expected = rows["y"]
    refused = np.isnan(expected)
    size = np.abs(expected[~refused]).max(initial=1e-3)
    wrong = np.isnan(y) != refused
    if wrong.any():
        row = np.flatnonzero(wrong.any(axis=1))[0]
        raise ValueError(
            f"{what} does not refuse what predict refuses: at the row {rows['X'][row].tolist()} it "
            f"gives {y[row].tolist()}, predict {expected[row].tolist()}."
        )
    gap = np.abs(y - expected)[~refused].max(initial=0.0)
    promise, limit = TOLERANCE[dtype], max(_LIMIT, TOLERANCE[dtype])
    if not gap <= limit * size:
        raise ValueError(
            f"{what} is up to {gap:.2g} away from predict, {gap / size:.2g} of the largest number "
            f"({len(y)} rows); {promise:g} is promised. Rounding costs as much where weights are "
            "huge: fit with a larger alpha."
        )
    notes = [] if gap <= promise * size else [f"within {gap:.1e} of predict, at {len(y)} rows"]
    if std is None:
        return notes
    of_std = rows["std"][~refused]
    floor = _NOTHING * of_std.max(initial=0.0) + np.finfo(float).tiny
    share = np.max(np.abs(std[~refused] - of_std) / np.maximum(of_std, floor), initial=0.0)
    promise = max(_STD_PROMISE, TOLERANCE[dtype])
    if not share <= max(_STD_LIMIT, promise):
        raise ValueError(
            f"Standard deviations of {what} are up to {share:.2g} of themselves away from those of "
            f"predict ({len(y)} rows); {promise:g} is promised. Rounding costs as much where data "
            "have next to no noise: export without them, or fit with a larger alpha."
        )
    if share > promise:
        notes.append(f"standard deviations within {share:.1e} of themselves, at {len(y)} rows")
    return notes
