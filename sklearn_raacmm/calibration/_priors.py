"""What is known of an arm before any measurement: where all that finds its parameters starts."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

# What machining leaves of a length, mm, and the matching angle, rad. They hold where few rows say
# little; `calibrate` replaces them by what the evidence says (benchmarks/bench_calibrate.py).
LENGTH_MM, ANGLE_RAD = 0.3, 0.003
# What counts as knowing nothing of the place of base and probe, mm at the probe. Any larger number
# gives the same: nine freedoms that a few poses determine.
UNKNOWN_PLACE_MM = 1000.0
# How far base and tool may be from where they were registered, mm at the probe: six times what the
# worst way of registering leaves in benchmarks/bench_after_the_lab.py.
REGISTERED_PLACE_MM = 5.0
