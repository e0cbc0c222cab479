"""What the tests of the command share: a reader of pages, and what it refuses."""

from functools import partial
from html.parser import HTMLParser

import pytest

from sklearn_raacmm import ArmResidualRegressor, learn_correction
from sklearn_raacmm.app import _commands, main


class Page(HTMLParser):
    """What is in a page: text outside figures and style, rows of tables, links, names, blanks."""

    def __init__(self, text):
        super().__init__()
        self.open, self.text, self.rows, self.links, self.ids, self.blanks = [], [], [], [], [], 0
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.links += [attrs[k] for k in ("src", "href", "xlink:href") if k in attrs]
        self.ids += [attrs["id"]] if "id" in attrs else []
        self.blanks += attrs.get("class") == "blank"
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag not in ("meta", "br", "link"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if {"td", "th"} & set(self.open):
            self.rows[-1][-1] += data
        if not {"svg", "style"} & set(self.open):
            self.text.append(data)


@pytest.fixture(autouse=True)
def _no_terminal(monkeypatch):
    """Sentences stay in one line, as in a pipe: workers of pytest may say how wide they are."""
    monkeypatch.delenv("COLUMNS", raising=False)


@pytest.fixture
def quick_model(monkeypatch):
    """The command learns a small model where what it says is judged, not what a model is worth."""
    small = ArmResidualRegressor(orders=2, causes=["kinematics"])
    monkeypatch.setattr(_commands, "learn_correction", partial(learn_correction, model=small))


@pytest.fixture(scope="session")
def read_page():
    """What parses a page."""
    return Page


@pytest.fixture
def refused(capsys):
    """What asserts that the command refuses some words with a sentence."""

    def refused(sentence, *words):
        assert main([str(word) for word in words]) == 2
        assert sentence in capsys.readouterr().err

    return refused
