import logging

import numpy as np
import pytest

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.utils import _rows, chunks, natural_order


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


def test_labels_are_in_the_order_of_their_numbers():
    labels = ["cone 10", "cone 2", "b", "a 1 x 3", "a 1 x 20", 7]
    assert [labels[i] for i in natural_order(labels)] == [
        7, "a 1 x 3", "a 1 x 20", "b", "cone 2", "cone 10",
    ]  # fmt: skip
