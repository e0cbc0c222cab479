"""Known lengths between points of known places, and lengths that disagree.

With one another, with the cones, or with the arm's table.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from sklearn_raacmm.calibration._result import CalibrationResult
from sklearn_raacmm.measurements import UNITS, Explanation, Measurements
from sklearn_raacmm.utils import Finding, floats, listed

# A change of the arm's scale by the known lengths that has to be explained: as a part, and in
# standard deviations of what cones and table say without them. Real arms with their lengths come to
# 1.0, simulated ones to 1.8, those whose table was measured by tape to 6.7
# (``benchmarks/bench_lengths.py mistakes``).
_CHANGE, _SDS = 0.01, 4.0
# Noise of the cones with lengths over that without from which on the lengths bend the arm.
_BENDS = 2.0
# No known length is known better than this: 0.2 um, and the expansion of steel in 0.04 K.
_BEST_MM, _BEST_SHARE = 2e-4, 5e-7
# What all lengths of a table may be off by, as a part, and a constant that may be missing, mm.
_TABLE, _CONSTANT_MM = 0.03, 100.0


def wrong_lengths(fit, result, bare):
    """The finding that known lengths disagree with one another, or with table and cones.

    `bare` is the fit without them.
    """
    lengths, labels, mask = fit.measured.lengths, fit.measured.labels, bare.mask
    best = [_BEST_MM + _BEST_SHARE * entry[2] for entry in lengths]
    if wrong := [entry for entry, sd in zip(lengths, best, strict=True) if entry[3] < sd]:
        said = ", ".join(f"{_ends(one, labels)} to {one[3]:g} mm" for one in wrong)
        text = f"A length is stated better than any bar is known, and outweighs all: {said}."
        yield Finding("sd-of-lengths", text, "Look at its standard deviation in the certificate.")
    scales = [one.scale @ one.x[: len(one.scale)] for one in (fit, bare)]
    change = scales[0] / scales[1] - 1 if scales[1] > 0 else 0.0
    covariance = bare.covariance()
    covariance = np.where(np.isfinite(covariance), covariance, 0.0)
    scale = np.append(bare.scale, np.zeros(len(mask) - len(bare.scale)))[mask]
    sd, causes, off = np.sqrt(scale @ covariance @ scale), [], 0.0
    if abs(change) > min(_CHANGE, _SDS * sd) or fit.sigma > _BENDS * bare.sigma:
        at = bare.touched(bare.x, mask)
        causes, off = _causes(fit.measured, at, covariance, bare)
    if causes:
        which = "; another known length tells which is right" * (len(causes) > 1)
        size = f"{100 * abs(change):.3g} % {'larger' if change > 0 else 'smaller'}"
        text = (
            f"With the known lengths the arm is {size} than cones and table say (+-{100 * sd:.2g} "
            f"%): {' or '.join(cause for _, cause in causes)}."
        )
        advice = (
            f"Look at the certificate{which}. If the lengths are right, take the arm as it was "
            "calibrated with them (arm.json) as the table."
        )
        yield Finding(causes[0][0], text, advice, "repair", size_mm=off)
        return
    yield from disagreeing(fit.measured, result)


def disagreeing(measured: Measurements, result: CalibrationResult) -> Iterator[Finding]:
    """The finding that known lengths of the measurements disagree with the rest."""
    lengths, labels, errors = measured.lengths, measured.labels, result.length_errors_mm
    wrong = [
        f"{_ends(lengths[k], labels)} is {lengths[k][2] + errors[k]:.6g} mm, given as "
        f"{lengths[k][2]:g} +- {lengths[k][3]:g} mm"
        for k in np.flatnonzero(result.wrong_lengths).tolist()
    ]
    if wrong:
        text = (
            f"{len(wrong)} of {len(lengths)} known lengths disagree with the rest of the data: "
            f"{'; '.join(wrong[:3])}{'; ...' if len(wrong) > 3 else ''}."
        )
        yield Finding("wrong-length", text, size_mm=np.abs(errors).max())


def _causes(measured, at, covariance, bare):
    """The likeliest causes of such lengths, (code, words) each, and by how much these are off, mm.

    None where that they are right is likelier. `at` is what was touched, of the fit without
    lengths, and `covariance` is that of its parameters.
    """
    lengths, labels = measured.lengths, measured.labels
    given, sd = np.array([entry[2:] for entry in lengths], dtype=float).T
    n, explained = len(given), []
    found, slope, sd_of_ends = bare.known(lengths, at)
    # For the centre of the probe, of the sides that fit best.
    sides = zip(found - given, measured.offsets, strict=True)
    given = given + [by[np.argmin(np.abs(off - by))] for off, by in sides]
    covariance = slope @ covariance @ slope.T + np.diag(np.square(sd_of_ends))
    left, every = given - found, np.arange(n)

    def log_likelihood(left, widths=sd, more: float | np.ndarray = 0.0, among=every):
        of, left = (covariance + np.diag(np.square(widths)) + more)[among][:, among], left[among]
        return -0.5 * (left @ np.linalg.solve(of, left) + np.linalg.slogdet(2 * np.pi * of)[1])

    for factor, unit in UNITS.items():
        value = log_likelihood(factor * given - found, factor * sd) + n * np.log(factor)
        what = "unit-of-lengths", f"lengths may be in {unit}"
        explained.append((value - np.log(len(UNITS)), what))
    for k in every:
        value = log_likelihood(left, among=every[every != k])
        said = f"{_ends(lengths[k], labels)} may be {found[k]:.6g} mm, not {given[k]:g}"
        said += (
            "" if measured.features else _other_ends(lengths[k], at[0], labels, covariance[k, k])
        )
        price = np.log(2 * bare.arm().reach_mm) + np.log(n)
        explained.append((value - price, ("wrong-length", said)))
    of_all = [("all lengths of the table may be wrong", _TABLE * found)]
    if n > 1:
        size = f"{abs(left.mean()):.3g} mm too {'short' if left.mean() < 0 else 'long'}"
        missing = f"all may be {size}, as by the diameter of a ball"
        of_all.insert(0, (missing, np.full(n, _CONSTANT_MM)))
    for said, by in of_all:
        value = log_likelihood(left, more=np.outer(by, by))
        explained.append((value, ("wrong-length", said)))
    return Explanation.likeliest(explained, log_likelihood(left)), np.abs(left).max()


def _other_ends(entry, places, labels, variance):
    """Other ends that have a length, in words; empty if it is that of no others."""
    first, second, length, sd = entry
    pairs = [pair for pair in combinations(range(len(places)), 2) if {*pair} & {first, second}]
    off = [abs(np.linalg.norm(places[a] - places[b]) - length) for a, b in pairs]
    limit = _SDS * np.hypot(sd, np.sqrt(variance))
    right = [pairs[i] for i in np.argsort(off) if off[i] < limit]
    # Among many pairs some have any length.
    if not right or len(pairs) * limit > length / 10:
        return ""
    return f" (that is {_ends(right[0], labels)})"


def _ends(entry, labels):
    one, other = (labels[end] for end in entry[:2])
    return f"{one} to {other}" if one != other else f"the size of {one}"


def lengths_of_places(places: Iterable[Sequence[object]]) -> list[Any]:
    """Known lengths between points of known places, wherever their frame stands.

    For a ball plate or a grid of cones with a certificate: where the plate lies need not be known.

    Parameters
    ----------
    places : iterable of (label, x, y, z, standard deviation)
        Position of each point in the frame of the certificate and the standard deviation of a
        coordinate, mm.

    Returns
    -------
    list of (label, label, length, standard deviation)
        Of every pair, as :func:`calibrate` and :func:`learn_correction` take them.

    Raises
    ------
    ValueError
        If an entry is not of this form, there are fewer than two, or one label comes twice.

    Notes
    -----
    Of n points the pairs are not independent. Each is given n / 2 times the variance of its own two
    ends: the sum over the pairs is then that over the points about their mean, so that the scale is
    known as well as a least-squares fit of the plate shows it.

    Examples
    --------
    >>> from sklearn_raacmm import lengths_of_places
    >>> lengths_of_places([("A", 0, 0, 0, 0.003), ("B", 300, 400, 0, 0.004)])
    [('A', 'B', 500.0, 0.005)]
    """
    places = listed("places", places)
    if not all(
        isinstance(entry, tuple | list | np.ndarray) and len(entry) == 5 for entry in places
    ):
        raise ValueError(
            f"each of places must be (label, x, y, z, standard deviation), got {places!r:.60}."
        )
    labels = [entry[0] for entry in places]
    if len(places) < 2 or len(set(labels)) < len(labels):
        raise ValueError(
            f"places need two different labels or more, each once, got {labels!r:.60}."
        )
    values = floats("places", [list(entry[1:]) for entry in places])
    if not np.all(np.isfinite(values)) or not np.all(values[:, 3] > 0):
        raise ValueError("places need finite coordinates and standard deviations above 0, in mm.")
    found = []
    for i, j in combinations(range(len(places)), 2):
        length = float(np.linalg.norm(values[i, :3] - values[j, :3]))
        sd = float(np.hypot(values[i, 3], values[j, 3]) * np.sqrt(len(places) / 2))
        found.append((labels[i], labels[j], length, sd))
    return found
