"""Known lengths that disagree: with one another, with the cones, or with the arm's table."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from sklearn_raacmm.arm import reach_mm
from sklearn_raacmm.measurements import UNITS, likeliest
from sklearn_raacmm.utils import Finding

# Standard deviations of a known length beyond which it disagrees: once in 1.7 million.
_LENGTH_OUTLIER = 5.0
# A change of the arm's scale by the known lengths that has to be explained: as a part, and in
# standard deviations of what cones and table say without them. Real arms with their lengths come to
# 1.0, simulated ones to 1.8, those whose table was measured by tape to 6.7
# (``benchmarks/bench_lengths.py mistakes``).
_CHANGE, _SDS = 0.01, 4.0
# Noise of the cones with lengths over that without from which on the lengths bend the arm.
_BENDS = 2.0
# What all lengths of a table may be off by, as a part, and a constant that may be missing, mm.
_TABLE, _CONSTANT_MM = 0.03, 100.0


def are_wrong(lengths: Sequence[Sequence[Any]], errors: np.ndarray, sigma: float) -> np.ndarray:
    """Which known lengths disagree with the rest of the data, (n_lengths,) of bool.

    What calibration leaves is much the same in all poses of a position: an end is no better known
    than by one of its points.
    """
    sd = np.array([float(entry[3]) for entry in lengths])
    return np.abs(errors) > _LENGTH_OUTLIER * np.hypot(sd, np.sqrt(2) * sigma)


def wrong_lengths(fit, bare, labels):
    """The finding that known lengths disagree with one another, or with table and cones.

    `bare` is the fit without them; `labels` name the positions.
    """
    lengths = fit.problem.lengths
    scales = [one.scale @ one.x[: len(one.scale)] for one in (fit, bare)]
    change = scales[0] / scales[1] - 1 if scales[1] > 0 else 0.0
    sd, found, covariance, places = _as_cones_say(bare, lengths)
    code, causes = "", []
    if abs(change) > min(_CHANGE, _SDS * sd) or fit.sigma > _BENDS * bare.sigma:
        code, causes = _causes(lengths, found, covariance, places, reach_mm(bare.arm()), labels)
    if code:
        which = "; another known length tells which is right" * (len(causes) > 1)
        size = f"{100 * abs(change):.3g} % {'larger' if change > 0 else 'smaller'}"
        yield Finding(
            code,
            f"With the known lengths the arm is {size} than cones and table say (+-{100 * sd:.2g} "
            f"%): {' or '.join(causes)}.",
            f"Look at the certificate{which}. If the lengths are right, take the arm as it was "
            "calibrated with them (arm.json) as the table.",
            "repair",
            size_mm=np.abs(found - [entry[2] for entry in lengths]).max(),
        )
        return
    errors = fit.length_errors()
    wrong = [
        f"{_ends(entry, labels)} is {entry[2] + error:.6g} mm, given as {entry[2]:g} +- "
        f"{entry[3]:g} mm"
        for entry, error, out in zip(
            lengths, errors, are_wrong(lengths, errors, fit.sigma), strict=True
        )
        if out
    ]
    if wrong:
        text = (
            f"{len(wrong)} of {len(lengths)} known lengths disagree with the rest of the data: "
            f"{'; '.join(wrong[:3])}{'; ...' if len(wrong) > 3 else ''}."
        )
        yield Finding("wrong-length", text, size_mm=np.abs(errors).max())


def _as_cones_say(bare, lengths):
    """Standard deviation of the scale, lengths (k,) and their covariance by a fit without lengths.

    And the fixed points (n_points, 3) of the fit.
    """
    mask = bare.free_mask(bare.is_free)
    covariance = bare.covariance(mask)
    covariance = np.where(np.isfinite(covariance), covariance, 0.0)
    scale = np.zeros(len(mask))
    scale[: len(bare.scale)] = bare.scale
    sd = float(np.sqrt(scale[mask] @ covariance @ scale[mask]))
    _, _, places, columns = bare.data_residuals(bare.x, mask)
    one, other = np.array([entry[:2] for entry in lengths]).T
    gap = places[one] - places[other]
    found = np.maximum(np.linalg.norm(gap, axis=1), 1e-12)
    slope = np.einsum("kc,kcp->kp", gap / found[:, None], columns[one] - columns[other])
    # What the table does not explain is much the same in all poses of one position.
    noise = 2 * bare.sigma**2 * np.eye(len(found))
    return sd, found, slope @ covariance @ slope.T + noise, places


def _causes(lengths, found, covariance, places, reach, labels):
    """Code of the likeliest cause of such lengths, and in words all that are as likely.

    No code where that they are right is likelier.
    """
    given, sd = (np.array([entry[i] for entry in lengths], dtype=float) for i in (2, 3))
    n, explained = len(given), []

    def log_likelihood(left: Any, widths: Any = sd, among: Any = None, more: Any = 0.0) -> Any:
        some = slice(None) if among is None else among
        of = (covariance + np.diag(np.square(widths)) + more)[some][:, some]
        left = left[some]
        return -0.5 * (left @ np.linalg.solve(of, left) + np.linalg.slogdet(2 * np.pi * of)[1])

    for factor, unit in UNITS.items():
        value = log_likelihood(factor * given - found, factor * sd) + n * np.log(factor)
        explained.append((value - np.log(len(UNITS)), f"lengths may be in {unit}"))
    left, every = given - found, np.arange(n)
    for k in every:
        value = log_likelihood(left, among=every != k) - np.log(2 * reach) - np.log(n)
        said = f"{_ends(lengths[k], labels)} may be {found[k]:.6g} mm, not {given[k]:g}"
        explained.append((value, said + _other_ends(lengths[k], places, labels, covariance[k, k])))
    if n > 1:
        value = log_likelihood(left, more=_CONSTANT_MM**2)
        missing = f"all may be {left.mean():.3g} mm too long"
        if left.mean() < 0:
            missing = f"all may be {-left.mean():.3g} mm too short"
        explained.append((value, f"{missing}, as by the diameter of a ball"))
    value = log_likelihood(left, more=_TABLE**2 * np.outer(found, found))
    explained.append((value, "all lengths of the table may be wrong"))
    causes = likeliest(explained, log_likelihood(left))
    if not causes:
        return "", []
    in_unit = causes[0].startswith("lengths may be in")
    return "unit-of-lengths" if in_unit else "wrong-length", causes


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
    return f"{labels[entry[0]]} to {labels[entry[1]]}"
