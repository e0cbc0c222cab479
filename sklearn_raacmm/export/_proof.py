"""Exports prove themselves: test rows with their answers, and what a file says of them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import contextlib
import json
import warnings

import numpy as np

from sklearn_raacmm.utils import floats

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
# Where the share that is left comes from sums of single precision, which is itself good to 2e-2:
# simulated arms were up to 1.6e-5 off.
SINGLE_SUMS = 1e-4
# Share of the largest standard deviation below which there is none to compare.
_NOTHING = 1e-9


def make_test_rows(chain, poses=None, std=False, dtype="double"):
    """32 rows with what ``predict`` gives: given ones, corners of their ranges, NaN and infinity.

    `poses` (n, n_inputs) are rows to take some of; None: random ones, see `Chain.typical_rows`. The
    dict has X, y and, with `std`, std: one row each; NaN where predict refuses.
    """
    if poses is None:
        poses = chain.typical_rows(200)
    n, model = chain.n_inputs, chain.model
    poses = floats("poses", poses, n)
    inside = poses[np.linspace(0, len(poses) - 1, _N_INSIDE).round().astype(int)]
    low, high = poses.min(axis=0), poses.max(axis=0)
    # Corners spread over all: bit i of an odd multiple says whether input i is low or high.
    bits = (np.arange(_N_CORNERS)[:, None] * 2654435761 >> np.arange(8, 8 + n) % 40) & 1
    bad = np.tile(inside[0], (_N_BAD, 1))
    bad[np.arange(_N_BAD), np.arange(_N_BAD) % n] = [np.nan, np.inf, -np.inf, np.nan]
    X = np.concatenate([inside, np.where(bits, high, low), bad])
    if dtype == "float":  # what single precision can hold
        X = X.astype(np.float32).astype(float)
    known = len(X) - _N_BAD
    answer = _answer(model, X[:known], std)
    if answer is None:  # of a corner where the model is not defined
        rows = [_answer(model, row[None], std) for row in X[:known]]
        shape = next((row.shape for row in rows if row is not None), None)
        if shape is None:
            raise ValueError(
                f"predict refuses all of {len(X)} rows, so the export cannot be compared with it: "
                "give poses that the model takes."
            )
        rows = [np.full(shape, np.nan) if row is None else row for row in rows]
        answer = np.concatenate(rows, axis=1)
    answer = np.pad(answer, ((0, 0), (0, _N_BAD), (0, 0)), constant_values=np.nan)
    return {"X": X, "y": answer[0], **({"std": answer[1]} if std else {})}


def _answer(model, X, std):
    """What ``predict`` gives, (1 + std, n, n_outputs), or None where it refuses."""
    with warnings.catch_warnings(), contextlib.suppress(ValueError):
        warnings.simplefilter("ignore")  # of poses that the model does not know
        answer = model.predict(X, **({"return_std": True} if std else {}))
        return np.reshape(answer, (1 + std, len(X), -1))
    return None


def rows_as_json(rows):
    """Test rows as JSON text: null for NaN, text for infinity."""
    names = {np.inf: "Infinity", -np.inf: "-Infinity"}
    lists = {
        key: [[None if np.isnan(v) else names.get(v, v) for v in row] for row in array.tolist()]
        for key, array in rows.items()
    }
    return json.dumps(lists)


def check_answers(what, rows, found, dtype="double", limit=_LIMIT, of="predict"):
    """How far a file is from ``predict`` at test rows, or ValueError if that is too far.

    `what` names the file, `found` is what it gives: y and perhaps std. The list has what the file
    must say where it is worse than promised; beyond `limit` of the largest number it is refused.
    `of` names what gave the answers in `rows`.
    """
    expected, y, std = rows["y"], found["y"], found.get("std")
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
    promise = TOLERANCE[dtype]
    if not gap <= max(limit, promise) * size:
        raise ValueError(
            f"{what} is up to {gap:.2g} away from {of}, {gap / size:.2g} of the largest number "
            f"({len(y)} rows); {promise:g} is promised. Rounding costs as much where weights are "
            "huge: fit with a larger alpha."
        )
    notes = [] if gap <= promise * size else [f"within {gap:.1e} of {of}, at {len(y)} rows"]
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
