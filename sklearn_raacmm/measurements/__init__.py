"""What was measured, and what is to be said about it."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.measurements._moved_seats import find_steps, warn_of_moved_seats

__all__ = ["find_steps", "warn_of_moved_seats"]
