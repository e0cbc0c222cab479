"""What the displays share: checks, axes, and a style."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from sklearn.utils.validation import check_is_fitted

# Colours of Okabe and Ito, which colour-blind readers tell apart; shapes differ as well.
AFTER = {"color": "#0072B2", "marker": "D", "linestyle": "", "markersize": 5}


def check_model(estimator):
    """Refuse what is no fitted model."""
    if not hasattr(estimator, "predict"):
        raise TypeError(f"estimator must be a fitted model, got {estimator!r:.60}.")
    check_is_fitted(estimator)


def axes_grid(axes, shape, **options):
    """Given axes in this shape, or new ones."""
    if axes is None:
        try:
            import matplotlib.pyplot as plt
        except ImportError:
            raise ImportError("Displays need matplotlib: pip install matplotlib.") from None
        return plt.subplots(*shape, squeeze=False, layout="constrained", **options)[1]
    axes = np.asarray(axes, dtype=object)
    if axes.size != np.prod(shape):
        raise ValueError(f"{axes.size} axes were given, but {np.prod(shape)} are needed.")
    for ax in axes.flat:
        if not hasattr(ax, "axhline"):
            raise TypeError(f"Axes of matplotlib are needed to draw on, got {ax!r:.60}.")
    return axes.reshape(shape)
