"""Exports prove themselves: test rows with their answers, and what a file says of them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.export._models import typical_rows

# Test rows: given ones, corners of their ranges, and what is no number.
_N_INSIDE, _N_CORNERS, _N_BAD = 20, 8, 4
# How far a file may be from predict, as a share of the largest expected number: double keeps 1e-12
# but for poles at the corners; single precision has 7 digits, of which weights cost some.
TOLERANCE = {"double": 1e-9, "float": 2e-2}
# Share of itself that a standard deviation may be off: what is promised; and up to which the file
# says how much it is, as for data without noise, where rounding decides.
_STD_PROMISE, _STD_LIMIT = 1e-3, 0.1
# Share of the largest standard deviation below which there is none to compare.
_NOTHING = 1e-9


def test_rows(model, poses=None, std=False):
    """32 rows with what ``predict`` gives: given ones, corners of their ranges, NaN and infinity.

    Parameters
    ----------
    model : estimator
    poses : ndarray of shape (n, n_inputs), optional
        Rows to take some of; None: random ones, see `typical_rows`.
    std : bool, default=False

    Returns
    -------
    dict of ndarray
        X (32, n_inputs), y (32, n_outputs) and, with `std`, std; NaN where predict refuses.
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
    """Rows with what ``predict`` gives, one by one, as `test_rows`."""
    import warnings

    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of poses that the model does not know
        for row in X:
            answer = None
            if np.isfinite(row).all():
                try:
                    answer = model.predict(row[None], **({"return_std": True} if std else {}))
                except ValueError:  # a corner where the model is not defined
                    pass
            found.append(None if answer is None else np.reshape(answer, (1 + std, -1)))
    known = [answer for answer in found if answer is not None]
    nothing = np.full(known[0].shape if known else (1 + std, 1), np.nan)
    y = np.stack([nothing if answer is None else answer for answer in found], axis=1)
    return {"X": X, "y": y[0], **({"std": y[1]} if std else {})}


def dict_of_rows(rows):
    """Test rows as what JSON has: null for NaN, text for infinity."""
    names = {np.inf: "Infinity", -np.inf: "-Infinity"}
    return {
        key: [[None if np.isnan(v) else names.get(v, v) for v in row] for row in array.tolist()]
        for key, array in rows.items()
    }


def rows_of_dict(content):
    """The opposite of `dict_of_rows`."""
    numbers = {None: np.nan, "Infinity": np.inf, "-Infinity": -np.inf}
    return {
        key: np.array(
            [[v if isinstance(v, float | int) else numbers[v] for v in row] for row in of]
        )
        for key, of in content.items()
    }


def proved(what, rows, y, std=None, dtype="double"):
    """How far a file is from ``predict`` at some rows, or ValueError if that is too far.

    Parameters
    ----------
    what : str
        The file, for the message.
    rows : dict
        As `test_rows` makes it.
    y, std : ndarray of shape (n, n_outputs)
        What the file gives.
    dtype : {"double", "float"}

    Returns
    -------
    list of str
        A sentence where a standard deviation is worse than promised.

    Raises
    ------
    ValueError
        With the numbers.
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
    if gap > TOLERANCE[dtype] * size:
        raise ValueError(
            f"{what} is up to {gap:.2g} away from predict, {gap / size:.2g} of the largest number "
            f"({len(y)} rows); {TOLERANCE[dtype]:g} is promised. Rounding costs as much where "
            "weights are huge: fit with a larger alpha."
        )
    if std is None:
        return []
    of_std = rows["std"][~refused]
    floor = _NOTHING * of_std.max(initial=0.0) + np.finfo(float).tiny
    share = np.max(np.abs(std[~refused] - of_std) / np.maximum(of_std, floor), initial=0.0)
    promise = max(_STD_PROMISE, TOLERANCE[dtype])
    if share > max(_STD_LIMIT, promise):
        raise ValueError(
            f"Standard deviations of {what} are up to {share:.2g} of themselves away from those of "
            f"predict ({len(y)} rows); {promise:g} is promised. Rounding costs as much where data "
            "have next to no noise: export without them, or fit with a larger alpha."
        )
    if share > promise:
        return [f"standard deviations within {share:.1e} of those of predict, at {len(y)} rows"]
    return []
