"""What is known of an arm before any measurement: where all that finds its parameters starts."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

# What machining leaves of a length, mm, and the matching angle, rad, where few rows say little
# (benchmarks/bench_calibrate.py).
LENGTH_MM, ANGLE_RAD = 0.3, 0.003
# What `calibrate` starts from: standard deviation, how many parameters it is worth, and its bounds.
# Of long lengths, of short ones, and of angles (benchmarks/bench_lengths.py scale).
LONG_MM, SHORT_MM, ANGLES_RAD = (
    (0.4, 1.0, 0.01, 10.0),
    (0.3, 4.0, 0.01, 100.0),
    (0.003, 4.0, 1e-4, 0.02),
)
# A long length has at least this part of the longest.
_LONG_SHARE = 0.25
# What counts as knowing nothing of the place of base and probe, mm at the probe. Any larger number
# gives the same: nine freedoms that a few poses determine.
UNKNOWN_PLACE_MM = 1000.0
# How far base and tool may be from where they were registered, mm at the probe: six times what the
# worst way of registering leaves in benchmarks/bench_after_the_lab.py.
REGISTERED_PLACE_MM = 5.0


def are_long(lengths):
    """Which of the lengths of a table carry its scale, (n,); mm."""
    size = np.abs(lengths)
    return size >= _LONG_SHARE * size.max()
