"""The fitted network whose outputs fall into groups with kernel, widths and centres of their own.

Outputs are independent given these, so that every number of an output is that of its group's
posterior. Here they are put back into the order of the outputs.
"""

from dataclasses import dataclass, replace

import numpy as np

from sklearn_raacmm.network._network_posterior import Posterior
from sklearn_raacmm.utils import check_shapes


@dataclass(frozen=True, eq=False)
class GroupedPosterior:
    """Posteriors of groups of outputs, seen as one.

    It has the methods of `NetworkPosterior`, and its attributes as far as they are of all outputs.
    `kernel` and `length_scale` have one entry or row an output; `centers` are those of the groups,
    one group after another, and `coef` is 0 where a centre is another group's.

    Attributes
    ----------
    parts : tuple of NetworkPosterior or ProcessPosterior
        Of the groups.

    output_groups : ndarray of shape (q,)
        Group of every output, a number from 0. Outputs of a group are in the same order in its
        part.
    """

    parts: tuple
    output_groups: np.ndarray

    def __setstate__(self, state):
        vars(self).update(state)
        name = type(self).__name__
        check_shapes(name, state, {"output_groups": ("q",)}, {})
        parts = self.parts
        if not isinstance(parts, tuple) or not all(isinstance(p, Posterior) for p in parts):
            raise ValueError(f"The file is damaged: parts of {name} are no posteriors.")
        sizes, groups = [len(part.alpha) for part in parts], self.output_groups
        fits = groups.dtype.kind == "i" and len(groups) and groups.min() >= 0
        if not fits or np.bincount(groups, minlength=len(parts)).tolist() != sizes:
            raise ValueError(
                f"The file is damaged: output_groups of {name} are {groups.tolist()}, where its "
                f"parts have {sizes} outputs."
            )
        features = [len(part.length_scale) for part in parts]
        if min(features) != max(features):
            raise ValueError(f"The file is damaged: parts of {name} have {features} features.")

    def outputs(self):
        """Outputs of every group, as arrays."""
        return [np.flatnonzero(self.output_groups == i) for i in range(len(self.parts))]

    def _placed(self, values, axis=-1):
        """Arrays of the groups' outputs along an axis, in the order of all outputs."""
        order = np.argsort(np.concatenate(self.outputs()))
        return np.take(np.concatenate(values, axis=axis), order, axis=axis)

    def _of_parts(self, name):
        return self._placed([getattr(part, name) for part in self.parts])

    @property
    def kernel(self):
        return np.array([self.parts[i].kernel for i in self.output_groups])

    @property
    def length_scale(self):
        return np.stack([self.parts[i].length_scale for i in self.output_groups])

    @property
    def centers(self):
        return np.concatenate([part.centers for part in self.parts])

    @property
    def coef(self):
        coef = np.zeros((len(self.centers), len(self.output_groups)))
        start = 0
        for of, part in zip(self.outputs(), self.parts, strict=True):
            coef[start : start + len(part.centers), of] = part.coef
            start += len(part.centers)
        return coef

    @property
    def weight_unit(self):
        return self.parts[0].weight_unit

    @property
    def polynomial(self):
        return self._of_parts("polynomial")

    @property
    def alpha(self):
        return self._of_parts("alpha")

    @property
    def noise_variance(self):
        return self._of_parts("noise_variance")

    @property
    def signal_variance(self):
        return self._of_parts("signal_variance")

    def with_noise(self, factor):
        """The same with a larger variance of the noise, see `Posterior`."""
        return replace(self, parts=tuple(part.with_noise(factor) for part in self.parts))

    def predict(self, X, return_std=False, with_noise=True):
        """Mean, and standard deviation or None, (n, q) each."""
        means, stds = zip(*(p.predict(X, return_std, with_noise) for p in self.parts), strict=True)
        return self._placed(means), self._placed(stds) if return_std else None

    def covariance(self, X, with_noise=True):
        """Covariance of predictions at some rows, (n, n, q)."""
        return self._placed([part.covariance(X, with_noise) for part in self.parts])

    def sample(self, X, n_samples, rng, with_noise=True):
        """Draws from the posterior at some rows, (n, q, n_samples)."""
        draws = [part.sample(X, n_samples, rng, with_noise) for part in self.parts]
        return self._placed(draws, axis=1)

    def gradient(self, X, of_variance=False):
        """Derivatives of the mean, and of the variance or None, (n, q, d) each."""
        found = [part.gradient(X, of_variance) for part in self.parts]
        of_mean, by_variance = zip(*found, strict=True)
        return self._placed(of_mean, 1), self._placed(by_variance, 1) if of_variance else None
