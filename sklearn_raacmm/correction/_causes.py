"""Causes that were written down with the poses, and those that the order of the rows tells."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Mapping
from typing import Any

import numpy as np

from sklearn_raacmm.error_model import check_extra
from sklearn_raacmm.measurements import MOST_EXPLAINED, directions_of, order_explained_by
from sklearn_raacmm.utils import floats


def checked_causes(extra, in_order, angles, codes):
    """Names and values (n, n_causes) of the causes offered to a model, for angles in rad.

    Where the rows are in the order of measurement, directions are offered, too. Time that the
    angles explain is refused: what it explains may be the place.
    """
    given = _given(extra, len(angles))
    names = check_extra(tuple(given), angles.shape[1])
    values = [given[name] for name in names]
    if in_order:
        ways = directions_of(angles)
        others = [f"direction {joint + 1}" for joint in range(angles.shape[1])]
        values += [ways[:, i] for i, name in enumerate(others) if name not in names]
        names += tuple(name for name in others if name not in names)
    if "time" in names and (explained := order_explained_by(angles, codes)) > MOST_EXPLAINED:
        raise ValueError(
            f"time cannot be learnt from this run: the angles explain the number of the row (R2 "
            f"{explained:.2f}, at most {MOST_EXPLAINED}), so that time and place are not apart. "
            "Measure the positions in mixed order, or leave time out."
        )
    return names, np.column_stack(values) if values else np.empty((len(angles), 0))


def _given(extra, n_rows):
    """Causes that somebody gave by their names, (n_rows,) each; one number counts for all rows."""
    if extra is not None and not isinstance(extra, Mapping):
        raise ValueError(f"extra must be a dict of names and values, got {extra!r:.60}.")
    found = {}
    for name, value in (extra or {}).items():
        said = f"extra[{name!r}]"
        values = floats(said, value, finite=True)
        if values.shape not in ((), (n_rows,), (n_rows, 1)):
            raise ValueError(f"{said} must have shape ({n_rows},), got {values.shape}.")
        found[name] = np.broadcast_to(values.ravel(), n_rows)
    return found


def usual_values(names, values):
    """What counts where a cause is not known: the mean, of time the last value, no direction."""
    usual = {}
    for name, column in zip(names, values.T, strict=True):
        kind = name.split()[0]
        usual[name] = float({"time": column[-1], "direction": 0.0}.get(kind, column.mean()))
    return usual


def with_causes(angles: Any, usual: dict[str, Any], extra: Any = None) -> Any:
    """Angles (n, n_joints) in rad with the columns of the causes that a model has.

    `usual` names these, with what counts where `extra` does not have them.
    """
    given = _given(extra, len(angles))
    unknown = [name for name in given if name not in usual]
    if unknown:
        raise ValueError(
            f"extra names {unknown[0]!r}, of which the model knows nothing; it was fitted with "
            f"{', '.join(usual) or 'none'}."
        )
    columns = [
        np.broadcast_to(given.get(name, value), len(angles)) for name, value in usual.items()
    ]
    return np.column_stack([angles, *columns])
