"""The fitted numbers of a network under their public names."""


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
