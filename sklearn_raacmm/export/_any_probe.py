"""A fitted model of an arm that takes the vector of the probe with every row."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.error_model import ArmResidualRegressor
from sklearn_raacmm.export._steps import check_fitted, typical_rows

# Lengths of the probes of test rows, of that of the model's own (or of 100 mm).
_LENGTHS = (0.5, 4.0)


class AnyProbe:
    """What an export of `any_probe` is compared with. Refuses models that cannot be moved."""

    def __init__(self, model):
        check_fitted(model)
        if not isinstance(model, ArmResidualRegressor):
            raise ValueError(
                "any_probe=True needs an ArmResidualRegressor: others have seen one probe only."
            )
        if any(name.startswith("temperature") for name, _ in model.linear_model_.terms.extra):
            raise ValueError(
                "any_probe=True does not go with temperatures, by which a probe grows in "
                "proportion to its length: export a model for each probe, model.with_arm(arm)."
            )
        self.model = model

    def rows(self, poses=None):
        """Rows of the model with a probe each, between half and four times as long as its own."""
        poses = typical_rows(self.model, 200) if poses is None else np.asarray(poses, dtype=float)
        own = self.model.arm_.probe
        own = own if own.any() else np.array([0.0, 0.0, 100.0])
        rng = np.random.default_rng(0)
        vectors = own * rng.uniform(*_LENGTHS, (len(poses), 1))
        vectors += 0.2 * np.linalg.norm(own) * rng.normal(size=vectors.shape)
        return np.hstack([poses, vectors])

    def predict(self, X, return_std=False):
        """What the moved model gives at every row."""
        found = []
        for row in X:
            moved = self.model.with_arm(self.model.arm_.replace(probe=row[-3:]))
            found.append(np.reshape(moved.predict(row[None, :-3], return_std), (1 + return_std, 3)))
        found = np.stack(found, axis=1)
        return tuple(found) if return_std else found[0]
