"""How much wider intervals have to be, against errors that were drawn and SciPy's own fit."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm as normal
from scipy.stats import t as student

from sklearn_raacmm.error_model import interval_scales


@pytest.mark.parametrize("freedom", [3, 100])
def test_scales_are_found(freedom):
    """Errors of known scales, drawn: intervals of 95 % hold 95 % of them."""
    rng = np.random.default_rng(0)
    noise, std = np.full((3000, 3), 0.01), rng.uniform(0.001, 0.03, (3000, 3))
    scale = np.sqrt(0.5 * noise**2 + 6.0 * std**2)
    errors = scale * rng.standard_t(freedom, (3000, 3))
    of_noise, of_std = interval_scales(errors, noise, std, np.ones(3000))
    width = np.sqrt((of_noise * noise) ** 2 + (of_std * std) ** 2)
    assert np.mean(np.abs(errors) < 1.96 * width) == pytest.approx(0.95, abs=0.01)
    assert of_std / of_noise == pytest.approx(np.sqrt(12), rel=0.3)
    once = interval_scales(errors[:500], noise[:500], std[:500], np.full(500, 2.0))
    twice = np.r_[0:500, 0:500]
    again = interval_scales(errors[twice], noise[twice], std[twice], np.ones(1000))
    assert_allclose(once, again, rtol=1e-2)


def test_prior_of_the_scale_gives_way_to_what_is_shown():
    """Deviations that noise hides leave the factor at its prior; clear ones find their own."""
    rng = np.random.default_rng(0)
    noise, std, ones = np.full((900, 3), 0.01), np.full((900, 3), 0.001), np.ones(900)
    errors = rng.normal(scale=0.01, size=(900, 3))
    of_noise, hidden = interval_scales(errors, noise, std, ones, 0.05, 0.7)
    assert of_noise == pytest.approx(1.0, abs=0.1)
    assert hidden / of_noise == pytest.approx(np.exp(0.35), rel=0.1)
    errors = rng.normal(scale=0.01, size=(900, 3))
    _, shown = interval_scales(errors, noise / 1000, 2 * noise, ones, 0.5, 0.7)
    assert shown == pytest.approx(0.5, rel=0.1)


def test_scale_and_tails_are_those_that_scipy_fits():
    """Noise alone: the factor is that of the most likely Student variable, found by SciPy."""
    errors = 0.02 * np.random.default_rng(0).standard_t(5, (1500, 3))
    freedom, _, scale = student.fit(errors.ravel(), floc=0)
    noise = np.full(errors.shape, 0.01)
    found, _ = interval_scales(errors, noise, np.zeros(errors.shape), np.ones(1500))
    # The prior pulls a little towards normal errors.
    width = student.ppf(0.975, freedom) / normal.ppf(0.975) * scale
    assert 0.01 * found == pytest.approx(width, rel=0.01)
