import logging

import numpy as np
import pytest

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.utils import _chunks, check_whole_number, chunks, html_table, natural_order


@pytest.mark.parametrize("limit", [None, 3])
@pytest.mark.parametrize("n_rows", [0, 1, 9, 10, 11])
@pytest.mark.parametrize("size", [0, 1, 5, 100])  # of 0 where a row alone is above the caller's aim
def test_chunks_hold_each_row_once(n_rows, size, limit, monkeypatch):
    monkeypatch.setattr(_chunks, "LIMIT", limit)
    parts = list(chunks(n_rows, size))
    assert np.concatenate([np.arange(100)[p] for p in parts] or [[]]).tolist() == [*range(n_rows)]
    assert all(0 < p.stop - p.start <= min(max(size, 1), limit or 100) for p in parts)


@pytest.mark.parametrize("value", [2, np.int8(3), np.uint64(4)])
def test_whole_numbers(value):
    assert type(check_whole_number("n", value, 2, 4)) is int


@pytest.mark.parametrize("value", [1, 5, 2.0, np.float64(3), "3", True, np.True_, None, [3]])
def test_what_is_no_whole_number_within_the_bounds(value):
    with pytest.raises(ValueError, match=r"^n must be a whole number from 2 to 4, got "):
        check_whole_number("n", value, 2, 4)


def test_no_upper_bound():
    assert check_whole_number("n", 10**30, 2) == 10**30
    with pytest.raises(ValueError, match=r"^n must be a whole number of at least 2, got -1\.$"):
        check_whole_number("n", -1, 2)


def test_html_is_escaped():
    html = html_table("<b>", ["<i>"], [["<script>", 1]])
    assert not any(tag in html for tag in ("<b>", "<i>", "<script>"))
    assert html.count("<td>") == 2


def test_a_fit_says_how_far_it_is_to_those_who_listen(caplog, capsys):
    X = np.random.default_rng(0).uniform(-1, 1, (60, 2))
    with caplog.at_level(logging.INFO, logger="sklearn_raacmm"):
        RBFNetRegressor(max_centers=5, random_state=0).fit(X, X[:, 0])
    lines = [record.getMessage() for record in caplog.records]
    assert [line.split(":")[0] for line in lines] == [
        "widths of the network",
        "centres of the network",
    ]
    assert all(line.endswith(" s") for line in lines)
    assert capsys.readouterr().out == ""


def test_labels_are_in_the_order_of_their_numbers():
    labels = ["cone 10", "cone 2", "b", "a 1 x 3", "a 1 x 20", 7]
    assert [labels[i] for i in natural_order(labels)] == [
        7, "a 1 x 3", "a 1 x 20", "b", "cone 2", "cone 10",
    ]  # fmt: skip
