"""The fitted numbers of a network under their public names."""

import numpy as np


class FittedNumbers:
    """Attributes of a fitted `RBFNetRegressor`: numbers of its `posterior_` and its `powers_`."""

    def _shaped(self, values):
        """Values whose last axis is the outputs, without it where y had none."""
        return values[..., 0] if self._flat else values

    def _of_outputs(self, values):
        """Values of each output, the last axis, as y had them: first, or without an axis."""
        return values[..., 0] if self._flat else values.T

    @property
    def kernel_(self):
        return self.posterior_.kernel

    @property
    def output_groups_(self):
        return self.posterior_.output_groups

    @property
    def length_scale_(self):
        return self.posterior_.length_scale

    @property
    def centers_(self):
        return self.powers_.inverse(self.posterior_.centers)

    @property
    def lambdas_(self):
        return self.powers_.lambdas

    @property
    def coef_(self):
        return self._of_outputs(self.posterior_.coef)

    @property
    def intercept_(self):
        return self._of_outputs(self.posterior_.polynomial[0])

    @property
    def linear_coef_(self):
        return self._of_outputs(self.posterior_.polynomial[1:])

    @property
    def alpha_(self):
        return self._of_outputs(self.posterior_.alpha * self.posterior_.weight_unit)

    @property
    def noise_variance_(self):
        return self._of_outputs(self.posterior_.noise_variance)

    @property
    def signal_variance_(self):
        return self._of_outputs(self.posterior_.signal_variance)


class GroupNetwork(FittedNumbers):
    """A group of a network's outputs, with the attributes that a network of these alone has.

    Parameters
    ----------
    posterior : NetworkPosterior or ProcessPosterior
    powers : FeaturePowers
    """

    def __init__(self, posterior, powers):
        self.posterior_, self.powers_, self._flat = posterior, powers, False
        self.n_features_in_ = len(posterior.length_scale)


def networks_of(network):
    """A fitted network taken apart into groups of outputs.

    Parameters
    ----------
    network : RBFNetRegressor

    Returns
    -------
    list of (ndarray, FittedNumbers)
        Outputs, and what has the attributes of a network of these; the network itself where all
        outputs are of one group.
    """
    posterior = network.posterior_
    if not hasattr(posterior, "parts"):
        return [(np.arange(len(posterior.alpha)), network)]
    parts = zip(posterior.outputs(), posterior.parts, strict=True)
    return [(of, GroupNetwork(part, network.powers_)) for of, part in parts]
