"""Chunks, order of labels, messages; robust scales and Tukey's weights beside closed forms."""

import logging
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.utils import Groups, _rows, chunks, robust_scale, stage, tukey_weights


@pytest.mark.parametrize("limit", [None, 3])
@pytest.mark.parametrize("n_rows", [0, 1, 9, 10, 11])
@pytest.mark.parametrize("size", [0, 1, 5, 100])  # of 0 where a row alone is above the caller's aim
def test_chunks_hold_each_row_once(n_rows, size, limit, monkeypatch):
    monkeypatch.setattr(_rows, "LIMIT", limit)
    parts = list(chunks(n_rows, size))
    assert np.concatenate([np.arange(100)[p] for p in parts] or [[]]).tolist() == [*range(n_rows)]
    assert all(0 < p.stop - p.start <= min(max(size, 1), limit or 100) for p in parts)


def test_a_fit_says_how_far_it_is_to_those_who_listen(caplog, capsys):
    X = np.random.default_rng(0).uniform(-1, 1, (60, 2))
    with caplog.at_level(logging.INFO, logger="sklearn_raacmm"):
        RBFNetRegressor(max_centers=5, random_state=0).fit(X, X[:, 0])
    lines = [record.getMessage() for record in caplog.records]
    stages = [line.split(":")[0] for line in lines]
    assert stages == ["widths of the network", "centres of the network"]
    assert all(line.endswith(" s") for line in lines)
    assert capsys.readouterr().out == ""


def test_two_runs_that_differ_show_from_which_stage_on(caplog):
    """The first stage, the widths, knows nothing of the number of centres."""
    X, lines = np.random.default_rng(0).uniform(-1, 1, (60, 2)), []
    for n_centers in (5, 5, 6):
        caplog.clear()
        with caplog.at_level(logging.DEBUG, logger="sklearn_raacmm"):
            RBFNetRegressor(n_centers, random_state=0).fit(X, X[:, 0])
        debug = [record for record in caplog.records if record.levelno == logging.DEBUG]
        lines.append([record.getMessage() for record in debug])
    assert lines[0] == lines[1]
    assert [one == other for one, other in zip(lines[0], lines[2], strict=True)] == [True, False]
    assert all("root mean square" in line for line in lines[0])
    assert lines[0][1].endswith(", by network._fit.fit_network")


def test_a_stage_that_returns_nothing_shows_what_it_has_kept(caplog):
    class Part:
        @stage("signs", "found", "part.sizes")
        def find(self, sign):
            self.found, self.part = (
                {"coef": sign * np.ones(2)},
                SimpleNamespace(sizes=[3.0, np.nan]),
            )

        @stage("nothing")
        def rest(self):
            pass

    with caplog.at_level(logging.DEBUG, logger="sklearn_raacmm"):
        Part().find(1.0)
        Part().find(-1.0)
        Part().rest()
    plus, minus, nothing = [r.getMessage() for r in caplog.records if r.levelno == logging.DEBUG]
    size = f"root mean square {np.sqrt(11 / 3):.12g}"
    assert plus.startswith(f"signs: 3 numbers, mean {5 / 3:.12g}, {size}, by ")
    assert minus.startswith(f"signs: 3 numbers, mean {1 / 3:.12g}, {size}, by ")
    assert nothing.startswith("nothing: 0 numbers, mean 0, root mean square 0")


def test_labels_are_in_the_order_of_their_numbers():
    labels = ["cone 10", "cone 2", "b", "a 1 x 3", "a 1 x 20", 7]
    assert [labels[i] for i in Groups.in_order(labels)] == [
        7, "a 1 x 3", "a 1 x 20", "b", "cone 2", "cone 10",
    ]  # fmt: skip


def errors(n, q, seed=0, n_far=0):
    """Normal errors of standard deviation 0.3, of which some are ten times as large."""
    found = np.random.default_rng(seed).normal(0, 0.3, (n, q))
    found[:n_far] *= 10
    return found


@pytest.mark.parametrize("q", [1, 2, 3, 6])
def test_scale_of_normal_errors(q):
    found = robust_scale(np.linalg.norm(errors(200_000, q), axis=1), q)
    assert found == pytest.approx(0.3, rel=0.01)
    # Half of the distances are below it by definition.
    assert robust_scale(chi.ppf([0.2, 0.5, 0.9], q), q) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("n", [9, 10])
def test_weights_are_repeats(n):
    rng = np.random.default_rng(1)
    distances, weights = rng.uniform(size=n), rng.integers(0, 4, n)
    repeated = robust_scale(np.repeat(distances, weights), 3)
    assert robust_scale(distances, 3, weights) == pytest.approx(repeated, rel=1e-14)
    assert robust_scale(distances, 3, 0.7 * weights) == pytest.approx(repeated, rel=1e-14)
    assert robust_scale(distances, 3, np.ones(n)) == robust_scale(distances, 3)


def test_scale_does_not_mind_a_few_that_are_far_off():
    clean = np.linalg.norm(errors(500, 3), axis=1)
    dirty = np.r_[clean, np.full(20, 1e300)]
    assert robust_scale(dirty, 3) == pytest.approx(robust_scale(clean, 3), rel=0.05)


@pytest.mark.parametrize("q", [1, 3, 6])
def test_weights_are_the_closed_form(q):
    residuals = errors(300, q, n_far=15)
    distances = np.linalg.norm(residuals, axis=1)
    cut = 5.5 * np.median(distances) / chi.median(q)
    expected = [(1 - (d / cut) ** 2) ** 2 if d < cut else 0.0 for d in distances]
    found = tukey_weights(residuals)
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-15)
    assert np.count_nonzero(found == 0) >= 5
    assert found[15:].min() > 0
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(q, q)))[0]
    assert tukey_weights(residuals @ turn) == pytest.approx(found, rel=1e-10, abs=1e-12)
    assert tukey_weights(1e-150 * residuals) == pytest.approx(found, rel=1e-10, abs=1e-12)


def test_all_rows_count_fully_while_none_is_far_off():
    residuals = errors(200, 3)
    assert tukey_weights(residuals).tolist() == [1.0] * 200
    weighed = tukey_weights(residuals, weighed=True)
    assert 0.2 < weighed.min() < weighed.max() < 1
    assert tukey_weights(errors(200, 3, n_far=1), least_scale=3.0).tolist() == [1.0] * 200


def test_rows_without_weight_decide_nothing():
    residuals, weights = errors(40, 3), np.ones(40)
    residuals[:25] *= 100
    weights[:25] = 0
    found = tukey_weights(residuals, weights)
    assert found.tolist() == [1.0] * 40
    assert np.all(tukey_weights(residuals, weights, weighed=True)[:20] < 0.5)


def test_rows_that_are_met_exactly_have_no_scale():
    residuals = np.zeros((9, 3))
    residuals[:4] = 1.0
    assert tukey_weights(residuals).tolist() == [1.0] * 9
    assert tukey_weights(residuals, least_scale=0.1).tolist() == [0.0] * 4 + [1.0] * 5


def test_slips_are_those_of_every_round():
    """Groups without a far row are passed over: the weights are those of all rounds in all."""
    rng = np.random.default_rng(0)
    values = rng.standard_t(2.5, size=(300, 3))
    values[rng.random(300) < 0.03] *= 20
    codes = rng.integers(0, 30, 300)
    groups = [np.flatnonzero(codes == code) for code in range(30)]
    far = [np.linalg.norm(values[of] - np.median(values[of], axis=0), axis=1) for of in groups]
    usual, expected = robust_scale(np.concatenate(far), 3), np.ones(300)
    for of, away in zip(groups, far, strict=True):
        centre = np.median(values[of], axis=0)
        for _ in range(5):
            scale = 2 * max(usual, robust_scale(away, 3))
            expected[of] = tukey_weights(values[of] - centre, least_scale=scale)
            centre = np.average(values[of], axis=0, weights=expected[of])
    found = Groups(codes).slip_factors(values)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert 0 < np.count_nonzero([found[of].min() < 1 for of in groups]) < 30
