"""Features that a probe touched: forms, what touches show of them, and slips."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from sklearn_raacmm.measurements import Features
from sklearn_raacmm.metrics import fit_sphere


def touches(kind, n=12, noise=0.005, seed=0, part=1.0):
    """Simulated touches (n, 3) mm and the true normal at each (n, 3)."""
    rng = np.random.default_rng(seed)
    if kind == "sphere":
        height, turn = 1 - part * rng.random(n), rng.uniform(0, 2 * np.pi, n)
        across = np.sqrt(1 - height**2)
        normal = np.column_stack([across * np.cos(turn), across * np.sin(turn), height])
        points = 15 * normal
    else:
        points = np.column_stack([rng.uniform(-50, 50, (n, 2)), np.zeros(n)])
        normal = np.tile([0.0, 0.0, 1.0], (n, 1))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = points + rng.normal(0, noise, (n, 3))
    return points @ turn + rng.normal(0, 300, 3), normal @ turn


def linearised(kind, points):
    """Touches of one feature, all of which count alike."""
    touched = Features([kind], np.zeros(len(points), dtype=int))
    return touched.linearised(points, np.ones(len(points)))


@pytest.mark.parametrize("kind", ["cone", "plane", "sphere"])
def test_unknowns_are_the_derivatives_of_the_form(kind):
    """Moving a feature by its unknowns moves the nearest points as a search of it anew says."""
    points, _ = touches(kind, 20)
    rows = linearised(kind, points)
    q = 4 if kind == "sphere" else 3
    assert rows.unknowns.shape == (20, 3, q)
    along = rows.directions @ rows.residual[:, :, None]
    assert_allclose(along[:, :, 0], rows.residual, atol=1e-12)
    step = 1e-4 * np.random.default_rng(1).normal(size=q)
    if kind == "plane":
        step[1:] /= 50  # rad
    moved = linearised(kind, points + rows.unknowns @ step)
    seen = rows.directions @ (moved.residual - rows.residual)[:, :, None]
    assert np.abs(seen).max() < 2e-3 * np.abs(step).max()


def test_forms_are_those_of_least_squares():
    """Against the sphere of `metrics` and a search of the plane by its angles."""
    points, _ = touches("sphere", 25)
    rows = linearised("sphere", points)
    _, radius, distances = fit_sphere(points)
    assert_allclose(np.linalg.norm(rows.residual, axis=1), np.abs(distances - radius), atol=1e-9)
    points, _ = touches("plane", 25)
    rows = linearised("plane", points)

    def off(x):
        normal = np.array([np.sin(x[0]) * np.cos(x[1]), np.sin(x[0]) * np.sin(x[1]), np.cos(x[0])])
        return points @ normal - x[2]

    normal = rows.directions[0][:, 0] / np.sqrt(rows.directions[0][0, 0])
    start = [np.arccos(normal[2]) + 0.1, np.arctan2(normal[1], normal[0]) + 0.1, 0.0]
    start[2] = points.mean(axis=0) @ normal
    found = least_squares(off, start, xtol=1e-14, ftol=1e-14, gtol=1e-14, x_scale="jac").fun
    assert_allclose(np.square(rows.residual).sum(), found @ found, rtol=1e-6)


def test_features_are_linearised_together_as_each_alone():
    kinds, n = ["sphere", "cone", "plane", "sphere", "plane"], (9, 6, 20, 12, 7)
    each = [touches(kind, k, seed=i)[0] for i, (kind, k) in enumerate(zip(kinds, n, strict=True))]
    codes = np.repeat(np.arange(5), n)
    order = np.random.default_rng(0).permutation(len(codes))
    whole = Features(kinds, codes[order])
    rows = whole.linearised(np.concatenate(each)[order], np.ones(len(codes)))
    assert rows.unknowns.shape == (54, 3, 4)
    for code, (kind, points) in enumerate(zip(kinds, each, strict=True)):
        own = np.argsort(order)[codes == code]
        alone = linearised(kind, points)
        assert_allclose(rows.residual[own], alone.residual, atol=1e-9)
        assert_allclose(rows.directions[own], alone.directions, atol=1e-9)
        q = alone.unknowns.shape[2]
        assert not rows.unknowns[own][:, :, q:].any()
        both = [np.einsum("nip,njp->nij", b, b) for b in (rows.unknowns[own], alone.unknowns)]
        assert_allclose(both[0], both[1], atol=1e-6)  # axes in a plane may be turned


def test_slips_take_no_part_in_a_first_fit():
    """Three of twelve touches lie off by 40 times the noise."""
    rng, kept = np.random.default_rng(0), 0
    for seed in range(40):
        kind = ("plane", "sphere")[seed % 2]
        points, normal = touches(kind, seed=seed)
        slipped = rng.choice(12, 3, replace=False)
        points[slipped] += rng.choice([-0.2, 0.2], (3, 1)) * normal[slipped]
        weights = Features([kind], np.zeros(12, dtype=int)).weights(points)
        kept += bool(weights[slipped].any())
    assert kept <= 1


def test_touches_on_too_small_a_part_are_named():
    """A cap of 2 degrees and a line show neither a sphere nor a plane; half a sphere does."""
    cap, _ = touches("sphere", 25, part=6e-4)
    half, _ = touches("sphere", 25)
    plane, _ = touches("plane", 25)
    line = np.outer(np.linspace(0, 100, 25), [1.0, 2.0, 2.0]) / 3
    line += np.random.default_rng(0).normal(0, 0.005, line.shape)
    names = ("cap", "ball", "plate", "edge", "one")
    parts = [cap, half, plane, line, half[:3]]
    kinds = ["sphere", "sphere", "plane", "plane", "sphere"]
    touched = Features(kinds, np.repeat(np.arange(5), [len(part) for part in parts]))
    found = list(touched.findings(np.concatenate(parts), names))
    assert [f.positions for f in found] == [("cap",), ("edge",)]
    assert {f.code for f in found} == {"touches-alike"}
    assert "was touched on a small cap only" in found[0].text
    (few,) = touched.few(names)
    assert (few.code, few.positions) == ("few-touches", ("one",))
    assert "3 touches, but 4 numbers" in few.text
